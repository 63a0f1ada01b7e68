"""Store a window's events and replay them when the landmark is known: at the moment of reading."""

from __future__ import annotations

import warnings

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.events import Columns, checked_columns, empty_columns
from async_tnt.kernels import state as S
from async_tnt.kernels.absorb import absorb, store_events
from async_tnt.kernels.readout import empty_volume
from async_tnt.landmark_at_read import LandmarkAtRead
from async_tnt.new_state import next_epoch
from async_tnt.snapshot import Arrays, taken

FIRST_CAPACITY = 4096
UNCHANGED_BY_REPLAY = (
    S.N,
    S.SUM_X,
    S.SUM_Y,
    S.SUM_T,
    S.NEWEST_US,
    S.START_US,
    S.LIMIT_US,
    S.RECEIVED,
    S.LATE,
    S.DECIDED,
    *range(S.CLOSED_EARLY, S.CLOSED_EARLY + S.CLOSED_EARLY_WORDS),
)


class ReplayBufferFull(UserWarning):
    """A window held more events than the replay buffer; the rest is missing from its volume."""


class Replay:
    """The events of one window, and the replay of them about the landmark of that moment.

    Parameters
    ----------
    capacity : how many events are stored at most; memory grows with need up to that.
    landmark : who finds it.
    """

    def __init__(self, config: TNTConfig, capacity: int, landmark: LandmarkAtRead) -> None:
        if capacity < 1:
            raise ValueError(f"`replay_events` must be at least 1, got {capacity}")
        self.capacity = capacity
        self._config = config
        self._at_read = landmark
        self._columns = empty_columns(min(FIRST_CAPACITY, capacity))
        self.reset()

    def reset(self) -> None:
        """All counts zero; the next window is to be opened."""
        self.n_unstored = 0
        self._closed_kept = 0  # counts of closed windows; those of the open one change with every replay
        self._closed_tau_zero = 0
        self._warning_due = False

    def open(self, start_us: int) -> None:
        """A window begins; its volume is empty."""
        self.n = 0
        self._landmark: tuple[float, float] | None = None  # as of the newest event, once somebody asked
        self._is_replayed = True
        self._warned = False
        self._at_read.open(start_us)

    def store(self, buffer: np.ndarray, columns: Columns, first: int, last: int) -> int:
        """Take events up to the window's end; returns the first one not taken."""
        if self.n + last - first > self._columns.t.size:
            taken = columns.t[first:last] < buffer.view(np.int64)[S.LIMIT_US]
            self._grow(self.n + int(np.count_nonzero(taken)))
        counted, n_before = self._counted(buffer), self.n
        first, self.n = store_events(buffer, *columns[:4], first, last, *self._columns[:4], self.n)
        new = self._counted(buffer) - counted
        if new:
            self._at_read.see(self._columns, n_before, self.n)
            self._landmark = None
            self._is_replayed = False
        missing = new - (self.n - n_before)
        if missing:
            self.n_unstored += missing
            self._warning_due = self._warning_due or not self._warned
            self._warned = True
        return first

    def warn(self) -> None:
        """Say that the buffer is full, once a window: after a packet is done, since a warning may be an error."""
        if self._warning_due:
            self._warning_due = False
            warnings.warn(
                f"the replay buffer of {self.capacity} events is full; what exceeds it is missing from the "
                "window's volume and counted as dropped_unstored (raise replay_events, or shorten window_us)",
                ReplayBufferFull,
                stacklevel=5,
            )

    def landmark(self, buffer: np.ndarray) -> tuple[float, float]:
        """The landmark (x, y) in grid pixels; found once, until new events come. Not for an empty window."""
        if self._landmark is None:
            self._landmark = self._at_read.find(buffer)
        return self._landmark

    def run(self, buffer: np.ndarray, array: np.ndarray) -> None:
        """Bring a volume's cells and counts up to date: all stored events about the landmark.

        Parameters
        ----------
        buffer, array : the volume's, see `kernels.readout.empty_volume`.
        """
        if self._is_replayed:
            return
        landmark = self.landmark(buffer)  # first: what a regressor raises must leave the volume as it was
        ints = buffer.view(np.int64)
        saved = {slot: int(ints[slot]) for slot in UNCHANGED_BY_REPLAY}
        empty_volume(buffer, array, saved[S.START_US], saved[S.LIMIT_US], next_epoch())
        ints[S.KEPT], ints[S.TAU_ZERO] = self._closed_kept, self._closed_tau_zero
        buffer[S.FIXED_X], buffer[S.FIXED_Y] = self._config.to_sensor(*landmark)
        absorb(buffer, *self._columns[:4], 0, self.n)
        for slot, value in saved.items():
            ints[slot] = value
        self._is_replayed = True

    def close(self, buffer: np.ndarray, array: np.ndarray) -> None:
        """The window is over: keep its final counts."""
        self.run(buffer, array)
        ints = buffer.view(np.int64)
        self._closed_kept = int(ints[S.KEPT])
        self._closed_tau_zero = int(ints[S.TAU_ZERO])

    def snapshot(self) -> Arrays:
        """The stored events, and the counts of closed windows."""
        counts = self.n_unstored, self._closed_kept, self._closed_tau_zero, self._warned, 0
        stored = {f"stored_{name}": column[: self.n] for name, column in zip("txyp", self._columns[:4], strict=True)}
        return {"counts": np.array(counts, np.int64), **stored}

    def restore(self, arrays: Arrays, buffer: np.ndarray, is_open: bool) -> None:
        """The inverse, for a volume whose own numbers are back; replayed at the next read."""
        ints = buffer.view(np.int64)
        *counts, warned, _ = taken(arrays, "counts", np.int64, (5,)).tolist()
        if not is_open:  # the replay is in the volume's own counts
            counts[1:] = int(ints[S.KEPT]), int(ints[S.TAU_ZERO])
        if min(counts) < 0 or sum(counts) > int(ints[S.RECEIVED]):
            raise ValueError(f"its replay counts {counts} of {int(ints[S.RECEIVED])} events")
        self.n_unstored, self._closed_kept, self._closed_tau_zero = counts
        self._warned = warned != 0
        if not is_open:
            return
        size, start_us = np.shape(arrays.get("stored_t", 0)), int(ints[S.START_US])
        own = [
            taken(arrays, f"stored_{name}", c.dtype, size) for name, c in zip("txyp", self._columns[:4], strict=True)
        ]
        stored = checked_columns(own[0], own[1], own[2], own[3], self._config.sensor)
        if stored.n > self.capacity:
            raise ValueError(f"it stores {stored.n} events, but `replay_events` is {self.capacity}")
        t_us, end_us = stored.t[: stored.n], start_us + self._config.window_us
        if stored.n > self._counted(buffer) or np.any((t_us < start_us) | (t_us >= end_us)):
            raise ValueError(f"its stored events are not of the window from {start_us} us on")
        self._at_read.open(start_us)
        self._grow(stored.n)
        for column, values in zip(self._columns[:4], stored[:4], strict=True):
            column[: stored.n] = values
        self.n = stored.n
        self._landmark, self._is_replayed = None, self.n == 0
        self._at_read.see(self._columns, 0, self.n)

    @staticmethod
    def _counted(buffer: np.ndarray) -> int:
        return int(buffer.view(np.int64)[S.N])

    def _grow(self, n: int) -> None:
        n = min(n, self.capacity)
        if n > self._columns.t.size:
            larger = empty_columns(min(self.capacity, max(n, 2 * self._columns.t.size)))
            for old, new in zip(self._columns[:4], larger[:4], strict=True):
                new[: self.n] = old[: self.n]
            self._columns = larger
