"""What a worker process does for a `WorkerSource`: it reads one file after another. Imports nothing that takes time.

A reader is a function of a path. It yields the sensor, (width, height) or None, then blocks of events, each as a list
of four columns of integers: t, x, y, p. It raises an exception where the file cannot be read on. The readers of AEDAT4
and ES, by faery, are here; that of HDF5 is `hdf5.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np

MAX_BYTES = 4 << 30  # of addresses; a block takes megabytes, but a damaged file may ask for anything

Reader = Callable[[str], Iterator[Any]]

_blocks: Iterator[Any] = iter(())  # of the file that this process reads


def start(read: Reader, path: str) -> Any:
    """Start to read a file, and return its sensor; `next_block` then returns its events."""
    global _blocks
    _limit_memory()
    _blocks = read(path)
    return next(_blocks)


def sensor_of(read: Reader, path: str) -> Any:
    """A file's sensor. The file is closed then: HDF5 lets nobody write one that is open."""
    global _blocks
    sensor = start(read, path)
    _blocks = iter(())
    return sensor


def next_block() -> list[np.ndarray] | None:
    """The columns of the next events, None at the end."""
    return next(_blocks, None)


def _limit_memory() -> None:
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))


# -- readers ---------------------------------------------------------------------------------------------


def read_aedat4(path: str) -> Iterator[Any]:
    """AEDAT4 files (`.aedat4`) of DV: their first stream of events."""
    from faery.extension import aedat

    decoder = aedat.Decoder(path)
    tracks = decoder.tracks()
    track = next((track for track in tracks if track.data_type == "events"), None)
    if track is None:
        kinds = ", ".join(track.data_type for track in tracks) or "none"
        raise ValueError(f"it must have a stream of events; its streams are: {kinds}")
    yield None if track.dimensions is None else [int(side) for side in track.dimensions]
    for found, packet in decoder:
        if found.id == track.id and found.data_type == "events" and len(packet):
            yield [packet[name] for name in ("t", "x", "y", "on")]


def read_es(path: str) -> Iterator[Any]:
    """Event Stream files (`.es`): DVS events, or ATIS events; of the latter, those of changing light.

    faery drops the packet in which it finds damage, and says nothing of a file that ends within an event.
    """
    from faery.extension import es

    decoder = es.Decoder(path, 0)
    if decoder.event_type not in ("dvs", "atis"):
        raise ValueError(f"expected DVS or ATIS events, got {decoder.event_type}")
    width, height = decoder.dimensions
    if not width * height:
        raise ValueError(f"a sensor must have at least one pixel a side, got {width} x {height}")
    yield width, height
    for packet in decoder:
        if decoder.event_type == "atis":
            packet = packet[~packet["exposure"]]
        y = height - 1 - packet["y"].astype(np.int64)  # the format counts from the bottom; below it: an invalid event
        yield [packet["t"], packet["x"], y, packet["p"]]
