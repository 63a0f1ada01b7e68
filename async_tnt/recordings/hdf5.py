"""HDF5 files of events (`.h5`, `.hdf5`), by h5py (extra `hdf5`), in one of two layouts.

DSEC         events/t, x, y, p: a data set each; t_offset: microseconds to add to t. `ms_to_idx` is not needed here.
Metavision   CD/events: records of x, y, p, t; the sensor as an attribute, `geometry` = "1280x720".

Both are compressed by filters that HDF5 does not bring along: DSEC by Blosc (`pip install hdf5plugin`),
Metavision by ECF (the plugin of Prophesee's hdf5_ecf, which HDF5_PLUGIN_PATH has to name).

References
----------
Gehrig, Aarents, Gehrig, Scaramuzza 2021, DSEC: A Stereo Event Camera Dataset for Driving Scenarios, RA-L.
Prophesee, Metavision documentation: HDF5 event file format.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.recordings.damage import Damage
from async_tnt.recordings.source import BLOCK_EVENTS, Sensor, Source, packed

FILTERS = {0x8ECF: "Prophesee's ECF: install its plugin, hdf5_ecf, and let HDF5_PLUGIN_PATH name its folder"}
PLUGIN_HINT = "pip install hdf5plugin, or let HDF5_PLUGIN_PATH name the plugin's folder"
COLUMNS = ("t", "x", "y", "p")


class Hdf5Source(Source):
    """The events of an HDF5 file in DSEC's or Metavision's layout.

    Raises
    ------
    ImportError : h5py is not installed.
    ValueError : no HDF5 file, another layout, or a filter that is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._h5py: Any = import_module("h5py")
        except ImportError as error:
            raise ImportError(f"{path}: HDF5 files are read by h5py: pip install '.[hdf5]' ({error})") from error
        self.path = path
        path.open("rb").close()  # so that a missing file is an OSError
        try:
            with self._h5py.File(path, "r") as file:
                _, n_events, self._offset_us = self._layout(file)
                self._check_filled(file)
                self.sensor = _geometry(file) if "CD" in file else None
        except ValueError:
            raise
        except Exception as error:  # a damaged file surfaces as OSError, RuntimeError, KeyError, TypeError, ...
            raise ValueError(f"{path}: not a readable HDF5 file: {_line(error)}") from None
        self._n_events = n_events

    def blocks(self) -> Iterator[np.ndarray]:
        n_read = 0
        try:
            file = self._h5py.File(self.path, "r")
        except Exception as error:
            raise Damage(f"after event 0: {_line(error)}") from None
        with file:
            while n_read < self._n_events:
                try:
                    read, _, _ = self._layout(file)
                    columns = read(n_read, min(n_read + BLOCK_EVENTS, self._n_events))
                    t = columns[0].astype(np.int64)
                except Exception as error:  # whatever h5py makes of a damaged chunk
                    raise Damage(f"after event {n_read}: {_line(error)}") from None
                if columns[0].dtype.kind == "u" and (t < 0).any():  # beyond int64
                    t = np.where(t < 0, -1 - abs(self._offset_us), t)
                events, problem = packed(t + self._offset_us, *columns[1:])
                yield events
                n_read += len(events)
                if problem is not None:
                    raise Damage(f"event {n_read}: {problem}")

    def _layout(self, file: Any) -> tuple[Callable[[int, int], list[np.ndarray]], int, int]:
        """A function that reads columns t, x, y, p of events a to b; how many there are; what to add to t."""
        h5py = self._h5py
        if "events" in file and all(name in file["events"] for name in COLUMNS):
            sets = [file["events"][name] for name in COLUMNS]
            what = "events/t, x, y, p"
            sizes = {data.shape for data in sets}
            offset = int(file["t_offset"][()]) if "t_offset" in file else 0
            types = [data.dtype for data in sets]

            def read(start: int, stop: int) -> list[np.ndarray]:
                return [data[start:stop] for data in sets]

        elif "CD" in file and "events" in file["CD"]:
            records = file["CD"]["events"]
            what = "CD/events"
            sets, sizes, offset = [records], {records.shape}, 0
            names = records.dtype.names or ()
            if not all(name in names for name in COLUMNS):
                raise ValueError(f"{self.path}: CD/events must be records of t, x, y, p, got {records.dtype}")
            types = [records.dtype[name] for name in COLUMNS]

            def read(start: int, stop: int) -> list[np.ndarray]:
                block = records[start:stop]
                return [block[name] for name in COLUMNS]

        else:
            raise ValueError(
                f"{self.path}: expected events/t, x, y, p (DSEC) or CD/events (Metavision), got {sorted(file)[:8]}"
            )
        if not all(isinstance(data, h5py.Dataset) for data in sets) or len(sizes) != 1 or len(min(sizes)) != 1:
            raise ValueError(f"{self.path}: {what} must have one dimension and equal lengths, got {sorted(sizes)}")
        if not all(dtype.kind in ("iub" if name == "p" else "iu") for name, dtype in zip(COLUMNS, types, strict=True)):
            raise ValueError(f"{self.path}: {what} must be whole numbers, got {', '.join(map(str, types))}")
        if not abs(offset) < 1 << 62:
            raise ValueError(f"{self.path}: `t_offset` must be below 2**62 microseconds, got {offset}")
        for data in sets:
            self._check_filters(data)
        return read, min(sizes)[0], offset

    def _check_filled(self, file: Any) -> None:
        """Refuse what the file does not hold: HDF5 reads zeros there, as many as the header says."""
        for data in [file["events"][name] for name in COLUMNS] if "events" in file else [file["CD"]["events"]]:
            if data.chunks is None:
                needed, have = data.size * data.dtype.itemsize, data.id.get_storage_size()
                what = "bytes"
            else:
                needed, have, what = -(-data.size // data.chunks[0]), data.id.get_num_chunks(), "chunks"
            if have < needed:
                raise ValueError(
                    f"{self.path}: {data.name} says that it has {data.size} events, but the file holds {have} of "
                    f"their {needed} {what}"
                )

    def _check_filters(self, data: Any) -> None:
        plist = data.id.get_create_plist()
        for i in range(plist.get_nfilters()):
            code, name = plist.get_filter(i)[0], plist.get_filter(i)[3]
            if self._h5py.h5z.filter_avail(code):
                continue
            with suppress(ImportError):
                import_module("hdf5plugin")  # registers its filters
            if not self._h5py.h5z.filter_avail(code):
                said = name.decode("ascii", "backslashreplace").split(";")[0] or "a filter"
                hint = FILTERS.get(code) or f"{said} (filter {code}): {PLUGIN_HINT}"
                raise ValueError(f"{self.path}: its events are compressed by {hint}")


def _geometry(file: Any) -> Sensor | None:
    geometry = file.attrs.get("geometry")
    if isinstance(geometry, bytes):
        geometry = geometry.decode("ascii", "replace")
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", geometry) if isinstance(geometry, str) else None
    return (int(match[1]), int(match[2])) if match else None


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def open_hdf5(path: Path) -> Source:
    """Open an HDF5 file of events."""
    return Hdf5Source(path)
