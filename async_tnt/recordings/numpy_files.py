"""Recordings as NumPy files: `.npy` and `.npz`.

`.npy`   a structured array with the fields t, x, y, p in any order (names as at the door, see `events`), or an
         (N, 4) integer array of columns t, x, y, p. Mapped, and read block by block.
`.npz`   one such array under the name `events` (or the only array in the file), or four arrays t, x, y, p;
         beside either, `sensor` = (width, height) where it is known. A zip archive cannot be mapped: it is loaded.

Times are integer microseconds; polarity is bool, 0/1 or -1/+1. Nothing is unpickled.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.event_forms import NAMES, Four, named_columns
from async_tnt.events import as_events, checked_columns
from async_tnt.recordings.damage import Damage
from async_tnt.recordings.source import BLOCK_EVENTS, Source, packed

ANY_SENSOR = (1 << 16, 1 << 16)  # what uint16 pixels can say
MOST_PACKED = 1100  # zip's deflate makes 1032 bytes one at best


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
            size = os.fstat(file.fileno()).st_size
        try:
            array = self._map()
            start = int(array.offset)
        # Everything: numpy evaluates the header as a Python literal, so that one damaged byte can surface as
        # TokenError, OverflowError and a dozen others.
        except Exception as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from error
        if start + array.nbytes != size:
            raise ValueError(
                f"{path}: not a readable NumPy file: its header says {array.nbytes} bytes of {array.dtype} in shape "
                f"{array.shape}, but {size - start} follow"
            )
        self._n_events = len(_columns(path, array)[0])

    def blocks(self) -> Iterator[np.ndarray]:
        off: int | None = None  # how this file writes OFF, once it has: 0 or -1
        for start in range(0, self._n_events, BLOCK_EVENTS):
            # mapped anew for each block: pages that were read stay in memory as long as their map does
            columns = _columns(self.path, self._map()[start : start + BLOCK_EVENTS])
            events, problem = packed(*columns)
            p = columns[3][: len(events)]
            if off is None and (p < 1).any():
                off = int(p[int(np.argmax(p < 1))])
            if off is not None and (mixed := p == -1 - off).any():
                events = events[: int(np.argmax(mixed))]
                problem = f"p = {-1 - off}, and before it {off}: polarity is 0/1 or -1/+1, not both"
            yield events
            if problem is not None:
                raise Damage(f"event {start + len(events)}: {problem}")

    def _map(self) -> np.memmap:
        return np.lib.format.open_memmap(self.path, mode="r")


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
    if arrays is None:
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


def _load(path: str | os.PathLike[str]) -> dict[str, np.ndarray] | None:
    """The arrays of a zip archive by name; None if it is no archive."""
    with Path(path).open("rb") as file:  # here, so that a missing file is an OSError and nothing below is
        try:
            loaded = np.load(file, allow_pickle=False)
            if not isinstance(loaded, np.lib.npyio.NpzFile):
                return None
            assert loaded.zip is not None  # it is open
            for info in loaded.zip.infolist():
                _check_member(loaded.zip, info, os.fstat(file.fileno()).st_size)
            return {name: loaded[name] for name in loaded.files}
        # Everything: numpy evaluates the header as a Python literal, so that one damaged byte can surface as
        # TokenError, BadZipFile and a dozen others.
        except Exception as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from error


def _check_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, size: int) -> None:
    """Refuse what would make numpy ask for more memory than the file can fill: it believes each array's header."""
    if info.file_size > MOST_PACKED * size:
        raise ValueError(f"{info.filename} claims {info.file_size} bytes, more than {size} bytes of file can hold")
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(member)
        claimed = member.tell() + math.prod(shape) * dtype.itemsize
    if claimed != info.file_size and not dtype.hasobject:  # numpy says itself that it does not unpickle
        raise ValueError(f"{info.filename} claims {claimed} bytes and has {info.file_size}")


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


def _columns(path: Path, array: np.ndarray) -> Four:
    """The columns t, x, y, p of events in whole numbers; their values are unchecked."""
    try:
        named = named_columns(_form(path, array))
        columns = named if named is not None else (np.empty(0, np.int64),) * 4
        if not all(c.ndim == 1 and c.dtype.kind in ("iub" if i == 3 else "iu") for i, c in enumerate(columns)):
            t, x, y, p = (column[:1] if column.ndim == 1 else column for column in columns)
            checked_columns(t, x, y, p, ANY_SENSOR)  # raises, and says what is wrong
        return columns
    except (TypeError, ValueError) as error:
        raise ValueError(str(error) if str(path) in str(error) else f"{path}: {error}") from None


def _checked(path: str | os.PathLike[str], form: Any, sensor: tuple[int, int]) -> np.ndarray:
    try:
        return as_events(form, sensor)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def _sensor(path: str | os.PathLike[str], stored: np.ndarray) -> tuple[int, int]:
    if stored.shape != (2,) or stored.dtype.kind not in "iu" or (stored < 1).any():
        raise ValueError(f"{path}: `sensor` must be two positive integers (width, height), got {stored!r}")
    return int(stored[0]), int(stored[1])


def open_npy(path: Path) -> Source:
    """Open a `.npy` recording."""
    return NpySource(path)
