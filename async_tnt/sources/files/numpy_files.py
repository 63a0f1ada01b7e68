"""Recordings as NumPy files: `.npy` and `.npz`.

`.npy`   a structured array with the fields t, x, y, p in any order (names as at the door, see `events`), or an
         (N, 4) integer array of columns t, x, y, p. Mapped, and read block by block.
`.npz`   one such array under the name `events` (or the only array in the file), or four arrays t, x, y, p;
         beside either, `sensor` = (width, height) where it is known. Checked to its end when it is opened, block by
         block; what lies beside these arrays is not read.

Times are integer microseconds; polarity is bool, 0/1 or -1/+1. Nothing is unpickled.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np

from async_tnt.event_forms import NAMES, Four, named_columns, one_line, the_name
from async_tnt.events import EVENT_DTYPE, checked_columns
from async_tnt.sources.files.damage import Damage
from async_tnt.sources.files.npy_arrays import MAGIC, map_npy, read_npy_header
from async_tnt.sources.files.source import BLOCK_EVENTS, ArraySource, Sensor, Source, on_sensor, packed

ANY_SENSOR = (1 << 16, 1 << 16)  # what uint16 pixels can say
KEPT_EVENTS = 1 << 22  # of a .npz, in 55 MB of memory; a longer one is unpacked again at each pass
BLOCK_BYTES = 1 << 22  # unpacked at once of each array
MOST_RECORD = 1 << 16  # bytes of one event and what is stored with it


class NpySource(Source):
    """The events of a `.npy` file. The format does not say the sensor.

    Raises
    ------
    ValueError : damaged, of another size than its header says, or not laid out as the module says.
    OSError : missing or not readable.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with path.open("rb") as file:  # so that a missing file is an OSError
            if file.read(4) == b"PK\x03\x04":
                raise ValueError(f"{path}: a .npy file must hold one array, got a zip archive; rename it to .npz")
        self._n_events = len(_columns(path, map_npy(path))[0])

    def blocks(self) -> Iterator[np.ndarray]:
        # mapped anew for each block: pages that were read stay in memory as long as their map does
        return _packed_blocks(
            _columns(self.path, map_npy(self.path)[start : start + BLOCK_EVENTS])
            for start in range(0, self._n_events, BLOCK_EVENTS)
        )


class NpzSource(Source):
    """The events of a `.npz` file, unpacked block by block.

    Raises
    ------
    ValueError : no archive, or its arrays are not laid out as the module says; their values are read later.
    OSError : missing or not readable.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with path.open("rb") as file:  # so that a missing file is an OSError
            if file.read(len(MAGIC)) == MAGIC:
                raise ValueError(f"{path}: a .npz file must be a zip archive of arrays, got a single .npy array")
        try:
            with ExitStack() as files:
                archive = files.enter_context(zipfile.ZipFile(path))
                members = _members(archive)
                if "sensor" in members:
                    info = members.pop("sensor")
                    self.sensor = _sensor(_Strip(files.enter_context(archive.open(info)), info))
                wanted = _wanted(members)
                strips = [_Strip(files.enter_context(archive.open(info)), info) for info in wanted]
        except Exception as error:  # of a damaged archive: BadZipFile, zlib.error, NotImplementedError, ...
            raise ValueError(f"{path}: not a readable NumPy file: {one_line(error)}") from None
        arrays = tuple(strip.claimed for strip in strips)
        sizes = [len(column) for column in _columns(path, arrays if len(arrays) > 1 else arrays[0])]
        if len(set(sizes)) != 1:
            raise ValueError(f"{path}: t, x, y and p must have equal lengths, got {', '.join(map(str, sizes))}")
        self.n_events = sizes[0]
        columns = range(4) if strips[0].is_by_columns else (None,)
        self._places = [(info, column) for info in wanted for column in columns]

    def blocks(self) -> Iterator[np.ndarray]:
        return _packed_blocks(self._unpacked())

    def _unpacked(self) -> Iterator[Four]:
        try:
            with ExitStack() as files:
                archive = files.enter_context(zipfile.ZipFile(self.path))
                strips = [_Strip(files.enter_context(archive.open(info)), info, k) for info, k in self._places]
                step = min(BLOCK_EVENTS, *(BLOCK_BYTES // strip.row_bytes for strip in strips))
                for start in range(0, self.n_events, step):
                    arrays = tuple(strip.read(min(step, self.n_events - start)) for strip in strips)
                    yield _columns(self.path, arrays if len(arrays) > 1 else arrays[0])
        except Exception as error:  # as above
            raise Damage(f"not a readable NumPy file: {one_line(error)}") from None


class _Strip:
    """An array in an archive, row by row; or one of its columns."""

    def __init__(self, file: IO[bytes], info: zipfile.ZipInfo, column: int | None = None) -> None:
        self._name, self._file = info.filename, file
        try:
            shape, fortran_order, self._dtype, _ = read_npy_header(self._file, info.file_size)
        except ValueError as error:
            raise ValueError(f"{info.filename}: {error}") from None
        self.is_by_columns = fortran_order and len(shape) == 2
        self._row = shape[1:] if column is None else ()
        self.row_bytes = math.prod(self._row) * self._dtype.itemsize
        if self.row_bytes > MOST_RECORD:
            raise ValueError(f"{info.filename}: an event must take at most {MOST_RECORD} bytes, got {self.row_bytes}")
        self.claimed = np.broadcast_to(np.empty((), self._dtype), shape)  # its form, in no memory
        skipped = 0 if column is None else column * shape[0] * self._dtype.itemsize
        while skipped > 0 and (piece := self._file.read(min(skipped, 1 << 20))):  # `seek` takes 16 MiB at a time
            skipped -= len(piece)

    def read(self, n: int) -> np.ndarray:
        """The next n >= 1 rows."""
        size = n * self.row_bytes
        data = self._file.read(size)
        if len(data) != size:
            raise ValueError(f"{self._name} ends before its array does")
        return np.frombuffer(data, self._dtype).reshape(n, *self._row)


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The archive's directory, by the names of its arrays."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name in members:
            raise ValueError(f"the archive holds `{name[:80]}` twice")
        members[name] = info
    return members


def _wanted(members: dict[str, zipfile.ZipInfo]) -> list[zipfile.ZipInfo]:
    """The one array of events, or their four columns."""
    if "events" in members:
        return [members["events"]]
    if all(any(name in members for name in names) for names in NAMES.values()):
        return [members[the_name(field, members, "the archive")] for field in NAMES]
    if len(members) == 1:
        return list(members.values())
    raise ValueError(f"a .npz recording has `events`, or t, x, y and p; got {sorted(members)[:8]}")


def _sensor(strip: _Strip) -> Sensor:
    shape, dtype = strip.claimed.shape, strip.claimed.dtype
    stored = strip.read(2) if shape == (2,) and dtype.kind in "iu" else None
    if stored is None or (stored < 1).any():
        got = f"shape {shape} of {dtype}" if stored is None else stored.tolist()
        raise ValueError(f"`sensor` must be two positive integers (width, height), got {got}")
    return int(stored[0]), int(stored[1])


def _packed_blocks(blocks: Iterable[Four]) -> Iterator[np.ndarray]:
    """Blocks of columns as events, up to the first that is none."""
    off: int | None = None  # how this file writes OFF, once it has: 0 or -1
    n_before = 0
    for columns in blocks:
        events, problem = packed(*columns)
        p = columns[3][: len(events)]
        if off is None and (p < 1).any():
            off = int(p[int(np.argmax(p < 1))])
        if off is not None and (mixed := p == -1 - off).any():
            events = events[: int(np.argmax(mixed))]
            problem = f"p = {-1 - off}, and before it {off}: polarity is 0/1 or -1/+1, not both"
        yield events
        n_before += len(events)
        if problem is not None:
            raise Damage(f"event {n_before}: {problem}")


def _columns(path: Path, array: Any) -> Four:
    """The columns t, x, y, p of an array of events, or of four, in whole numbers; their values are unchecked."""
    try:
        named = named_columns(array if isinstance(array, tuple) else _form(array))
        columns = named if named is not None else (np.empty(0, np.int64),) * 4
        if not all(c.ndim == 1 and c.dtype.kind in ("iub" if i == 3 else "iu") for i, c in enumerate(columns)):
            t, x, y, p = (column[:0] if column.ndim == 1 else column for column in columns)
            checked_columns(t, x, y, p, ANY_SENSOR)  # raises, and says what is wrong
        return columns
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {one_line(error)}") from None


def _form(array: np.ndarray) -> Any:
    """A form of events that the door takes."""
    if array.dtype.names is not None and array.ndim:
        return array
    if array.ndim == 2 and array.shape[1] == 4:
        return tuple(array.T)
    raise ValueError(
        "expected a structured array with fields t, x, y, p or an (N, 4) array of those columns, "
        f"got shape {array.shape} of {array.dtype}"
    )


def open_npy(path: Path) -> Source:
    """Open a `.npy` recording."""
    return NpySource(path)


def open_npz(path: Path) -> Source:
    """Open a `.npz` recording; all of it is read once.

    Raises
    ------
    ValueError : damaged, not laid out as the module says, or an event off the stated sensor.
    OSError : missing or not readable.
    """
    source = NpzSource(path)
    kept, n_read = [np.empty(0, EVENT_DTYPE)], 0
    try:
        for block in source.blocks():
            events, problem = on_sensor(block, source.sensor, n_read)
            if problem is not None:
                raise Damage(problem)
            n_read += len(events)
            if source.n_events <= KEPT_EVENTS:
                kept.append(events)
    except Damage as damage:
        raise ValueError(f"{path}: {damage.reason}") from None
    return ArraySource(np.concatenate(kept), source.sensor) if source.n_events <= KEPT_EVENTS else source
