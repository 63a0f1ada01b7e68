"""Masks of pixels: checked, in files, and packed so that they are small and comparable."""

from __future__ import annotations

import hashlib
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.checks import plain_array
from async_tnt.config import MAX_SIDE
from async_tnt.files import check_writable, replacing
from async_tnt.sources.files.npy_arrays import map_npy
from async_tnt.sources.sensor import Sensor, format_size


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
    """Read a mask that `save_mask` or `async-tnt mask` wrote: bool, shape (H, W), True where events are dropped.

    Parameters
    ----------
    path : the `.npy` file.
    sensor : (width, height) that the mask must have; None: any.

    Raises
    ------
    ValueError : damaged, or not a mask of this sensor.
    OSError : missing or not readable.
    """
    try:
        return np.array(checked_mask(map_npy(path), sensor))
    except ValueError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"{path}: not a mask, a .npy file as `async-tnt mask` writes: {why}") from None


def save_mask(path: str | os.PathLike[str], mask: np.ndarray) -> None:
    """Write a `mask` (bool, shape (H, W)) to `path`, a `.npy` file, completely or not at all.

    Raises
    ------
    ValueError : not a bool array of two dimensions, or another suffix.
    OSError : not writable.
    """
    check_mask_path(path)
    mask = checked_mask(plain_array("mask", mask))
    with replacing(Path(path)) as part, part.open("wb") as file:
        np.save(file, mask, allow_pickle=False)


def check_mask_path(path: str | os.PathLike[str]) -> None:
    """Check that `save_mask` can write there, before the work of learning a mask; raises the same errors."""
    path = Path(path)
    if path.suffix.lower() != ".npy":
        raise ValueError(f"{path}: a mask is written as .npy, got the suffix {path.suffix!r}")
    check_writable(path)


@dataclass(frozen=True)
class PackedMask:
    """A mask in little memory: equal to any other of the same size and pixels, whatever file it is from.

    Parameters
    ----------
    size : (width, height) of its sensor.
    sha256 : of the mask's bytes.
    packed : the pixels as compressed bits. Every recording sent to a worker takes its mask along; hot pixels of a
        1280x720 sensor pack into 1 to 3 kB instead of 900.
    name : its file, for messages.
    """

    size: Sensor
    sha256: str
    packed: bytes = field(compare=False, repr=False)
    name: str = field(default="mask", compare=False)

    @classmethod
    def of(cls, mask: Any, name: str = "mask") -> PackedMask:
        """Pack a `mask`: a bool array of shape (H, W), or the file of one. `name` is for messages about an array.

        Raises
        ------
        ValueError : another type or shape, or a damaged file.
        TypeError : neither an array nor a path.
        OSError : the file is missing or not readable.
        """
        if isinstance(mask, PackedMask):
            return mask
        if isinstance(mask, (str, os.PathLike)):
            return cls.of(load_mask(mask), str(mask))
        if not isinstance(mask, np.ndarray):
            raise TypeError(
                f"`mask` must be a bool array, a .npy file's path or a PackedMask, got {type(mask).__name__}"
            )
        height, width = checked_mask(mask).shape
        packed = zlib.compress(np.packbits(mask).tobytes())
        return cls((width, height), hashlib.sha256(mask.tobytes()).hexdigest(), packed, name)

    def pixels(self, sensor: Sensor) -> np.ndarray:
        """The mask itself: bool, shape (H, W); a ValueError if it is not of this `sensor` (width, height)."""
        width, height = self.size
        bits = np.frombuffer(zlib.decompress(self.packed), np.uint8)
        mask = np.unpackbits(bits, count=width * height).reshape(height, width).view(np.bool_)
        try:
            return checked_mask(mask, sensor)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
