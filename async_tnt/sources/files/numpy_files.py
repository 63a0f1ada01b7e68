"""Recordings as NumPy files: `.npy` and `.npz`.

`.npy`   a structured array with the fields t, x, y, p in any order (or other names of
         `event_forms`), or an (N, 4) integer array of columns t, x, y, p. Memory-mapped, and read
         block by block.
`.npz`   one such array under the name `events` (or the only array in the file), or four arrays t,
         x, y, p; optionally `sensor` = (width, height). Read and checked as a whole; other arrays
         are not read.

Times are integer microseconds; polarity is bool, 0/1 or -1/+1. Nothing is unpickled. An array is
accepted only if its header fits the bytes that follow it. NumPy's own reader would allocate the
memory that a header claims. It would report a damaged header in several lines, some of which advise
unpickling the file.
"""

from __future__ import annotations

import math
import os
import warnings
import zipfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Literal

import numpy as np

from async_tnt.base.files import open_regular, refuse_git_lfs, user_path
from async_tnt.base.messages import one_line, short
from async_tnt.sources.files.source import (
    BLOCK_EVENTS,
    ArraySource,
    CorruptData,
    ReadOptions,
    Source,
    valid_blocks,
)
from async_tnt.sources.files.source_error import SourceError
from async_tnt.volume.event_forms import (
    NAMES,
    Four,
    event_columns,
    likely_order,
    named_columns,
    the_name,
)
from async_tnt.volume.events import ANY_SENSOR, checked_columns
from async_tnt.volume.sensor import Sensor

MAGIC = b"\x93NUMPY"
"""The first bytes of every .npy file."""

MAX_HEADER_BYTES = 1 << 16
"""Bytes of the longest header that is read: NumPy alone reads what a header claims, up to 4 GiB."""

MAX_NPZ_BYTES = 1 << 31
"""Bytes of the largest array that is read from an archive: a small archive may unpack to any
size."""


def read_npy_header(file: IO[bytes], size: int) -> tuple[np.ndarray, bool]:
    """The array that a header describes. The header is read from a file's first byte to the array.

    Parameters
    ----------
    size : bytes of the whole file.

    Returns
    -------
    An array of the type and shape that the header claims, which takes no memory, and whether the
    file has it in Fortran's order.

    Raises
    ------
    ValueError : there is no header, its array is of Python objects, or its array does not fill the
        rest of the file. The message is one line without the file's name.
    """
    prefix = file.read(8)
    if len(prefix) < 8 or not prefix.startswith(MAGIC):
        raise ValueError(f"it must begin with {MAGIC!r}, got {prefix!r}")

    if prefix[6] == 1:  # the version of the format
        length_bytes = 2
        read_header = np.lib.format.read_array_header_1_0
    else:
        length_bytes = 4
        read_header = np.lib.format.read_array_header_2_0
    try:
        length = file.read(length_bytes)
        header = file.read(min(int.from_bytes(length, "little"), MAX_HEADER_BYTES))
        with warnings.catch_warnings():  # Python's compiler warns about damaged literals
            warnings.simplefilter("ignore")
            shape, is_fortran, dtype = read_header(BytesIO(length + header))
        described = np.broadcast_to(np.empty((), dtype), shape)
    # NumPy evaluates the header as a Python literal: SyntaxError, TokenError, RecursionError, ...
    except Exception:
        raise ValueError("its header does not describe an array") from None

    if dtype.hasobject:
        raise ValueError(
            "it holds Python objects, which are not unpickled; save it as an array of numbers"
        )
    n_bytes_left = size - file.tell()
    if math.prod(shape) * dtype.itemsize != n_bytes_left or dtype.subdtype is not None:
        raise ValueError(
            f"its header claims an array of {str(dtype)[:200]} in shape {shape}, but "
            f"{n_bytes_left} bytes follow"
        )
    return described, is_fortran


def map_npy(path: str | os.PathLike[str]) -> np.memmap:
    """The array of a `.npy` file, mapped into memory, read-only.

    Raises
    ------
    ValueError : the file is damaged, or a pointer of Git LFS.
    """
    path = user_path(path)
    refuse_git_lfs(path)
    with open_regular(path) as file:
        try:
            claimed, is_fortran = read_npy_header(file, os.fstat(file.fileno()).st_size)
        except ValueError as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from None
        order: Literal["F", "C"] = "F" if is_fortran else "C"
        return np.memmap(file, claimed.dtype, "r", file.tell(), claimed.shape, order)


class NpySource(Source):
    """The events of a `.npy` file, which does not state the sensor."""

    format = "NumPy array"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        self._order = options.columns
        array = map_npy(path)
        try:
            _columns(self._order, array[:BLOCK_EVENTS] if array.ndim else array)
        except SourceError as error:
            raise error.of(path) from None
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {one_line(error)}") from None
        self._n_events = len(array)

    def blocks(self) -> Iterator[np.ndarray]:
        return valid_blocks(map(self._block, range(0, self._n_events, BLOCK_EVENTS)))

    def _block(self, start: int) -> Four:
        # The file is mapped again for each block: pages that were read stay in memory as long as
        # their map does.
        try:
            return _columns(self._order, map_npy(self.path)[start : start + BLOCK_EVENTS])
        except ValueError as error:
            raise CorruptData(f"after {start} events: {one_line(error)}") from None


def open_npz(path: Path, options: ReadOptions) -> Source:
    """Open a `.npz` recording; all of it is read and checked."""
    path.open("rb").close()  # raises the OSError of a missing file
    try:
        sensor, events = _read_npz(path, options.columns)
    except SourceError as error:
        raise error.of(path, "not a readable NumPy file: ") from None
    except Exception as error:  # a damaged archive raises exceptions of any type
        raise ValueError(f"{path}: not a readable NumPy file: {one_line(error)}") from None
    return ArraySource(events, sensor, "NumPy archive")


def _read_npz(path: Path, order: str | None) -> tuple[Sensor | None, np.ndarray]:
    """The sensor, None if the archive does not state it, and all events.

    Parameters
    ----------
    order : see `_columns`.
    """
    with zipfile.ZipFile(path) as archive:
        members = _members(archive)
        sensor = None
        if "sensor" in members:
            sensor = _sensor(_read(archive, members.pop("sensor")))
        arrays = [_read(archive, info) for info in _event_members(members)]
    columns = _columns(order, *arrays)
    sizes = [len(column) for column in columns]
    if len(set(sizes)) != 1:
        raise ValueError(f"t, x, y and p must have equal lengths, got {', '.join(map(str, sizes))}")
    (events,) = valid_blocks([columns])
    return sensor, events


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The files of an archive by their names without `.npy`.

    Raises
    ------
    ValueError : two files have the same name.
    """
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name in members:
            raise ValueError(
                f"it holds the array {short(name)} more than once; leave out all but one"
            )
        members[name] = info
    return members


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """An array in an archive."""
    name = info.filename
    size = info.file_size
    if size > MAX_NPZ_BYTES:
        raise ValueError(
            f"{name} takes {size:,} bytes; more than {MAX_NPZ_BYTES:,} can be read from a .npy "
            "file only"
        )
    with archive.open(info) as file:
        try:
            claimed, is_fortran = read_npy_header(file, size)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        data = file.read(claimed.nbytes)
    if len(data) != claimed.nbytes:
        raise ValueError(f"{name} ends before its array does")
    order: Literal["F", "C"] = "F" if is_fortran else "C"
    return np.frombuffer(data, claimed.dtype).reshape(claimed.shape, order=order)


def _event_members(members: dict[str, zipfile.ZipInfo]) -> list[zipfile.ZipInfo]:
    """The members that hold the events: one array, or the four columns t, x, y, p."""
    if "events" in members:
        return [members["events"]]
    if all(any(name in members for name in names) for names in NAMES.values()):
        return [members[the_name(field, members, "the archive")] for field in NAMES]
    if len(members) == 1:
        return list(members.values())
    raise ValueError(f"a .npz recording has `events`, or t, x, y and p; got {sorted(members)[:8]}")


def _sensor(array: np.ndarray) -> Sensor:
    """The sensor's sides (width, height) from the array `sensor` of an archive."""
    rule = f"its array 'sensor' must be two integers (width, height) in [1, {max(ANY_SENSOR)}]"
    if array.shape != (2,) or array.dtype.kind not in "iu":
        raise ValueError(f"{rule}, got shape {array.shape} of {array.dtype}")
    width, height = array.tolist()
    if not 1 <= min(width, height) <= max(width, height) <= max(ANY_SENSOR):
        raise ValueError(f"{rule}, got {[width, height]}")
    return width, height


def _columns(order: str | None, *arrays: np.ndarray) -> Four:
    """The columns t, x, y, p, which hold whole numbers. Their values are not checked.

    Parameters
    ----------
    order : order of the columns of a plain array, as the caller states it; None: t, x, y, p.
    arrays : one array of events, or four columns.
    """
    array = arrays[0]
    if len(arrays) == 1 and (array.dtype.names is None or array.ndim == 0):
        if array.ndim != 2 or array.shape[1] != 4:
            raise ValueError(
                "expected a structured array with fields t, x, y, p or an (N, 4) array of those "
                f"columns, got shape {array.shape} of {array.dtype}"
            )
        # A table of another type is refused below, with the name of a column.
        arrays = _table_columns(array, order) if array.dtype.kind in "iu" else tuple(array.T)
    columns = named_columns(arrays if len(arrays) > 1 else array)
    if columns is None:
        no_values = np.empty(0, np.int64)
        columns = (no_values, no_values, no_values, no_values)
    t, x, y, p = columns
    is_whole = all(column.dtype.kind in "iu" for column in (t, x, y)) and p.dtype.kind in "iub"
    if not is_whole or any(column.ndim != 1 for column in columns):
        # this raises an error that names the column and its type; it needs no values for that
        empty = [column[:0] if column.ndim == 1 else column for column in columns]
        checked_columns(empty[0], empty[1], empty[2], empty[3], ANY_SENSOR)
    return columns


def _table_columns(table: np.ndarray, order: str | None) -> Four:
    """The columns t, x, y, p of a table.

    Parameters
    ----------
    order : order of the columns, as the caller states it; None: t, x, y, p.

    Raises
    ------
    SourceError : no order is stated, and the numbers look like another order than t, x, y, p.
    """
    usual_order = "txyp"
    likely = likely_order(table, usual_order) if order is None else usual_order
    if likely != usual_order:
        # {columns} stands for the name of the parameter, see `SourceError`.
        raise SourceError(
            "",
            f"the columns are not {usual_order!r}; they look like {likely!r}: state their order "
            "with {columns}, or save a structured array",
        )
    return event_columns(table, order or usual_order)
