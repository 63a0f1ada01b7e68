"""Recordings as NumPy files: `.npy` and `.npz`.

`.npy`   a structured array with the fields t, x, y, p in any order (names as at the door, see `events`), or an
         (N, 4) integer array of columns t, x, y, p.
`.npz`   one such array under the name `events` (or the only array in the file), or four arrays t, x, y, p;
         beside either, `sensor` = (width, height) where it is known.

Times are integer microseconds; polarity is bool, 0/1 or -1/+1. Nothing is unpickled.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.event_forms import NAMES
from async_tnt.events import as_events

ANY_SENSOR = (1 << 16, 1 << 16)  # what uint16 pixels can say


def read_npy(path: str | os.PathLike[str]) -> tuple[np.ndarray, tuple[int, int] | None]:
    """Read a `.npy` recording.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, and None: the format does not say the sensor.

    Raises
    ------
    ValueError : damaged, or not laid out as the module says.
    OSError : missing or not readable.
    """
    array = _load(path)
    if isinstance(array, dict):
        raise ValueError(f"{path}: a .npy file must hold one array, got a zip archive; rename it to .npz")
    return _checked(path, _form(path, array), ANY_SENSOR), None


def read_npz(path: str | os.PathLike[str]) -> tuple[np.ndarray, tuple[int, int] | None]:
    """Read a `.npz` recording.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, and `(width, height)` if the file has `sensor`, else None.

    Raises
    ------
    ValueError : damaged, not laid out as the module says, or an event off the stated sensor.
    OSError : missing or not readable.
    """
    arrays = _load(path)
    if not isinstance(arrays, dict):
        raise ValueError(f"{path}: a .npz file must be a zip archive of arrays, got a single .npy array")
    stored = arrays.pop("sensor", None)
    sensor = None if stored is None else _sensor(path, stored)
    names = [next((alias for alias in aliases if alias in arrays), "") for aliases in NAMES.values()]
    if "events" in arrays:
        form = _form(path, arrays["events"])
    elif all(names):
        form = tuple(arrays[name] for name in names)
    elif len(arrays) == 1:
        form = _form(path, next(iter(arrays.values())))
    else:
        raise ValueError(f"{path}: a .npz recording has `events`, or t, x, y and p; got {sorted(arrays)}")
    return _checked(path, form, sensor or ANY_SENSOR), sensor


def _load(path: str | os.PathLike[str]) -> np.ndarray | dict[str, np.ndarray]:
    """The file's array, or its arrays by name."""
    with Path(path).open("rb") as file:  # here, so that a missing file is an OSError and nothing below is
        try:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.lib.npyio.NpzFile):
                return {name: loaded[name] for name in loaded.files}
        # Everything: numpy evaluates the header as a Python literal and sizes its buffer from it, so that one
        # damaged byte can surface as TokenError, MemoryError, BadZipFile and a dozen others.
        except Exception as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from error
    return loaded


def _form(path: str | os.PathLike[str], array: np.ndarray) -> Any:
    """A form of events that the door takes."""
    if array.dtype.names is not None:
        return array
    if array.ndim == 2 and array.shape[1] == 4:
        return tuple(array.T)
    raise ValueError(
        f"{path}: expected a structured array with fields t, x, y, p or an (N, 4) array of those columns, "
        f"got shape {array.shape} of {array.dtype}"
    )


def _checked(path: str | os.PathLike[str], form: Any, sensor: tuple[int, int]) -> np.ndarray:
    try:
        return as_events(form, sensor)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def _sensor(path: str | os.PathLike[str], stored: np.ndarray) -> tuple[int, int]:
    if stored.shape != (2,) or stored.dtype.kind not in "iu" or (stored < 1).any():
        raise ValueError(f"{path}: `sensor` must be two positive integers (width, height), got {stored!r}")
    return int(stored[0]), int(stored[1])
