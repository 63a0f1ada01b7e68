"""Reads a MATLAB file (`.mat`) up to version 7 with SciPy, in the process of `child_process.py`; `hdf5.py` reads 7.3.

Events are vectors of equal length named x, y, t (or ts) and p (or pol), as ASL-DVS has them, or fields of one
structure, as the AER functions for MATLAB have them. Other variables are not read.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

NAMES = {"t": ("t", "ts"), "x": ("x",), "y": ("y",), "p": ("p", "pol")}
BLOCK_EVENTS = 1 << 16


def read(path: str) -> Iterator[Any]:
    """The sensor, which no variable states; then blocks of events, as columns t, x, y, p."""
    from scipy.io import loadmat, whosmat

    _check_complete(Path(path))
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
        yield [column[start : start + BLOCK_EVENTS] for column in columns]


def _check_complete(path: Path) -> None:
    """SciPy takes the end of the file for that of the variables."""
    with path.open("rb") as file:
        order = {b"IM": "<", b"MI": ">"}.get(file.read(128)[126:])  # none before version 5
        while order and (tag := file.read(8)):
            kind, n_bytes = struct.unpack(order + "II", tag.ljust(8, b"\0"))
            missing = file.seek(0 if kind >> 16 else n_bytes, 1) - path.stat().st_size  # a small one is in its tag
            if len(tag) < 8 or missing > 0:
                raise ValueError(f"it is cut off: a variable's last {max(missing, 8 - len(tag))} bytes are missing")


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
    column: np.ndarray = array.reshape(-1)
    return column
