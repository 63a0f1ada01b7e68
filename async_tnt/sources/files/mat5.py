"""Reads a MATLAB file (`.mat`) up to version 7 with SciPy, in the process of `child_process.py`; `hdf5.py` reads 7.3.

Events are vectors of equal length named x, y, t (or ts) and p (or pol), as ASL-DVS has them, or fields of one
structure, as the AER functions for MATLAB have them. They may be doubles, as MATLAB's numbers are, if they are whole.
Other variables are not read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

NAMES = {"t": ("t", "ts"), "x": ("x",), "y": ("y",), "p": ("p", "pol")}
BLOCK_EVENTS = 1 << 16


def read(path: str) -> Iterator[Any]:
    """The sensor, which no variable states; then blocks of events, int64 of shape (4, n)."""
    from scipy.io import loadmat, whosmat

    found = [(name, kind) for name, _, kind in whosmat(path) if name.isidentifier()]
    structures = [name for name, kind in found if kind == "struct"]
    if names := _names_in([name for name, _ in found]):
        fields = loadmat(path, variable_names=names)
    elif len(structures) == 1:
        fields = _fields(loadmat(path, variable_names=structures)[structures[0]])
        names = _names_in(fields)
    if not names:
        got = ", ".join(f"{name} ({kind})" for name, kind in found) or "nothing"
        raise ValueError(f"expected x, y, t or ts, p or pol, as variables or fields of one structure; got {got}")
    columns = [_column(name, fields[name]) for name in names]
    if len({len(column) for column in columns}) != 1:
        raise ValueError(f"{', '.join(names)} must have equal lengths, got {[len(column) for column in columns]}")
    yield None
    for start in range(0, len(columns[0]), BLOCK_EVENTS):
        yield np.array([_whole(name, c[start : start + BLOCK_EVENTS]) for name, c in zip(names, columns, strict=True)])


def _names_in(names: Collection[str]) -> list[str]:
    """Those of t, x, y and p in this file; empty if one is missing."""
    found = [[name for name in spellings if name in names] for spellings in NAMES.values()]
    for spellings in found:
        if len(spellings) > 1:
            raise ValueError(f"events need one of {' and '.join(spellings)}, got both")
    return [spellings[0] for spellings in found] if all(found) else []


def _fields(structure: np.ndarray) -> dict[str, np.ndarray]:
    if structure.size != 1:
        raise ValueError(f"the structure of events must be a single one, got {structure.shape}")
    return {name: structure[name].flat[0] for name in structure.dtype.names or ()}


def _column(name: str, array: Any) -> np.ndarray:
    array = np.asarray(array)
    if array.dtype.kind not in "iufb" or array.size not in (0, max(array.shape, default=1)):
        raise ValueError(f"{name} must be a vector of numbers, got {array.dtype} of shape {array.shape}")
    return array.reshape(-1)


def _whole(name: str, values: np.ndarray) -> np.ndarray:
    """int64; what does not fit becomes negative, and so an invalid event."""
    if values.dtype.kind == "f":
        odd = values != np.floor(values)  # nan, too
        if odd.any():
            raise ValueError(f"{name} must be whole numbers, got {values[odd][0]}")
        return np.where(np.abs(values) < 2.0**62, values, -(2.0**62)).astype(np.int64)
    return values.astype(np.int64)
