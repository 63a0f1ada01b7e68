"""Recordings as NumPy files: `.npy` and `.npz`.

`.npy`   a structured array with the fields t, x, y, p in any order (or other names of `event_forms`), or an (N, 4)
         integer array of columns t, x, y, p. Memory-mapped, and read block by block.
`.npz`   one such array under the name `events` (or the only array in the file), or four arrays t, x, y, p; optionally
         `sensor` = (width, height). Checked to its end when it is opened, block by block; other arrays are not read.

Times are integer microseconds; polarity is bool, 0/1 or -1/+1. Nothing is unpickled.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from async_tnt.checks import one_line
from async_tnt.event_forms import NAMES, Four, named_columns, the_name
from async_tnt.events import EVENT_DTYPE, checked_columns
from async_tnt.sources.files.npy_arrays import MAGIC, map_npy, read_npy_header
from async_tnt.sources.files.source import (
    BLOCK_EVENTS,
    ArraySource,
    CorruptData,
    Source,
    events_on_sensor,
    valid_blocks,
)
from async_tnt.sources.sensor import Sensor

ANY_SENSOR = (1 << 16, 1 << 16)  # every pixel that uint16 can hold
KEPT_EVENTS = 1 << 22  # of a .npz, in 55 MB of memory; a longer one is decompressed again at each pass
BLOCK_BYTES = 1 << 22  # decompressed at once of each array
MAX_ROW_BYTES = 1 << 16  # of one event and what is stored with it


class NpySource(Source):
    """The events of a `.npy` file, which does not state the sensor."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._n_events = len(_columns(map_npy(path))[0])

    def blocks(self) -> Iterator[np.ndarray]:
        # mapped again for each block: pages that were read stay in memory as long as their map does
        return valid_blocks(
            _columns(map_npy(self.path)[start : start + BLOCK_EVENTS])
            for start in range(0, self._n_events, BLOCK_EVENTS)
        )


class NpzSource(Source):
    """The events of a `.npz` file, decompressed block by block. A damaged archive raises exceptions of any type."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with ExitStack() as files:
            archive = files.enter_context(zipfile.ZipFile(path))
            members = _members(archive)
            if "sensor" in members:
                self.sensor = _sensor(_Array(files, archive, members.pop("sensor")))
            infos = _event_members(members)
            arrays = [_Array(files, archive, info) for info in infos]
        sizes = [len(column) for column in _columns(*(array.claimed for array in arrays))]
        if len(set(sizes)) != 1:
            raise ValueError(f"t, x, y and p must have equal lengths, got {', '.join(map(str, sizes))}")
        self.n_events = sizes[0]
        self._parts = [(info, k) for info in infos for k in (range(4) if arrays[0].is_by_columns else (None,))]

    def blocks(self) -> Iterator[np.ndarray]:
        return valid_blocks(self._columns())

    def _columns(self) -> Iterator[Four]:
        try:
            with ExitStack() as files:
                archive = files.enter_context(zipfile.ZipFile(self.path))
                arrays = [_Array(files, archive, info, column) for info, column in self._parts]
                step = min(BLOCK_EVENTS, *(BLOCK_BYTES // array.row_bytes for array in arrays))
                for start in range(0, self.n_events, step):
                    yield _columns(*(array.read(min(step, self.n_events - start)) for array in arrays))
        except Exception as error:  # of any type
            raise CorruptData(one_line(error)) from None


class _Array:
    """An array in an archive, or one of its columns, decompressed row by row."""

    def __init__(
        self, files: ExitStack, archive: zipfile.ZipFile, info: zipfile.ZipInfo, column: int | None = None
    ) -> None:
        self._name = info.filename
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others unpack all of it at once
            method = {zipfile.ZIP_BZIP2: "bzip2", zipfile.ZIP_LZMA: "lzma"}.get(info.compress_type, "something else")
            raise ValueError(
                f"{self._name} is compressed by {method}, not as np.savez_compressed does: save it by that"
            )
        self._file = files.enter_context(archive.open(info))
        try:
            self.claimed, is_fortran = read_npy_header(self._file, info.file_size)
        except ValueError as error:
            raise ValueError(f"{self._name}: {error}") from None
        self.is_by_columns = is_fortran and self.claimed.ndim == 2
        self._row = self.claimed.shape[1:] if column is None else ()
        self.row_bytes = math.prod(self._row) * self.claimed.itemsize
        if self.row_bytes > MAX_ROW_BYTES:
            raise ValueError(f"{self._name}: an event must take at most {MAX_ROW_BYTES} bytes, got {self.row_bytes}")
        n_skipped = 0 if column is None else column * len(self.claimed) * self.row_bytes
        # `seek` would read 16 MiB at a time
        while n_skipped > 0 and (data := self._file.read(min(n_skipped, 1 << 20))):
            n_skipped -= len(data)

    def read(self, n: int) -> np.ndarray:
        """The next n >= 1 rows."""
        data = self._file.read(n * self.row_bytes)
        if len(data) != n * self.row_bytes:
            raise ValueError(f"{self._name} ends before its array does")
        return np.frombuffer(data, self.claimed.dtype).reshape(n, *self._row)


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The archive's directory, by the names of its arrays."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name in members:
            raise ValueError(f"the archive holds `{name[:80]}` twice")
        members[name] = info
    return members


def _event_members(members: dict[str, zipfile.ZipInfo]) -> list[zipfile.ZipInfo]:
    """The one array of events, or their four columns."""
    if "events" in members:
        return [members["events"]]
    if all(any(name in members for name in names) for names in NAMES.values()):
        return [members[the_name(field, members, "the archive")] for field in NAMES]
    if len(members) == 1:
        return list(members.values())
    raise ValueError(f"a .npz recording has `events`, or t, x, y and p; got {sorted(members)[:8]}")


def _sensor(array: _Array) -> Sensor:
    shape, dtype = array.claimed.shape, array.claimed.dtype
    sides = array.read(2).tolist() if shape == (2,) and dtype.kind in "iu" else None
    if sides is None or min(sides) < 1:
        got = sides or f"shape {shape} of {dtype}"
        raise ValueError(f"`sensor` must be two positive integers (width, height), got {got}")
    return sides[0], sides[1]


def _columns(*arrays: np.ndarray) -> Four:
    """The columns t, x, y, p of one array of events, or of four arrays; whole numbers, of unchecked values."""
    array = arrays[0]
    if len(arrays) == 1 and (array.dtype.names is None or array.ndim == 0):
        if array.ndim != 2 or array.shape[1] != 4:
            raise ValueError(
                "expected a structured array with fields t, x, y, p or an (N, 4) array of those columns, "
                f"got shape {array.shape} of {array.dtype}"
            )
        arrays = tuple(array.T)
    columns = named_columns(arrays if len(arrays) > 1 else array) or (np.empty(0, np.int64),) * 4
    if not all(c.ndim == 1 and c.dtype.kind in ("iub" if i == 3 else "iu") for i, c in enumerate(columns)):
        t, x, y, p = (column[:0] if column.ndim == 1 else column for column in columns)
        checked_columns(t, x, y, p, ANY_SENSOR)  # raises an error that names what is wrong
    return columns


def open_npy(path: Path) -> Source:
    """Open a `.npy` recording; its header is checked."""
    with path.open("rb") as file:
        if file.read(4) == b"PK\x03\x04":
            raise ValueError(f"{path}: a .npy file must hold one array, got a zip archive; rename it to .npz")
    try:
        return NpySource(path)
    except (TypeError, ValueError) as error:
        raise ValueError(str(error) if str(path) in str(error) else f"{path}: {one_line(error)}") from None


def open_npz(path: Path) -> Source:
    """Open a `.npz` recording; all of it is read and checked once."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            raise ValueError(f"{path}: a .npz file must be a zip archive of arrays, got a single .npy array")
    kept, n_read = [np.empty(0, EVENT_DTYPE)], 0
    try:
        source = NpzSource(path)
        for block in source.blocks():
            events, problem = events_on_sensor(block, source.sensor, n_read)
            if problem:
                raise CorruptData(problem)
            n_read += len(events)
            if source.n_events <= KEPT_EVENTS:
                kept.append(events)
    except Exception as error:  # of any type
        raise ValueError(f"{path}: not a readable NumPy file: {one_line(error)}") from None
    return ArraySource(np.concatenate(kept), source.sensor) if source.n_events <= KEPT_EVENTS else source
