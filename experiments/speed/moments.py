"""Moments at which backends decide, a fixed number of events apart, the same for all backends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from async_tnt import EVENT_DTYPE, TNTConfig
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.volume.events import structured

NEW_EVENTS = (1, 10, 100, 1300)
"""Numbers of new events between two decisions."""


@dataclass(frozen=True)
class Moment:
    """A window of a stream up to a point in time."""

    start_us: int
    events: np.ndarray
    """The window's events so far, `EVENT_DTYPE`."""
    n_new: int
    """Number of last events that arrived after the previous decision."""
    follows: bool = True
    """Whether the previous decision was made at the moment before this one. If not, backends must
    first decide at `before`."""

    @property
    def before(self) -> Moment:
        """The same window without its new events."""
        return Moment(self.start_us, self.events[: len(self.events) - self.n_new], 0)


class Moments:
    """All moments of some windows, repeated without end.

    The windows follow each other, and time continues.

    A window's first event comes before its first moment, so that opening a window is never part of
    a timed decision.

    Parameters
    ----------
    windows : structured arrays of `EVENT_DTYPE`, in order of time, times counted from the window's
        start.
    window_us : time from the start of a window to the start of the next, in microseconds.
    n_new : number of events between two moments.

    Raises
    ------
    ValueError : no window has more than `n_new` events.
    """

    def __init__(self, windows: list[np.ndarray], window_us: int, n_new: int) -> None:
        self._windows = windows
        self._window_us = window_us
        self._n_new = n_new
        self._ends = np.cumsum([max(0, len(window) - 1) // n_new for window in windows])
        if not windows or self._ends[-1] == 0:
            longest = max(map(len, windows), default=0)
            raise ValueError(
                f"a window of at least {n_new + 1} events is needed, the longest has {longest}"
            )
        self._shifted: tuple[int, np.ndarray] = -1, np.empty(0, EVENT_DTYPE)

    @property
    def a_lap(self) -> int:
        """The number of moments in one lap, which is one pass over all windows."""
        return int(self._ends[-1])

    def __getitem__(self, i: int) -> Moment:
        """The moment number `i` of the endless stream."""
        lap, i = divmod(i, self.a_lap)
        window_index = int(np.searchsorted(self._ends, i, side="right"))
        moment_in_window = i - (int(self._ends[window_index - 1]) if window_index else 0)
        n_windows_before = lap * len(self._windows) + window_index
        start_us = n_windows_before * self._window_us
        if self._shifted[0] != n_windows_before:
            events = self._windows[window_index].copy()
            events["t"] += start_us
            self._shifted = n_windows_before, events
        return Moment(
            start_us,
            self._shifted[1][: 1 + (moment_in_window + 1) * self._n_new],
            self._n_new,
            moment_in_window > 0,
        )

    def blocks(self, n_blocks: int, size: int) -> Iterator[list[Moment]]:
        """`n_blocks` runs of `size` consecutive moments.

        The runs are spread evenly over one lap, or over several laps if one lap is too short.
        """
        step = max(size, self.a_lap // n_blocks)
        for first in range(0, n_blocks * step, step):
            block = [self[i] for i in range(first, first + size)]
            yield [replace(block[0], follows=False), *block[1:]]


def windows_of(events: np.ndarray, window_us: int) -> list[np.ndarray]:
    """The windows of a recording from time 0 on, without empty ones.

    Times are counted from each window's start.
    """
    window_numbers = events["t"] // window_us
    edges = np.flatnonzero(np.diff(window_numbers, prepend=-1, append=window_numbers[-1:] + 1))
    windows = [events[first:end].astype(EVENT_DTYPE) for first, end in pairwise(edges)]
    for window in windows:
        window["t"] %= window_us
    return windows


def bench_recordings(config: TNTConfig) -> list[np.ndarray]:
    """Recordings to decide on: three windows of each bundled sample."""
    recordings = [open_recording(path).read() for path in sample_recordings().values()]
    return [events[events["t"] < 3 * config.window_us] for events in recordings]


def made_columns(
    rng: np.random.Generator, sensor: tuple[int, int], n: int, duration_us: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns t, x, y, p of n random events, in order of time.

    The events are uniform over sensor, polarity and [0, duration_us).
    """
    return (
        np.sort(rng.integers(0, duration_us, n)),
        rng.integers(0, sensor[0], n).astype(np.uint16),
        rng.integers(0, sensor[1], n).astype(np.uint16),
        rng.integers(0, 2, n).astype(np.uint8),
    )


def on_sensor(
    t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray, sensor: tuple[int, int]
) -> np.ndarray:
    """The events that lie on the sensor, as a structured array. Places are rounded down."""
    x = np.floor(x).astype(int)
    y = np.floor(y).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < sensor[0]) & (y < sensor[1])
    return structured([column[inside] for column in (t, x, y, p)])
