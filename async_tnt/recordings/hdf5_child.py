"""Reads an HDF5 file with h5py, in the process of `child_end.py`; see `hdf5.py`.

It says `sensor`: [width, height], or null, `types`: those of t, x, y, p, and `offset`: microseconds to add to t. A
packet is its four columns, one after the other.
"""

from __future__ import annotations

import re
from contextlib import suppress
from importlib import import_module
from typing import Any

BLOCK_EVENTS = 1 << 16
COLUMNS = ("t", "x", "y", "p")
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
            sensor = _geometry(file) if "CD" in file else None
            out.open(sensor=sensor, types=[dtype.str for dtype in types], offset=offset)
            is_open = True
            n_events = sets[0].shape[0]
            for start in range(0, n_events, BLOCK_EVENTS):
                stop = min(start + BLOCK_EVENTS, n_events)
                blocks = [data[start:stop] for data in sets]
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


def _layout(h5py: Any, file: Any) -> tuple[list[Any], int]:
    """The data sets: of columns t, x, y, p, or of records; and what to add to t."""
    offset = 0
    if "events" in file and all(name in file["events"] for name in COLUMNS):
        sets = [file["events"][name] for name in COLUMNS]
        what = "events/t, x, y, p"
        offset = int(file["t_offset"][()]) if "t_offset" in file else 0
    elif "CD" in file and "events" in file["CD"]:
        sets = [file["CD"]["events"]]
        what = "CD/events"
    else:
        raise Refused(f"expected events/t, x, y, p (DSEC) or CD/events (Metavision), got {sorted(file)[:8]}")
    if not all(isinstance(data, h5py.Dataset) for data in sets):
        raise Refused(f"{what} must be data sets")
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
