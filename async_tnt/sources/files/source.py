"""What a format's reader gives: a source of blocks of events, read afresh at every pass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from async_tnt.events import EVENT_DTYPE
from async_tnt.kernels.records import MAX_TIME_US

BLOCK_EVENTS = 1 << 16

Sensor = tuple[int, int]


class Source(ABC):
    """The events of one file, a block at a time. Holds no more than a block of them in memory.

    Attributes
    ----------
    sensor : (width, height) in pixels, or None where the format does not say it.
    """

    sensor: Sensor | None = None

    @abstractmethod
    def blocks(self) -> Iterator[np.ndarray]:
        """Structured arrays of `EVENT_DTYPE`, not used again by the source, in the order of the file.

        Raises
        ------
        Damage : the file cannot be read on. All events before the damage have been yielded.
        OSError : the file is missing or not readable.
        """


class ArraySource(Source):
    """Events that are in memory already."""

    def __init__(self, events: np.ndarray, sensor: Sensor | None) -> None:
        self.events = events
        self.sensor = sensor

    def blocks(self) -> Iterator[np.ndarray]:
        for start in range(0, len(self.events), BLOCK_EVENTS):
            yield self.events[start : start + BLOCK_EVENTS]


def packed(t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, str | None]:
    """Columns of any whole-number type as `EVENT_DTYPE`, up to the first event that does not fit it.

    Returns
    -------
    The events before that one, and what is wrong with it (None: nothing; all are there).
    """
    off = (p == 0) | (p == -1) if p.dtype.kind == "i" else p == 0
    bad_t = (t < 0) | (t >= MAX_TIME_US)
    bad_x, bad_y = ((column < 0) | (column >= 1 << 16) for column in (x, y))
    bad = bad_t | bad_x | bad_y | ~(off | (p == 1))
    n = int(np.argmax(bad)) if bad.any() else len(t)
    events = np.empty(n, EVENT_DTYPE)
    events["t"], events["x"], events["y"] = t[:n], x[:n], y[:n]
    events["p"] = ~off[:n]
    if n == len(t):
        return events, None
    return events, f"t = {t[n]}, x = {x[n]}, y = {y[n]}, p = {p[n]} is no event"


def on_sensor(block: np.ndarray, sensor: Sensor | None, n_before: int) -> tuple[np.ndarray, str | None]:
    """The events before the first one off the sensor, and what is said of it."""
    if sensor is None:
        return block, None
    off = (block["x"] >= sensor[0]) | (block["y"] >= sensor[1])
    if not off.any():
        return block, None
    i = int(np.argmax(off))
    x, y = block["x"][i], block["y"][i]
    return block[:i], f"event {n_before + i} at x = {x}, y = {y} is off the {sensor[0]} x {sensor[1]} sensor"
