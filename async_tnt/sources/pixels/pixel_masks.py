"""Masks of pixels: their check, their files, and a packed form that is small and comparable."""

from __future__ import annotations

import hashlib
import os
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from async_tnt.base.checks import plain_array
from async_tnt.base.files import check_writable, replacing, user_path
from async_tnt.sources.files.numpy_files import map_npy
from async_tnt.volume.config import MAX_SIDE
from async_tnt.volume.sensor import Sensor, format_size


def checked_mask(mask: Any, sensor: Sensor | None = None) -> np.ndarray:
    """The mask itself, if it is a bool array of shape (H, W) of this sensor.

    Parameters
    ----------
    sensor : (width, height); None: a mask of any sensor is accepted.

    Raises
    ------
    ValueError, TypeError : the mask has another type or shape.
    """
    if sensor is None:
        rule = f"a mask must be a bool array of shape (height, width), sides in [1, {MAX_SIDE}]"
    else:
        shape = f"({sensor[1]}, {sensor[0]}), (height, width)"
        rule = f"a mask of a {format_size(sensor)} sensor must be a bool array of shape {shape}"
    if not isinstance(mask, np.ndarray):
        raise ValueError(f"{rule}; got {type(mask).__name__}")
    array = plain_array("mask", mask)
    if array.dtype != np.bool_:
        raise ValueError(f"{rule}; got {array.dtype} of shape {array.shape}")
    fits = array.ndim == 2 and min(array.shape) >= 1 and max(array.shape) <= MAX_SIDE
    if not fits or sensor not in (None, array.shape[::-1]):
        advice = "; transpose it with .T" if array.shape == sensor else ""
        raise ValueError(f"{rule}; got shape {array.shape}{advice}")
    return array


def load_mask(path: str | os.PathLike[str], sensor: Sensor | None = None) -> np.ndarray:
    """The mask in a file that `save_mask` or `async-tnt mask` wrote.

    The mask is bool, shape (H, W), True where events are dropped.

    Parameters
    ----------
    path : the `.npy` file; `~` is the home folder.
    sensor : (width, height) that the mask must have; None: any.

    Raises
    ------
    ValueError : the file is damaged, or is not a mask of this sensor.
    OSError : the file is missing or not readable.
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
    ValueError : the mask is not a bool array of two dimensions, or the path has another suffix.
    OSError : the file cannot be written.
    """
    path = user_path(path)
    check_writable(path, (".npy",))
    mask = checked_mask(mask)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.save(file, mask, allow_pickle=False)


@dataclass(frozen=True)
class PackedMask:
    """A mask in little memory, as `Pixels` holds it.

    Two packed masks are equal if their sizes and pixels are equal, whatever files they are from.

    Parameters
    ----------
    size : (width, height) of the mask's sensor.
    sha256 : hash of the mask's bytes.
    packed : the pixels as compressed bits. Every recording sent to a worker takes its mask along;
        hot pixels of a 1280x720 sensor pack into 1 to 3 kB instead of 900.
    name : name of the mask's file, for messages.
    """

    size: Sensor
    sha256: str
    packed: bytes = field(compare=False, repr=False)
    name: str = field(default="mask", compare=False)

    @classmethod
    def of(cls, mask: np.ndarray, name: str = "mask") -> PackedMask:
        """The packed form of a `mask`.

        Raises
        ------
        ValueError, TypeError : the mask is not a bool array of shape (H, W).
        """
        height, width = checked_mask(mask).shape
        packed = zlib.compress(np.packbits(mask).tobytes())
        return cls((width, height), hashlib.sha256(mask.tobytes()).hexdigest(), packed, name)

    def unpacked(self, sensor: Sensor) -> np.ndarray:
        """The mask itself: bool, shape (H, W).

        Raises
        ------
        ValueError : the mask is of another sensor than `sensor`, (width, height).
        """
        width, height = self.size
        bits = np.frombuffer(zlib.decompress(self.packed), np.uint8)
        mask = np.unpackbits(bits, count=width * height).reshape(height, width).view(np.bool_)
        try:
            return checked_mask(mask, sensor)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
