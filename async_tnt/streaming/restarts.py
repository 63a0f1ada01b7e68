"""A clock that begins again: a recording that is read twice, a camera that was plugged in again, a
counter that wraps.

All events that follow are older than the open window, and would be dropped as late without a word.
Here such a restart is told from a few events that come late: there are ENOUGH events in a row, each
older than the newest event before them by a window, or by BEHIND_US if windows are longer.
"""

from __future__ import annotations

import warnings
from typing import Literal, get_args

import numpy as np

from async_tnt.base.checks import short
from async_tnt.volume.events import Columns

OnRestart = Literal["warn", "reset", "raise"]
ON_RESTART = get_args(OnRestart)
ENOUGH = 32  # events
BEHIND_US = 100_000


class RestartWatch:
    """Looks for a restart among the events of one stream.

    Parameters
    ----------
    on_restart : what the processor does about one.
    window_us : length of a window.

    Attributes
    ----------
    on_restart : as given.
    looks_at_all : whether every packet is to be looked at, not only one that begins with a late
        event.
    waiting : the newest events, as long as all of them are behind: they may be the first ones after
        a restart. Copies.
    """

    def __init__(self, on_restart: OnRestart, window_us: int) -> None:
        if on_restart not in ON_RESTART:
            raise ValueError(
                f"`on_restart` must be one of {', '.join(ON_RESTART)}, got {short(on_restart)}"
            )
        self.on_restart = on_restart
        self.looks_at_all = on_restart != "warn"
        self._behind_us = min(window_us, BEHIND_US)
        self.reset()

    def reset(self) -> None:
        """Forget the stream."""
        self.waiting: list[Columns] = []
        self._before = -1, 0  # newest time and number of events when the last packet had been used
        self._has_warned = False

    def look(self, columns: Columns, newest_us: int, n_events: int) -> int | None:
        """Look at a packet before it is used: warn of a restart, or raise, if that is to be done.

        Parameters
        ----------
        columns : at least one event.
        newest_us : time of the newest event before it, in microseconds; -1: there was none.
        n_events : events in the open window.

        Returns
        -------
        int : the first event after a restart with which a new stream begins; 0 also if that event
            is in `waiting`. None: go on with the packet as it is.

        Raises
        ------
        ValueError : a restart, and `on_restart` is "raise".
        """
        if self.waiting and (newest_us, n_events) != self._before:  # other events came between
            self.waiting = []
        self._before = newest_us, n_events
        t = columns.t[: columns.n]
        if self._has_warned or not (self.looks_at_all or t.item(0) < newest_us - self._behind_us):
            self.waiting = []
            return None
        newest = np.maximum.accumulate(np.maximum(t, newest_us))
        is_behind = t < newest - self._behind_us
        n_waiting = sum(packet.n for packet in self.waiting)
        if n_waiting and not is_behind[0]:
            self.waiting = []
            n_waiting = 0
        starts, lengths = _rows(is_behind)
        if n_waiting:
            lengths[0] += n_waiting
        found = np.flatnonzero(lengths >= ENOUGH)
        if len(found):
            return self._found(columns, int(starts[found[0]]), newest_us)
        if is_behind.all():
            self.waiting.append(part_of(columns, 0, columns.n, copy=True))
        elif is_behind[-1]:
            self.waiting = [part_of(columns, int(starts[-1]), columns.n, copy=True)]
        else:
            self.waiting = []
        return None

    def note(self, newest_us: int, n_events: int) -> None:
        """Note what is known once the packet has been used."""
        self._before = newest_us, n_events

    def _found(self, columns: Columns, first: int, newest_us: int) -> int | None:
        """Do what is to be done about a restart at the event `first`, or in `waiting`."""
        if first > 0:
            self.waiting = []
        newest_us = max(newest_us, int(columns.t[:first].max(initial=-1)))
        t_us = int((self.waiting[0].t if self.waiting else columns.t)[first])
        if self.on_restart == "reset":
            return first
        self.waiting = []
        text = (
            f"times went back by {(newest_us - t_us) / 1e6:,.3f} s, from {newest_us} to {t_us} us: "
            "the clock has begun "
            'again, and events are dropped as late until it has caught up; on_restart="reset" '
            "begins a new stream "
            "there, as `reset()` does between two recordings, and `async_tnt.sources.Clock` lets a "
            "camera's times go on"
        )
        if self.on_restart == "raise":
            raise ValueError(text)
        self._has_warned = True
        warnings.warn(text, stacklevel=6)
        return None


def part_of(columns: Columns, first: int, last: int, *, copy: bool = False) -> Columns:
    """The events `first <= i < last`, in the same memory or copied."""
    t, x, y, p = (
        column[first:last].copy() if copy else column[first:last] for column in columns[:4]
    )
    return Columns(t, x, y, p, last - first)


def _rows(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rows of True begin in a bool array, and how long each is."""
    steps = np.diff(flags.astype(np.int8), prepend=0, append=0)
    starts = np.flatnonzero(steps == 1)
    return starts, np.flatnonzero(steps == -1) - starts
