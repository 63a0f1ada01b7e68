"""Reads AEDAT4 files (`.aedat4`) of DV with faery, in a worker process (`in_worker.py`).

The first stream of events is read.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


def read_aedat4(path: str) -> Iterator[Any]:
    """The sensor, then blocks of events, as columns t, x, y, p."""
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
