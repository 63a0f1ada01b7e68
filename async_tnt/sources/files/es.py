"""Reads Event Stream files (`.es`) with faery, in a worker process (`in_worker.py`).

DVS events, or ATIS events; of the latter, those of changing light. faery drops the packet in which it finds damage, and
says nothing of a file that ends within an event.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np


def read_es(path: str) -> Iterator[Any]:
    """The sensor, then blocks of events, as columns t, x, y, p."""
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
