"""Masks of pixels: checked, in files, packed so that they are small and comparable; and learned
from recordings.

A hot pixel has far more events than what moves in front of it can explain. Let n be a pixel's count
of events in a recording. A plausible count for it is

    plausible = max(neighbours, mean, 1)

    neighbours   the 4th largest count among the other pixels of the 5x5 block around it (at the
                 sensor's border the block is shifted inwards): a moving edge, even a line one pixel
                 wide that moves along itself, passes at least four of them, but at its very ends. A
                 median, as in image filters, would mistake such lines for hot pixels.
    mean         the mean count of all pixels: in a still scene neighbours say nothing
    1            a single event is no evidence

and the pixel is hot if both hold:

    n > 5 plausible                                          far above
    n log(n / plausible) - (n - plausible) > log(100 N)      and not by chance

The second is Chernoff's bound on a Poisson count, P(count >= n) <= exp(n - plausible) (plausible /
n)^n, so that among the N pixels of the sensor one passes it by chance in one of a hundred
recordings. Hot pixels raise the mean and hide weaker ones nearby: the search is repeated until it
finds no more, those found having the largest count of the others in their block. (With a lower one
the end of a line would move inwards, and the line be found pixel by pixel.)

Five or more hot pixels in one 5x5 block explain one another, and not all are found: a flickering
lamp looks the same. Conversely, something small and bright that visits one pixel all the time looks
like a hot pixel: learn from recordings in which things move, or of a still scene, with some
thousand events at least.
"""

from __future__ import annotations

import hashlib
import math
import os
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from async_tnt.base.checks import plain_array
from async_tnt.base.files import check_writable, replacing, user_path
from async_tnt.kernels.sources.pixels import count_events
from async_tnt.sources.files.numpy_files import map_npy
from async_tnt.volume.config import MAX_SIDE
from async_tnt.volume.events import EventDecoder
from async_tnt.volume.sensor import Sensor, checked_sensor, format_size

BLOCK = 5
RANK = 4
FACTOR = 5.0
FALSE_ALARMS = 0.01  # over the whole sensor
MAX_PIXELS = 1 << 24
"""Pixels of the largest sensor whose events are counted by pixel, which takes up to 40 bytes a
pixel. The largest event cameras have one or two million; but a file of a few hundred bytes may
state a thousand times as many."""


def checked_mask(mask: Any, sensor: Sensor | None = None) -> np.ndarray:
    """A mask, if it is a bool array of shape (H, W) of this sensor, or of any if it is None.

    Raises
    ------
    ValueError, TypeError : of another type or shape.
    """
    rule = f"a mask must be a bool array of shape (height, width), sides in [1, {MAX_SIDE}]"
    if sensor is not None:
        shape = f"({sensor[1]}, {sensor[0]}), (height, width)"
        rule = f"a mask of a {format_size(sensor)} sensor must be a bool array of shape {shape}"
    if not isinstance(mask, np.ndarray):
        raise ValueError(f"{rule}; got {type(mask).__name__}")
    array = plain_array("mask", mask)
    if array.dtype != np.bool_:
        raise ValueError(f"{rule}; got {array.dtype} of shape {array.shape}")
    fits = array.ndim == 2 and min(array.shape) >= 1 and max(array.shape) <= MAX_SIDE
    if not fits or sensor not in (None, array.shape[::-1]):
        transposed = "; transpose it with .T" if array.shape == sensor else ""
        raise ValueError(f"{rule}; got shape {array.shape}{transposed}")
    return array


def load_mask(path: str | os.PathLike[str], sensor: Sensor | None = None) -> np.ndarray:
    """Read a mask that `save_mask` or `async-tnt mask` wrote: bool, shape (H, W), True where events
    are dropped.

    Parameters
    ----------
    path : the `.npy` file; `~` is the home folder.
    sensor : (width, height) that the mask must have; None: any.

    Raises
    ------
    ValueError : damaged, or not a mask of this sensor.
    OSError : missing or not readable.
    """
    path = user_path(path)
    try:
        return np.array(checked_mask(map_npy(path), sensor))
    except ValueError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise ValueError(
            f"{path}: not a mask, a .npy file as `async-tnt mask` writes: {why}"
        ) from None


def save_mask(path: str | os.PathLike[str], mask: np.ndarray) -> None:
    """Write a `mask` (bool, shape (H, W)) to `path`, a `.npy` file, completely or not at all.

    Raises
    ------
    ValueError : not a bool array of two dimensions, or another suffix.
    OSError : not writable.
    """
    path = user_path(path)
    check_writable(path, (".npy",))
    mask = checked_mask(mask)
    with replacing(path) as part, part.open("wb") as file:
        np.save(file, mask, allow_pickle=False)


@dataclass(frozen=True)
class PackedMask:
    """A mask in little memory: equal to any other of the same size and pixels, whatever file it is
    from.

    Parameters
    ----------
    size : (width, height) of its sensor.
    sha256 : of the mask's bytes.
    packed : the pixels as compressed bits. Every recording sent to a worker takes its mask along;
        hot pixels of a 1280x720 sensor pack into 1 to 3 kB instead of 900.
    name : its file, for messages.
    """

    size: Sensor
    sha256: str
    packed: bytes = field(compare=False, repr=False)
    name: str = field(default="mask", compare=False)

    @classmethod
    def of(cls, mask: np.ndarray, name: str = "mask") -> PackedMask:
        """Pack a `mask`, a bool array of shape (H, W); a ValueError if it is of another type or
        shape."""
        height, width = checked_mask(mask).shape
        packed = zlib.compress(np.packbits(mask).tobytes())
        return cls((width, height), hashlib.sha256(mask.tobytes()).hexdigest(), packed, name)

    def unpacked(self, sensor: Sensor) -> np.ndarray:
        """The mask itself: bool, shape (H, W); a ValueError if it is not of this `sensor` (width,
        height)."""
        width, height = self.size
        bits = np.frombuffer(zlib.decompress(self.packed), np.uint8)
        mask = np.unpackbits(bits, count=width * height).reshape(height, width).view(np.bool_)
        try:
            return checked_mask(mask, sensor)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None


def learn_mask(source: Iterable[Any], sensor: tuple[int, int]) -> np.ndarray:
    """Find the hot pixels of a recording.

    The head of this module has the rule.

    Parameters
    ----------
    source : packets, in any form that `async_tnt.volume.event_forms` lists; read to its end.
    sensor : (width, height) in pixels.

    Returns
    -------
    bool, shape (H, W), True where a pixel is hot: what `PixelFilter(mask=)` takes.

    Raises
    ------
    ValueError, TypeError : an invalid sensor, one of more than 2**24 pixels, or invalid events.

    Example
    -------
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> recording = open_recording(sample_recordings()[3])
    >>> int(learn_mask(recording, (34, 34)).sum())
    0
    >>> stuck = ([1000 * k for k in range(200)], [30] * 200, [5] * 200, [1] * 200)
    >>> np.argwhere(learn_mask([*recording, stuck], (34, 34))).tolist()  # (y, x)
    [[5, 30]]
    """
    return hot_pixels(count_pixels(source, sensor))


def count_pixels(source: Iterable[Any], sensor: tuple[int, int]) -> np.ndarray:
    """Events of each pixel in a `source` of packets: int64, shape (H, W) of the `sensor` (width,
    height), which has at most 2**24 pixels."""
    width, height = checked_sensor(sensor)
    if width * height > MAX_PIXELS:
        size = format_size((width, height))
        raise ValueError(
            f"a sensor must have at most {MAX_PIXELS:,} pixels to count their events, got {size}"
        )
    decoder = EventDecoder((width, height))
    counts = np.zeros((height, width), np.int64)
    for events in source:
        _, x, y, _, n = decoder.decode(events)
        count_events(x, y, n, counts)
    return counts


def hot_pixels(counts: np.ndarray) -> np.ndarray:
    """`learn_mask` from the `counts` of events: int64, shape (H, W)."""
    hot = np.zeros(counts.shape, bool)
    chance = math.log(counts.size / FALSE_ALARMS)
    rest = counts
    while True:
        mean = max(1.0, rest.mean())
        y, x = np.nonzero((rest > FACTOR * mean) & ~hot)
        n = rest[y, x].astype(np.float64)
        plausible = np.maximum(mean, _largest(rest, y, x, RANK))
        found = (n > FACTOR * plausible) & (n * np.log(n / plausible) - (n - plausible) > chance)
        if not found.any():
            return hot
        hot[y[found], x[found]] = True
        rest = np.where(hot, 0, counts)
        y, x = np.nonzero(hot)
        rest[y, x] = _largest(rest, y, x, 0)


def listed_pixels(counts: np.ndarray, hot: np.ndarray) -> list[dict[str, int]]:
    """`x`, `y` and `events` of each hot pixel, busiest first."""
    found = [{"x": x, "y": y, "events": int(counts[y, x])} for y, x in np.argwhere(hot).tolist()]
    return sorted(found, key=lambda pixel: -pixel["events"])


def _largest(counts: np.ndarray, y: np.ndarray, x: np.ndarray, rank: int) -> np.ndarray:
    """The largest count in the 5x5 block around each pixel, after the `rank` largest ones.

    After four it is `neighbours`: if a pixel is larger than its 4th largest neighbour, that is the
    5th largest count of the block; if not, the 5th largest of the block is no smaller than the
    pixel, which is then not hot.
    """
    height, width = (min(BLOCK, side) for side in counts.shape)
    blocks = sliding_window_view(counts, (height, width))
    top = np.clip(y - BLOCK // 2, 0, blocks.shape[0] - 1)
    left = np.clip(x - BLOCK // 2, 0, blocks.shape[1] - 1)
    rank = min(rank, height * width - 1)
    return np.sort(blocks[top, left].reshape(y.size, height * width), axis=1)[:, -1 - rank]
