"""Masks of pixels: their one form, and their files."""

from __future__ import annotations

import operator
import os
from pathlib import Path
from typing import Any

import numpy as np

from ..whole_files import replacing

MAX_SIDE = 1 << 15


def checked_sensor(sensor: Any) -> tuple[int, int]:
    """(width, height) as two Python integers.

    Raises
    ------
    ValueError : not two whole numbers in [1, 2**15].
    """
    try:
        width, height = (operator.index(side) for side in sensor)
    except (TypeError, ValueError):
        raise ValueError(f"`sensor` must be (width, height) in whole pixels, got {sensor!r}") from None
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ValueError(f"`sensor` must have sides in [1, {MAX_SIDE}] pixels, got {sensor!r}")
    return width, height


def checked_mask(mask: Any, sensor: tuple[int, int]) -> np.ndarray:
    """A mask of this sensor: bool, shape (H, W), True where a pixel's events are left out.

    Raises
    ------
    ValueError : another type or another shape; says what came.
    """
    width, height = sensor
    rule = f"a mask of a {width}x{height} sensor must be a bool array of shape ({height}, {width}), (height, width)"
    if not isinstance(mask, np.ndarray):
        raise ValueError(f"{rule}; got {type(mask).__name__}")
    if mask.dtype != np.bool_:
        raise ValueError(f"{rule}; got {mask.dtype} of shape {mask.shape}")
    if mask.shape != (height, width):
        turned = "; turn it with .T" if mask.shape == (width, height) else ""
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
    with Path(path).open("rb") as file:  # here, so that a missing file is an OSError and nothing below is
        try:
            mask = np.load(file, allow_pickle=False)
        # Everything: one damaged byte of the header can surface as a dozen kinds of errors.
        except Exception as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from error
    try:
        return checked_mask(mask, _any_size(mask) if sensor is None else sensor)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _any_size(mask: Any) -> tuple[int, int]:
    if not isinstance(mask, np.ndarray) or mask.ndim != 2 or not mask.size or max(mask.shape) > MAX_SIDE:
        shape = f"shape {mask.shape}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise ValueError(f"a mask must be a bool array of shape (height, width), sides in [1, {MAX_SIDE}]; got {shape}")
    return mask.shape[1], mask.shape[0]


def save_mask(path: str | os.PathLike[str], mask: np.ndarray) -> None:
    """Write a mask as a `.npy` file, whole or not at all.

    Raises
    ------
    ValueError : no bool array of two dimensions, or another suffix.
    OSError : not writeable.
    """
    path = checked_out(path)
    mask = np.asarray(mask)
    if mask.dtype != np.bool_ or mask.ndim != 2:
        got = f"{mask.dtype} of shape {mask.shape}"
        raise ValueError(f"a mask must be a bool array of shape (height, width), got {got}")
    with replacing(path) as part, part.open("wb") as file:
        np.save(file, mask, allow_pickle=False)


def checked_out(path: str | os.PathLike[str]) -> Path:
    """Where a mask can be written; an error before the work rather than after it."""
    path = Path(path)
    if path.suffix.lower() != ".npy":
        raise ValueError(f"{path}: a mask is written as .npy, got the suffix {path.suffix!r}")
    if not path.parent.is_dir():
        raise FileNotFoundError(2, "no such folder to write to", str(path.parent))
    return path
