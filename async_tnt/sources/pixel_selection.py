"""What of a source's pixels a model is to see, as plain values that can be compared, sent and told."""

from __future__ import annotations

import hashlib
import os
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from async_tnt.sources.files.source import Sensor
from async_tnt.sources.pixel_filter import check_crop, whole_region
from async_tnt.sources.pixel_masks import checked_mask, checked_sensor, load_mask
from async_tnt.sources.sizes import by

Region = tuple[int, int, int, int]


@dataclass(frozen=True)
class PackedMask:
    """A mask of pixels in little memory: equal to another of the same size and pixels, whatever file it is from.

    Parameters
    ----------
    size : (width, height) of the sensor that it is of.
    sha256 : of its pixels, row by row, one byte each, 1 where masked: `hashlib.sha256(mask.tobytes()).hexdigest()`.
    n_pixels : how many are masked.
    packed : the pixels as bits, compressed. A mask goes to a worker with every recording, and a packed one of a
        1280x720 sensor, with hot pixels only, is 1 to 3 kB instead of 900.
    name : where it is from, for messages.
    """

    size: Sensor
    sha256: str
    n_pixels: int
    packed: bytes = field(compare=False, repr=False)
    name: str = field(default="mask", compare=False)

    @classmethod
    def of(cls, mask: np.ndarray, name: str = "mask") -> PackedMask:
        """From a bool array of shape (H, W), True where a pixel's events are left out.

        Raises
        ------
        ValueError : another type, not of two dimensions, or empty.
        """
        try:
            height, width = checked_mask(mask).shape
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        sha256 = hashlib.sha256(mask.tobytes()).hexdigest()
        packed = zlib.compress(np.packbits(mask).tobytes())
        return cls((width, height), sha256, int(np.count_nonzero(mask)), packed, name)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> PackedMask:
        """From a file of `save_mask` or `async-tnt mask`.

        Raises
        ------
        ValueError : damaged, or no mask. OSError : missing or not readable.
        """
        return cls.of(load_mask(path), str(path))

    def pixels(self, sensor: Sensor) -> np.ndarray:
        """The mask itself, for a camera of (width, height): bool, shape (H, W).

        Raises
        ------
        ValueError : it is of another sensor.
        """
        width, height = self.size
        bits = np.frombuffer(zlib.decompress(self.packed), np.uint8)
        mask = np.unpackbits(bits, count=width * height).reshape(height, width).view(np.bool_)
        try:
            return checked_mask(mask, sensor)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None


@dataclass(frozen=True, init=False)
class PixelSelection:
    """What of a source's pixels a model is to see: frozen and picklable, without any state; `PixelSelector` applies it.

    Parameters
    ----------
    roi : region of interest (x, y, width, height); None: the whole sensor.
    crop : the region is the model's sensor: coordinates are shifted to its upper left corner.
    mask : pixels whose events are left out, of the whole camera: a bool array of shape (H, W), the path of such a
        `.npy` file, or one packed already; None: no pixel. It is packed here, and its file is not read again.
    sensor : (width, height) of the camera as somebody says it, where sources may be silent.

    Raises
    ------
    ValueError : `crop` without `roi`, a mask of another size than `sensor`, an empty or damaged one, or what is no
        region or no sensor at all.
    TypeError : a mask of another kind. OSError : its file is missing or not readable.

    Example
    -------
    >>> PixelSelection(roi=(40, 20, 34, 34), crop=True).about
    {'roi': '40,20,34,34', 'crop': True}
    >>> PixelSelection().about
    {}
    """

    roi: Region | None
    crop: bool
    mask: PackedMask | None
    sensor: Sensor | None

    def __init__(
        self,
        roi: Region | None = None,
        crop: bool = False,
        mask: PackedMask | np.ndarray | str | os.PathLike[str] | None = None,
        sensor: Sensor | None = None,
    ) -> None:
        check_crop(crop, roi)
        # As tuples of integers, so that equal ones are equal. The mask comes last: it may be a large file.
        values = {
            "roi": None if roi is None else whole_region(roi),
            "crop": bool(crop),
            "sensor": None if sensor is None else checked_sensor(sensor),
            "mask": None if mask is None else _packed(mask),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.mask is not None and self.sensor is not None and self.sensor != self.mask.size:
            raise ValueError(
                f"{self.mask.name}: a mask of {by(self.mask.size)} pixels, but the camera's are given as "
                f"{by(self.sensor)} (--sensor)"
            )

    @property
    def camera(self) -> Sensor | None:
        """(width, height) of the camera as far as the selection itself says: it is given, or the mask's size."""
        return self.sensor if self.mask is None else self.mask.size

    @property
    def region(self) -> Sensor | None:
        """(width, height) of what the model sees with `crop`; None without."""
        return (self.roi[2], self.roi[3]) if self.crop and self.roi is not None else None

    @property
    def leaves_out(self) -> bool:
        """Whether there is anything that could be left out."""
        return self.roi is not None or self.mask is not None

    @property
    def about(self) -> dict[str, Any]:
        """Option -> value of all that decides which events are seen, short and as JSON takes it; {} for all events.

        A mask is told by its size and the first 16 digits of its SHA-256. With it, `sensor` can only repeat its size,
        and is not told. Without a mask, `sensor` decides which recordings are of this camera, and so of which there is
        a result at all and of which an error: two results of different ones are not to be mixed.
        """
        told: dict[str, Any] = {}
        if self.roi is not None:
            told["roi"] = ",".join(map(str, self.roi))
        if self.crop:
            told["crop"] = True
        if self.mask is not None:
            told["mask"] = f"{by(self.mask.size)} {self.mask.sha256[:16]}"
        elif self.sensor is not None:
            told["sensor"] = by(self.sensor)
        return told

    @property
    def record(self) -> dict[str, Any]:
        """For a model's training record: which events it has learned from; {} for all events."""
        told: dict[str, Any] = {}
        if self.roi is not None:
            told |= {"roi": list(self.roi), "crop": self.crop}
        if self.mask is not None:
            told |= {"masked_pixels": self.mask.n_pixels, "mask_sha256": self.mask.sha256}
        return told


def _packed(mask: Any) -> PackedMask:
    if isinstance(mask, PackedMask):
        return mask
    if isinstance(mask, np.ndarray):
        return PackedMask.of(mask)
    if isinstance(mask, (str, os.PathLike)):
        return PackedMask.read(mask)
    raise TypeError(f"`mask` must be a bool array, a .npy file's path or a PackedMask, got {type(mask).__name__}")
