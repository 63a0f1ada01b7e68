"""Readers of AEDAT4 and ES files, by faery, and of HDF5 files, by h5py.

They run in a worker process (`worker_source.py`). The worker imports this module, which must import
nothing that takes time. (`ros_reader.py` is another such module.) A reader is a function of a path.
It yields the sensor, (width, height) or None, then blocks of events, each as a list of four columns
of integers: t, x, y, p. It raises an exception where the file cannot be read on.

HDF5 files of three layouts are read:

DSEC         events/t, x, y, p: a data set each; t_offset: microseconds to add to t. `ms_to_idx` is
             not needed here.
RVT, eTraM   the same without t_offset; events/width, height: the sensor.
Metavision   CD/events: records of x, y, p, t; the sensor as an attribute, `geometry` = "1280x720".

HDF5 does not include the filters that compress two of these layouts. DSEC's files are compressed by
Blosc (`pip install hdf5plugin`), Metavision's by ECF (the plugin of Prophesee's hdf5_ecf, which
HDF5_PLUGIN_PATH has to name).

References
----------
Gehrig, Aarents, Gehrig, Scaramuzza 2021, DSEC: A Stereo Event Camera Dataset for Driving Scenarios,
RA-L. Gehrig, Scaramuzza 2023, Recurrent Vision Transformers for Object Detection with Event
Cameras, CVPR: its data sets. Prophesee, Metavision documentation: HDF5 event file format.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 4 << 30
"""Bytes of address space that the worker may use. A block takes megabytes, but a damaged file may
ask for any number of bytes."""

BLOCK_EVENTS = 1 << 16
"""Number of events that are read together."""

CACHE_BYTES = 1 << 26
"""Bytes of HDF5's cache for each data set. A chunk that does not fit into it is decompressed again
for every block."""

COLUMNS = ("t", "x", "y", "p")
"""Names of the columns of a block, in their order."""

ES_SENSOR_AT = 16
"""Byte of an ES file at which width and height begin, 16 bits each."""

MAX_SIDE = 1 << 16
"""Pixels of the longest side that a file may state."""

ECF = 0x8ECF
"""HDF5's number of the filter that compresses Metavision's files."""

ECF_HINT = "Prophesee's ECF: install its plugin, hdf5_ecf, and let HDF5_PLUGIN_PATH name its folder"
PLUGIN_HINT = "pip install hdf5plugin, or let HDF5_PLUGIN_PATH name the plugin's folder"

Reader = Callable[[str], Iterator[Any]]
"""Function of a path that yields a file's sensor, then blocks of its events."""

_blocks: Iterator[Any] = iter(())
"""Blocks of the file that this process reads."""


def start(read: Reader, path: str) -> Any:
    """Start to read a file, and return its sensor, the first value that the reader yields.

    `next_block` then returns its events.
    """
    global _blocks
    _limit_memory()
    _blocks = read(path)
    return next(_blocks)


def head_of(read: Reader, path: str) -> tuple[Any, Any]:
    """A file's sensor, and its first block of events, or None if it has no events.

    The file is closed again, because HDF5 lets nobody write a file that is open.
    """
    global _blocks
    head = start(read, path)
    first = next(_blocks, None)
    _blocks = iter(())
    return head, first


def next_block() -> Any:
    """The next block that the reader yields; None at the end."""
    return next(_blocks, None)


def _limit_memory() -> None:
    """Let allocations beyond `MAX_BYTES` fail in this process."""
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))


# -- readers ---------------------------------------------------------------------------------------


def read_aedat4(path: str) -> Iterator[Any]:
    """The first stream of events in an AEDAT4 file (`.aedat4`) of DV."""
    from faery.extension import aedat

    decoder = aedat.Decoder(path)
    tracks = decoder.tracks()
    with_events = [track for track in tracks if track.data_type == "events"]
    if not with_events:
        kinds = ", ".join(track.data_type for track in tracks) or "none"
        raise ValueError(f"it must have a stream of events; its streams are: {kinds}")
    track = with_events[0]
    yield None if track.dimensions is None else tuple(map(int, track.dimensions))
    for packet_track, packet in decoder:
        if packet_track.id == track.id and packet_track.data_type == "events" and len(packet):
            yield [packet[name] for name in ("t", "x", "y", "on")]


def read_es(path: str) -> Iterator[Any]:
    """The events of an Event Stream file (`.es`).

    They are DVS events, or the ATIS events that report a change of light.

    faery drops the packet in which it finds damage. It does not report a file that ends within an
    event.
    """
    from faery.extension import es

    decoder = es.Decoder(path, 0)
    if decoder.event_type not in ("dvs", "atis"):
        raise ValueError(f"expected DVS or ATIS events, got {decoder.event_type}")
    width, height = decoder.dimensions
    if not width * height:
        raise ValueError(f"a sensor must have at least one pixel a side, got {width} x {height}")
    yield width, height
    n_read = 0
    try:
        for packet in decoder:
            yield _es_columns(packet, decoder.event_type, height)
            n_read += len(packet)
    except Exception as error:
        # faery's error for an event off the sensor
        if "overflow" not in str(error):
            raise
        yield from _es_off_sensor(es, path, n_read, height)


def _es_columns(packet: np.ndarray, event_type: str, height: int) -> list[np.ndarray]:
    """The columns of a packet; the format counts y from the bottom."""
    if event_type == "atis":
        packet = packet[~packet["exposure"]]
    return [packet["t"], packet["x"], height - 1 - packet["y"].astype(np.int64), packet["p"]]


def _es_off_sensor(es: Any, path: str, n_read: int, height: int) -> Iterator[Any]:
    """The columns after the first `n_read` events of a file with events off its sensor.

    faery reads such a file only up to the first event off the sensor. So faery is given a copy of
    the file whose header states the largest sensor.
    """
    import shutil
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        copy = Path(folder, "copy.es")
        shutil.copyfile(path, copy)
        with copy.open("r+b") as file:
            file.seek(ES_SENSOR_AT)
            file.write(b"\xff" * 4)
        decoder = es.Decoder(str(copy), 0)
        n_decoded = 0
        for packet in decoder:
            new = packet[max(0, n_read - n_decoded) :]
            n_decoded += len(packet)
            if len(new):
                yield _es_columns(new, decoder.event_type, height)


def read_hdf5(path: str) -> Iterator[Any]:
    """The sensor, then blocks of events, as columns t, x, y, p."""
    import h5py

    with h5py.File(path, "r", rdcc_nbytes=CACHE_BYTES) as file:
        sets, offset_us = _layout(h5py, file)
        yield _geometry(file) if len(sets) == 1 else _sides(h5py, file)
        n_events = sets[0].size
        for start in range(0, n_events, BLOCK_EVENTS):
            columns = [data[start : start + BLOCK_EVENTS] for data in sets]
            if len(columns) == 1:
                columns = [columns[0][name] for name in COLUMNS]
            if offset_us:
                t = columns[0].astype(np.int64)
                # A time beyond int64 is negative now. It must stay negative with the offset, so
                # that the event is refused.
                if columns[0].dtype.kind == "u":
                    t[t < 0] = -1 - abs(offset_us)
                columns[0] = t + offset_us
            yield columns


def _layout(h5py: Any, file: Any) -> tuple[list[Any], int]:
    """The data sets of events, and what to add to t, in microseconds.

    There is one data set of records, or there are four of the columns t, x, y, p.

    Raises
    ------
    ValueError : the file has no data sets of events, or they have another type or length than they
        should.
    """
    names = "events/t, x, y, p"
    sets = [_find(h5py, file, f"events/{name}") for name in COLUMNS]
    offset = None
    if None not in sets:
        offset = _find(h5py, file, "t_offset")
    else:
        names = "CD/events"
        sets = [_find(h5py, file, "CD/events")]
    if None in sets:
        raise ValueError(
            f"expected events/t, x, y, p (DSEC, RVT) or CD/events (Metavision), got "
            f"{sorted(file)[:8]}"
        )

    _check_stored(h5py, names, sets if offset is None else [*sets, offset])
    offset_us = 0 if offset is None else _offset_us(offset)
    _check_types(names, sets)
    for data in sets:
        _check_filters(h5py, data)
        _check_complete(data)
    return sets, offset_us


def _check_stored(h5py: Any, names: str, sets: list[Any]) -> None:
    """Refuse an object that is no data set, or a data set with its values in other files."""
    for data in sets:
        if not isinstance(data, h5py.Dataset):
            raise ValueError(
                f"{names} and `t_offset` must be data sets, but {data.name} is a "
                f"{type(data).__name__}"
            )
        if data.is_virtual or data.id.get_create_plist().get_external_count():
            raise ValueError(
                f"{data.name} must be stored in the file itself, but its values are kept in other "
                "files"
            )


def _check_types(names: str, sets: list[Any]) -> None:
    """Refuse data sets that are not of equal lengths, or not of whole numbers."""
    shapes = {data.shape for data in sets}
    if len(shapes) != 1 or any(len(shape) != 1 for shape in shapes):
        raise ValueError(f"{names} must have one dimension and equal lengths, got {sorted(shapes)}")
    types = [data.dtype for data in sets]
    if len(sets) == 1:
        if not set(COLUMNS) <= set(types[0].names or ()):
            raise ValueError(f"CD/events must be records of t, x, y, p, got {types[0]}")
        types = [types[0][name] for name in COLUMNS]
    for name, dtype in zip(COLUMNS, types, strict=True):
        allowed = "iub" if name == "p" else "iu"
        if dtype.kind not in allowed:
            raise ValueError(f"{names} must be whole numbers, got {', '.join(map(str, types))}")


def _offset_us(offset: Any) -> int:
    """The number in the data set `t_offset`, in microseconds."""
    if offset.size != 1:
        raise ValueError(f"`t_offset` must be one number, got shape {offset.shape}")
    offset_us = int(offset[()].item())
    if not abs(offset_us) < 1 << 62:
        raise ValueError(f"`t_offset` must be below 2**62 microseconds, got {offset_us}")
    return offset_us


def _find(h5py: Any, file: Any, path: str) -> Any:
    """The object at a path, or None. HDF5 itself would follow links to other files."""
    node = file
    for name in path.split("/"):
        link = node.get(name, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise ValueError(f"{name} must be stored in the file itself, but it is a link")
        node = node[name]
    return node


def _check_filters(h5py: Any, data: Any) -> None:
    """Refuse a data set that is compressed by a filter that is missing here."""
    plist = data.id.get_create_plist()
    for i in range(plist.get_nfilters()):
        number, _, _, name = plist.get_filter(i)
        if h5py.h5z.filter_avail(number):
            continue
        with suppress(ImportError):
            import_module("hdf5plugin")  # registers its filters
        if not h5py.h5z.filter_avail(number):
            hint = ECF_HINT
            if number != ECF:
                name = name.decode("ascii", "backslashreplace").split(";")[0] or "a filter"
                hint = f"{name} (filter {number}), which is missing: {PLUGIN_HINT}"
            raise ValueError(f"its events are compressed by {hint}")


def _check_complete(data: Any) -> None:
    """Refuse a data set that was not written completely.

    HDF5 would read zeros instead of the missing data, up to the size that the header states.
    """
    if data.chunks is None:
        unit = "bytes"
        n_needed = data.size * data.dtype.itemsize
        n_present = data.id.get_storage_size()
    else:
        unit = "chunks"
        n_needed = -(-data.size // data.chunks[0])  # rounded up
        n_present = data.id.get_num_chunks()
    if n_present < n_needed:
        raise ValueError(
            f"{data.name} claims {data.size} events, but the file holds {n_present} of their "
            f"{n_needed} {unit}"
        )


def _sides(h5py: Any, file: Any) -> tuple[int, int] | None:
    """The sensor's sides from the numbers events/width and events/height; None without both."""
    sides = [_find(h5py, file, f"events/{name}") for name in ("width", "height")]
    if None in sides:
        return None
    for side in sides:
        if not isinstance(side, h5py.Dataset) or side.size != 1 or side.dtype.kind not in "iu":
            raise ValueError(f"{side.name} must be one whole number, got {side}")
    width, height = [int(side[()].item()) for side in sides]
    return _checked_sides("events/width and height", width, height)


def _geometry(file: Any) -> tuple[int, int] | None:
    """The sensor's sides (width, height) from the attribute `geometry`; None without it."""
    geometry = file.attrs.get("geometry")
    if isinstance(geometry, bytes):
        geometry = geometry.decode("ascii", "replace")
    if not isinstance(geometry, str):
        return None
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", geometry)
    return _checked_sides("`geometry`", int(match[1]), int(match[2])) if match else None


def _checked_sides(names: str, width: int, height: int) -> tuple[int, int]:
    """The sensor's sides, if they are those of a sensor; `names` says where the file has them."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ValueError(f"{names} must be in [1, {MAX_SIDE}], got {width} and {height}")
    return width, height
