"""The detection of restarts. At a restart, the clock of a source begins again.

A restart happens if a recording is read twice, if a camera is plugged in again, or if a counter
wraps.

All events that follow are older than the open window, and would be dropped as late without a
message. A restart differs from a few events that come late. At a restart there are ENOUGH events in
a row, and each of them is older than the newest event before it by the length of a window, or by
BEHIND_US if windows are longer.
"""

from __future__ import annotations

import sys
import warnings
from typing import Literal, get_args

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.volume.events import Columns

OnRestart = Literal["warn", "reset", "raise"]
ON_RESTART = get_args(OnRestart)
ENOUGH = 32
"""Number of events in a row that must be behind the newest event to show a restart."""
BEHIND_US = 100_000
"""An event is behind if it is older than the newest event by this many microseconds, or by the
length of a window if that is shorter."""

PACKAGE = f"{__name__.partition('.')[0]}."
"""Beginning of the names of this package's modules."""


class RestartWatch:
    """Looks for a restart among the events of one stream.

    Parameters
    ----------
    on_restart : what the processor does about a restart.
    window_us : length of a window.

    Attributes
    ----------
    on_restart : the parameter.
    looks_at_all : whether every packet is to be looked at, and not only packets that begin with a
        late event.
    waiting : copies of the newest packets while all their events are behind: they may be the first
        packets after a restart.
    """

    def __init__(self, on_restart: OnRestart, window_us: int) -> None:
        if on_restart not in ON_RESTART:
            rule = f"must be one of {', '.join(ON_RESTART)}"
            raise ParameterValueError("on_restart", rule, short(on_restart))
        self.on_restart: OnRestart = on_restart
        self.looks_at_all = on_restart != "warn"
        self._behind_us = min(window_us, BEHIND_US)
        self.reset()

    def reset(self) -> None:
        """Forget the stream."""
        self.waiting: list[Columns] = []
        # newest time, and number of events in the window, after the last packet was used
        self._last_use = (-1, 0)
        self._has_warned = False

    def look(self, columns: Columns, newest_us: int, n_events: int) -> int | None:
        """Look at a packet before it is used; warn of a restart, or raise, as `on_restart` says.

        Parameters
        ----------
        columns : the packet's events, at least one.
        newest_us : time of the newest event before the packet, in microseconds; -1: there was none.
        n_events : events in the open window.

        Returns
        -------
        int : the event with which a new stream begins. It is 0 also if the new stream begins with
            an event in `waiting`. None: go on with the packet as it is.

        Raises
        ------
        ValueError : there is a restart, and `on_restart` is "raise".
        """
        # If other events were used since the last look, the events that waited were only late.
        if self.waiting and (newest_us, n_events) != self._last_use:
            self.waiting = []
        self._last_use = (newest_us, n_events)
        t = columns.t[: columns.n]
        begins_behind = t.item(0) < newest_us - self._behind_us
        # a packet of several events may have late ones behind its first
        is_looked_at = begins_behind or (self.looks_at_all and columns.n > 1)
        if self._has_warned or not is_looked_at:
            self.waiting = []
            return None

        # for each event, the newest time up to it
        newest = np.maximum.accumulate(np.maximum(t, newest_us))
        is_behind = t < newest - self._behind_us
        if not is_behind[0]:
            self.waiting = []

        # Events that are behind, in rows without a gap. The first row may have begun with the
        # packets that wait.
        starts, lengths = _rows(is_behind)
        if self.waiting:
            lengths[0] += sum(packet.n for packet in self.waiting)
        long_rows = np.flatnonzero(lengths >= ENOUGH)
        if len(long_rows):
            return self._answer_restart(columns, int(starts[long_rows[0]]), newest_us)

        if is_behind.all():
            self.waiting.append(part_of(columns, 0, columns.n, copy=True))
        elif is_behind[-1]:
            self.waiting = [part_of(columns, int(starts[-1]), columns.n, copy=True)]
        else:
            self.waiting = []
        return None

    def note(self, newest_us: int, n_events: int) -> None:
        """Store the newest time and the number of events after the packet has been used."""
        self._last_use = (newest_us, n_events)

    def _answer_restart(self, columns: Columns, first: int, newest_us: int) -> int | None:
        """Warn, raise or reset because of a restart at the event `first`, or in `waiting`."""
        if first > 0:
            self.waiting = []
        if self.on_restart == "reset":
            return first

        newest_us = max(newest_us, int(columns.t[:first].max(initial=-1)))
        t_us = int(self.waiting[0].t[0] if self.waiting else columns.t[first])
        self.waiting = []
        text = (
            f"times went back by {(newest_us - t_us) / 1e6:,.3f} s, from {newest_us} to {t_us} us: "
            "the clock has begun again, and events are dropped as late until it has caught up; "
            'on_restart="reset" begins a new stream there, as `reset()` does between two '
            "recordings, and `async_tnt.sources.Clock` lets a camera's times go on"
        )
        if self.on_restart == "raise":
            raise ValueError(text)
        self._has_warned = True
        warnings.warn(text, stacklevel=_users_level())
        return None


def _users_level() -> int:
    """The `stacklevel` of a warning in the calling function that names the user's line.

    `push` may be called by the user, or by a stream of this package.
    """
    level = 1
    frame = sys._getframe(level)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(PACKAGE):
        frame = frame.f_back
        level += 1
    return level


def part_of(columns: Columns, first: int, last: int, *, copy: bool = False) -> Columns:
    """The events `first <= i < last`, in the same memory or copied."""
    t = columns.t[first:last]
    x = columns.x[first:last]
    y = columns.y[first:last]
    p = columns.p[first:last]
    if copy:
        return Columns(t.copy(), x.copy(), y.copy(), p.copy(), last - first)
    return Columns(t, x, y, p, last - first)


def _rows(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rows of True begin in a bool array, and how long each row is."""
    # +1 where a row begins, and -1 just behind its end
    steps = np.diff(flags.astype(np.int8), prepend=0, append=0)
    starts = np.flatnonzero(steps == 1)
    ends = np.flatnonzero(steps == -1)
    return starts, ends - starts
