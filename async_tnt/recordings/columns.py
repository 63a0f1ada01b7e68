"""Recordings as NumPy files: `.npy` and `.npz`.

`.npy`   a structured array with the fields t, x, y, p in any order, or an (N, 4) integer array of columns
         t, x, y, p.
`.npz`   one such array under the name `events` (or the only array in the file), or four arrays t, x, y, p;
         beside either, `sensor` = (width, height) where it is known.

Times are integer microseconds; polarity is bool, 0/1 or -1/+1. Nothing is unpickled.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from async_tnt.events import EVENT_DTYPE

_FIELDS = {
    "t": ("t", "ts", "timestamp"),
    "x": ("x",),
    "y": ("y",),
    "p": ("p", "on", "polarity", "pol"),
}


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
    return _to_events(path, _load(path)), None


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
    names = [next((alias for alias in _FIELDS[name] if alias in arrays), "") for name in "txyp"]
    if "events" in arrays:
        events = _to_events(path, arrays["events"])
    elif all(names):
        events = _from_columns(path, *(arrays[name] for name in names))
    elif len(arrays) == 1:
        events = _to_events(path, next(iter(arrays.values())))
    else:
        raise ValueError(f"{path}: a .npz recording has `events`, or t, x, y and p; got {sorted(arrays)}")
    return events, None if stored is None else _checked_sensor(path, stored, events)


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


def _to_events(path: str | os.PathLike[str], array: np.ndarray | dict[str, np.ndarray]) -> np.ndarray:
    if isinstance(array, dict):
        raise ValueError(f"{path}: a .npy file must hold one array, got a zip archive; rename it to .npz")
    if array.dtype.names is not None:
        if array.ndim != 1:
            raise ValueError(f"{path}: a structured array of events must be 1-D, got shape {array.shape}")
        columns = []
        for name, aliases in _FIELDS.items():
            found = next((alias for alias in aliases if alias in array.dtype.names), None)
            if found is None:
                known, got = " | ".join(aliases), list(array.dtype.names)
                raise ValueError(f"{path}: no field for `{name}` ({known}), got fields {got}")
            columns.append(array[found])
        return _from_columns(path, *columns)
    if array.ndim == 2 and array.shape[1] == 4:
        return _from_columns(path, *array.T)
    raise ValueError(
        f"{path}: expected a structured array with fields t, x, y, p or an (N, 4) array of those columns, "
        f"got shape {array.shape} of {array.dtype}"
    )


def _from_columns(
    path: str | os.PathLike[str], t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray
) -> np.ndarray:
    columns = {"t": t, "x": x, "y": y, "p": p}
    for name, column in columns.items():
        if column.ndim != 1 or column.shape != t.shape:
            shapes = ", ".join(f"{n} {c.shape}" for n, c in columns.items())
            raise ValueError(f"{path}: t, x, y, p must be 1-D and equally long, got {shapes}")
        if column.dtype.kind not in ("iub" if name == "p" else "iu"):
            raise ValueError(f"{path}: `{name}` must have an integer type, got {column.dtype}")
    if p.dtype.kind == "i":
        _refuse(path, ~np.isin(p, (-1, 0, 1)), "p", p, "must be 0/1, -1/+1 or bool")
        if (p == -1).any():
            _refuse(path, p == 0, "p", p, "must not be 0 in a recording that has -1")
    elif p.dtype.kind == "u":
        _refuse(path, p > 1, "p", p, "must be 0/1, -1/+1 or bool")
    for name in ("x", "y"):
        _refuse(
            path, (columns[name] < 0) | (columns[name] > 0xFFFF), name, columns[name], "must be in [0, 65536)"
        )
    if t.dtype.kind == "u":
        _refuse(path, t > np.iinfo(np.int64).max, "t", t, "must fit a signed 64-bit integer")
    events = np.empty(len(t), EVENT_DTYPE)
    events["t"], events["x"], events["y"], events["p"] = t, x, y, p > 0
    return events


def _refuse(path: str | os.PathLike[str], bad: np.ndarray, name: str, values: np.ndarray, rule: str) -> None:
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"{path}: `{name}` {rule}, got {values[i]} at event {i}")


def _checked_sensor(path: str | os.PathLike[str], stored: np.ndarray, events: np.ndarray) -> tuple[int, int]:
    if stored.shape != (2,) or stored.dtype.kind not in "iu" or (stored < 1).any():
        raise ValueError(f"{path}: `sensor` must be two positive integers (width, height), got {stored!r}")
    width, height = int(stored[0]), int(stored[1])
    _refuse(
        path, events["x"] >= width, "x", events["x"], f"must be in [0, {width}), the stored sensor's width"
    )
    _refuse(
        path, events["y"] >= height, "y", events["y"], f"must be in [0, {height}), the stored sensor's height"
    )
    return width, height
