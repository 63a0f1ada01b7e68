"""What of a source's pixels a model is to see, as plain values that can be compared, sent and told."""

from __future__ import annotations

import hashlib
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..recordings.source import Sensor
from .mask_files import checked_mask, checked_sensor, load_mask
from .pixel_filter import whole_region

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
        ValueError : another type, or not of two dimensions.
        """
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.ndim != 2:
            got = f"{mask.dtype} of shape {mask.shape}" if isinstance(mask, np.ndarray) else type(mask).__name__
            raise ValueError(f"{name}: a mask must be a bool array of shape (height, width), got {got}")
        height, width = mask.shape
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


@dataclass(frozen=True)
class PixelSelection:
    """What of a source's pixels a model is to see: frozen and picklable, without any state; `PixelSelector` applies it.

    Parameters
    ----------
    roi : region of interest (x, y, width, height); None: the whole sensor.
    crop : the region is the model's sensor: coordinates are shifted to its upper left corner.
    mask : pixels whose events are left out, of the whole camera.
    sensor : (width, height) of the camera as somebody says it, where sources may be silent.

    Raises
    ------
    ValueError : `crop` without `roi`, a mask of another size than `sensor`, or what is no region or no sensor at all.

    Example
    -------
    >>> PixelSelection(roi=(40, 20, 34, 34), crop=True).about
    {'roi': '40,20,34,34', 'crop': True}
    >>> PixelSelection().about
    {}
    """

    roi: Region | None = None
    crop: bool = False
    mask: PackedMask | None = None
    sensor: Sensor | None = None

    def __post_init__(self) -> None:
        if self.crop and self.roi is None:
            raise ValueError("--crop belongs to --roi: the region that is to be the sensor")
        if self.roi is not None:  # as a tuple of integers, so that equal ones are equal
            object.__setattr__(self, "roi", whole_region(self.roi))
        if self.sensor is not None:
            object.__setattr__(self, "sensor", checked_sensor(self.sensor))
        if self.mask is not None and self.sensor not in (None, self.mask.size):
            assert self.sensor is not None
            raise ValueError(
                f"{self.mask.name}: a mask of {_by(self.mask.size)} pixels, but the camera's are given as "
                f"{_by(self.sensor)} (--sensor)"
            )

    @classmethod
    def read(
        cls, roi: Region | None = None, crop: bool = False, mask: Path | None = None, sensor: Sensor | None = None
    ) -> PixelSelection:
        """As the options say; `mask` is a file.

        Raises
        ------
        ValueError, OSError : options that do not go together; a mask that is none, damaged, or missing.
        """
        if crop and roi is None:  # before a file is read
            cls(roi, crop)
        return cls(roi, crop, None if mask is None else PackedMask.read(mask), sensor)

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

        A mask is told by its size and the first 16 digits of its SHA-256.
        """
        told: dict[str, Any] = {}
        if self.roi is not None:
            told["roi"] = ",".join(map(str, self.roi))
        if self.crop:
            told["crop"] = True
        if self.mask is not None:
            told["mask"] = f"{_by(self.mask.size)} {self.mask.sha256[:16]}"
        if self.sensor is not None:
            told["sensor"] = _by(self.sensor)
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


def _by(size: Sensor) -> str:
    return f"{size[0]}x{size[1]}"
