"""Which reader opens a file: by its suffix, and by its first bytes where a suffix can mean several formats.

A further format is one more entry in `READERS`: its suffix, and a function from a path to a `Source`, or to the events
and the sensor's `(width, height)` (None where the file does not state it).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from async_tnt.sources.files.aedat import Aedat2Source, Aedat3Source
from async_tnt.sources.files.nmnist import SENSOR, read_nmnist
from async_tnt.sources.files.numpy_files import open_npy, open_npz
from async_tnt.sources.files.prophesee import DatSource, EvtSource
from async_tnt.sources.files.source import Source
from async_tnt.sources.files.text_files import open_csv, open_txt
from async_tnt.sources.files.worker_source import open_aedat4, open_es, open_hdf5
from async_tnt.sources.sensor import Sensor

Reader = Callable[[Path], Source | tuple[np.ndarray, Sensor | None]]


def _read_bin(path: Path) -> tuple[np.ndarray, Sensor]:
    return read_nmnist(path), SENSOR


def _open_by_content(path: Path) -> Source:
    """Many programs write `.raw`, `.dat`, `.h5` and `.aedat`: the first bytes tell which format it is."""
    with path.open("rb") as file:
        start = file.read(4096)
    if start.startswith(b"\x89HDF\r\n\x1a\n"):
        return open_hdf5(path)
    if start.startswith(b"#!AER-DAT4"):
        return open_aedat4(path)
    if start.startswith(b"#!AER-DAT2."):
        return Aedat2Source(path)
    if start.startswith(b"#!AER-DAT3.1"):
        return Aedat3Source(path)
    if start.startswith(b"Event Stream"):
        return open_es(path)
    if not start:
        raise ValueError(f"{path}: the file is empty")
    header = start.lower()
    if header.startswith(b"%") and (b"% evt " in header or b"% format evt" in header):
        return EvtSource(path)
    if header.startswith(b"%") and path.suffix.lower() == ".dat":
        return DatSource(path)
    raise ValueError(
        f"{path}: its first bytes are not those of a known format: expected a header of EVT (with a line `% evt 3.0` "
        f"or `% format EVT3`), of DAT (lines that begin with %), AEDAT 2.0, 3.1 or 4, ES or HDF5; got {start[:16]!r}"
    )


READERS: dict[str, Reader] = {
    ".bin": _read_bin,
    ".npy": open_npy,
    ".npz": open_npz,
    ".txt": open_txt,
    ".csv": open_csv,
    ".tsv": open_csv,
    ".raw": _open_by_content,
    ".dat": _open_by_content,
    ".aedat": _open_by_content,
    ".aedat4": _open_by_content,
    ".es": _open_by_content,
    ".h5": _open_by_content,
    ".hdf5": _open_by_content,
}
"""Suffix, in lower case -> function that opens such a file."""
