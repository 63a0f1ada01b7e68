"""Reads an HDF5 file with h5py, in the process of `child_end.py`; see `hdf5.py`.

It says `sensor`: [width, height], or null, `types`: those of t, x, y, p, and `offset`: microseconds to add to t. A
packet is its four columns, one after the other.
"""

from __future__ import annotations

import re
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np

BLOCK_EVENTS = 1 << 16
COLUMNS = ("t", "x", "y", "p")
MOST_LINKS = 16  # within the file, one to another
FILTERS = {0x8ECF: "Prophesee's ECF: install its plugin, hdf5_ecf, and let HDF5_PLUGIN_PATH name its folder"}
PLUGIN_HINT = "pip install hdf5plugin, or let HDF5_PLUGIN_PATH name the plugin's folder"


class Refused(Exception):
    """What is wrong with the file, in our words."""


def write_events(path: str, out: Any) -> None:
    """Tell an `Out` what the file holds, and then the error if there is one."""
    import h5py

    is_open = False
    try:
        with h5py.File(path, "r") as file:
            sets, offset = _layout(h5py, file)
            types = [data.dtype for data in sets] if len(sets) > 1 else [sets[0].dtype[name] for name in COLUMNS]
            sensor = _geometry(file) if len(sets) == 1 else None
            out.open(sensor=sensor, types=[dtype.str for dtype in types], offset=offset)
            is_open = True
            n_events = sets[0].shape[0]
            rows = [_Rows(data) for data in sets]
            for start in range(0, n_events, BLOCK_EVENTS):
                stop = min(start + BLOCK_EVENTS, n_events)
                blocks = [each.read(start, stop) for each in rows]
                columns = blocks if len(blocks) > 1 else [blocks[0][name] for name in COLUMNS]
                out.packet(stop - start, b"".join(column.tobytes() for column in columns))
    except BrokenPipeError:
        raise
    except Refused as error:
        return out.end(str(error))
    except Exception as error:  # a damaged file surfaces as OSError, RuntimeError, KeyError, TypeError, ...
        told = f"{type(error).__name__}: {error}"
        return out.end(told if is_open else f"not a readable HDF5 file: {told}")
    return out.end()


class _Rows:
    """Rows of a data set, of which each chunk is decompressed once: HDF5's own cache holds no large ones."""

    def __init__(self, data: Any) -> None:
        chunk = data.chunks[0] if data.chunks else BLOCK_EVENTS
        self._data = data
        self._span = chunk * max(1, BLOCK_EVENTS // chunk)  # read at once
        self._first = -1
        self._held: Any = None

    def read(self, start: int, stop: int) -> Any:
        """Rows [start, stop), start not before that of the call before."""
        parts = []
        while start < stop:
            first = start - start % self._span
            if first != self._first:
                self._held = None  # no room for two is needed
                self._first, self._held = first, self._data[first : first + self._span]
            parts.append(self._held[start - first : stop - first])
            start = min(stop, first + self._span)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _layout(h5py: Any, file: Any) -> tuple[list[Any], int]:
    """The data sets: of columns t, x, y, p, or of records; and what to add to t."""
    offset = None
    sets = [_found(h5py, file, f"events/{name}") for name in COLUMNS]
    what = "events/t, x, y, p"
    if None not in sets:
        offset = _found(h5py, file, "t_offset")
    else:
        sets = [_found(h5py, file, "CD/events")]
        what = "CD/events"
    if None in sets:
        raise Refused(f"expected events/t, x, y, p (DSEC) or CD/events (Metavision), got {sorted(file)[:8]}")
    for data in [*sets, *([] if offset is None else [offset])]:
        if not isinstance(data, h5py.Dataset):
            raise Refused(f"{what} and `t_offset` must be data sets, but {data.name} is a {type(data).__name__}")
        if data.is_virtual or data.id.get_create_plist().get_external_count():
            raise Refused(f"{data.name} must be stored in the file itself, but its values are kept in other files")
    if offset is not None and offset.size != 1:
        raise Refused(f"`t_offset` must be one number, got shape {offset.shape}")
    offset = 0 if offset is None else int(offset[()].item())
    sizes = {data.shape for data in sets}
    if len(sizes) != 1 or len(min(sizes)) != 1:
        raise Refused(f"{what} must have one dimension and equal lengths, got {sorted(sizes)}")
    types = [data.dtype for data in sets]
    if len(sets) == 1:
        if not all(name in (types[0].names or ()) for name in COLUMNS):
            raise Refused(f"CD/events must be records of t, x, y, p, got {types[0]}")
        types = [types[0][name] for name in COLUMNS]
    if not all(dtype.kind in ("iub" if name == "p" else "iu") for name, dtype in zip(COLUMNS, types, strict=True)):
        raise Refused(f"{what} must be whole numbers, got {', '.join(map(str, types))}")
    if not abs(offset) < 1 << 62:
        raise Refused(f"`t_offset` must be below 2**62 microseconds, got {offset}")
    for data in sets:
        _check_filters(h5py, data)
        _check_filled(data)
    return sets, offset


def _found(h5py: Any, group: Any, path: str, n_links: int = 0) -> Any:
    """What lies at a path, None if nothing does. HDF5 itself would follow links to other files."""
    if path.startswith("/"):
        group = group.file
    for name in filter(None, path.split("/")):
        link = group.get(name, getlink=True) if isinstance(group, h5py.Group) else None
        if isinstance(link, h5py.ExternalLink):
            raise Refused(f"{name} must be stored in the file itself, but it is a link to {link.filename!r}")
        if isinstance(link, h5py.SoftLink):
            if n_links == MOST_LINKS:
                raise Refused(f"{name} is a link to a link to a link, {MOST_LINKS} times")
            group = _found(h5py, group, link.path, n_links + 1)
        else:
            group = None if link is None else group[name]
        if group is None:
            return None
    return group


def _check_filters(h5py: Any, data: Any) -> None:
    plist = data.id.get_create_plist()
    for i in range(plist.get_nfilters()):
        code, name = plist.get_filter(i)[0], plist.get_filter(i)[3]
        if h5py.h5z.filter_avail(code):
            continue
        with suppress(ImportError):
            import_module("hdf5plugin")  # registers its filters
        if not h5py.h5z.filter_avail(code):
            said = name.decode("ascii", "backslashreplace").split(";")[0] or "a filter"
            hint = FILTERS.get(code) or f"{said} (filter {code}), which is missing: {PLUGIN_HINT}"
            raise Refused(f"its events are compressed by {hint}")


def _check_filled(data: Any) -> None:
    """Refuse what the file does not hold: HDF5 reads zeros there, as many as the header says."""
    if data.chunks is None:
        needed, have, what = data.size * data.dtype.itemsize, data.id.get_storage_size(), "bytes"
    else:
        needed, have, what = -(-data.size // data.chunks[0]), data.id.get_num_chunks(), "chunks"
    if have < needed:
        raise Refused(
            f"{data.name} says that it has {data.size} events, but the file holds {have} of their {needed} {what}"
        )


def _geometry(file: Any) -> tuple[int, int] | None:
    geometry = file.attrs.get("geometry")
    if isinstance(geometry, bytes):
        geometry = geometry.decode("ascii", "replace")
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", geometry) if isinstance(geometry, str) else None
    return (int(match[1]), int(match[2])) if match else None
