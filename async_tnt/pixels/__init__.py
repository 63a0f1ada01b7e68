"""Fewer pixels: a region of interest and a mask of hot pixels, applied to events before anything else.

    pixel_filter = PixelFilter((346, 260), roi=(100, 80, 128, 128), crop=True, mask="mask.npy")
    for decision in async_tnt.stream(map(pixel_filter, camera), model):
        ...

`learn_mask` finds hot pixels in recordings, and so does `async-tnt mask`. `PixelSelection` is what the commands'
options say of a source's pixels; `PixelSelector` opens recordings by it.
"""

from .hot_pixels import count_pixels, hot_pixels, learn_mask
from .mask_files import load_mask, save_mask
from .pixel_filter import PixelCounts, PixelFilter
from .selection import PackedMask, PixelSelection
from .selector import PixelSelector

__all__ = [
    "PackedMask",
    "PixelCounts",
    "PixelFilter",
    "PixelSelection",
    "PixelSelector",
    "count_pixels",
    "hot_pixels",
    "learn_mask",
    "load_mask",
    "save_mask",
]
