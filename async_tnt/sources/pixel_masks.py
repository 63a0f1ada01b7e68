"""Masks of pixels: their one form, and their files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.checks import is_whole, plain_array
from async_tnt.config import MAX_SIDE
from async_tnt.files import check_writable, replacing
from async_tnt.sources.files.npy_arrays import map_npy
from async_tnt.sources.sizes import by


def checked_sensor(sensor: Any) -> tuple[int, int]:
    """(width, height) as two Python integers.

    Raises
    ------
    ValueError : not two whole numbers in [1, 2**15].
    """
    try:
        width, height = sensor
    except (TypeError, ValueError):
        width = height = None
    if not (is_whole(width) and is_whole(height)):
        raise ValueError(f"`sensor` must be (width, height) in whole pixels, got {sensor!r}")
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ValueError(f"`sensor` must have sides in [1, {MAX_SIDE}] pixels, got {sensor!r}")
    return int(width), int(height)


def checked_mask(mask: Any, sensor: tuple[int, int] | None = None) -> np.ndarray:
    """A mask of this sensor: bool, shape (H, W), True where a pixel's events are left out.

    Parameters
    ----------
    sensor : (width, height) that it must be of; None: of any.

    Raises
    ------
    ValueError, TypeError : another type or another shape; says what came.
    """
    if sensor is None:
        rule = f"a mask must be a bool array of shape (height, width), sides in [1, {MAX_SIDE}]"
    else:
        rule = (
            f"a mask of a {by(sensor)} sensor must be a bool array of shape ({sensor[1]}, {sensor[0]}), (height, width)"
        )
    if not isinstance(mask, np.ndarray):
        raise ValueError(f"{rule}; got {type(mask).__name__}")
    mask = plain_array("mask", mask)
    if mask.dtype != np.bool_:
        raise ValueError(f"{rule}; got {mask.dtype} of shape {mask.shape}")
    fits = mask.ndim == 2 and min(mask.shape) >= 1 and max(mask.shape) <= MAX_SIDE
    if not fits or sensor not in (None, mask.shape[::-1]):
        turned = "; turn it with .T" if mask.shape == sensor else ""
        raise ValueError(f"{rule}; got shape {mask.shape}{turned}")
    return mask


def load_mask(path: str | os.PathLike[str], sensor: tuple[int, int] | None = None) -> np.ndarray:
    """Read a mask that `save_mask` or `async-tnt mask` wrote.

    Parameters
    ----------
    sensor : (width, height) that it must be of; None: the mask says.

    Returns
    -------
    bool, shape (H, W), True where a pixel's events are left out.

    Raises
    ------
    ValueError : damaged, or no mask of this sensor.
    OSError : missing or not readable.
    """
    mapped = map_npy(path)
    try:
        return np.array(checked_mask(mapped, sensor))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def save_mask(path: str | os.PathLike[str], mask: np.ndarray) -> None:
    """Write a mask as a `.npy` file, whole or not at all.

    Raises
    ------
    ValueError : no bool array of two dimensions, or another suffix.
    OSError : not writeable.
    """
    path = checked_out(path)
    mask = checked_mask(plain_array("mask", mask))
    with replacing(path) as part, part.open("wb") as file:
        np.save(file, mask, allow_pickle=False)


def checked_out(path: str | os.PathLike[str]) -> Path:
    """Where a mask can be written; an error before the work rather than after it."""
    path = Path(path)
    if path.suffix.lower() != ".npy":
        raise ValueError(f"{path}: a mask is written as .npy, got the suffix {path.suffix!r}")
    check_writable(path)
    return path
