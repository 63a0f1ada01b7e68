"""Bundled recordings that move over a large sensor."""

from __future__ import annotations

import numpy as np

from async_tnt import EVENT_DTYPE
from async_tnt.sources import open_recording, sample_recordings

SIDE = 34
"""Width and height of a recording, in pixels."""


def moving(
    sensor: tuple[int, int], n_objects: int, n: int, duration_us: int, speed: float
) -> np.ndarray:
    """About `n` events of `n_objects` bundled recordings, each repeated at a place that moves.

    The places move by `speed` pixels a second.
    """
    rng = np.random.default_rng(n_objects)
    room = np.array(sensor) - SIDE - 1
    n_each = n // n_objects
    parts = []
    for k in range(n_objects):
        events = open_recording(sample_recordings()[k]).read()
        events = np.resize(events, n_each)  # a copy, which repeats the recording as needed
        events["t"] = np.arange(len(events)) * duration_us // len(events)
        diagonal = np.sqrt([0.5, 0.5])
        path = rng.uniform(0, 2 * room, 2) + np.outer(events["t"], speed * 1e-6 * diagonal)
        # the recording moves back and forth
        path = np.abs(path % (2 * room) - room).astype(int)
        events["x"] += path[:, 0].astype(np.uint16)
        events["y"] += path[:, 1].astype(np.uint16)
        parts.append(events)
    events = np.concatenate(parts).astype(EVENT_DTYPE)
    return events[np.argsort(events["t"], kind="stable")]
