"""Which windows of a stream are open, each with its own volume; and whether its times are likely in
microseconds.

Windows of a duration lie end to end, or overlap with `hop_us`. One of `window_events` begins with
the first event after the window before it.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from dataclasses import replace
from typing import NamedTuple

from async_tnt.base.checks import checked_time, positive_int, short
from async_tnt.streaming.decision import Decision
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.counts import Counts
from async_tnt.volume.events import Columns
from async_tnt.volume.state import MAX_EVENTS, Regressor
from async_tnt.volume.volume import TNTVolume

MAX_OPEN_WINDOWS = 256
# the windows by which a stream is judged, and the events that are too few for one
N_JUDGED, FEW_EVENTS = 32, 2


class _Sharing(NamedTuple):
    """Events that the oldest window absorbs, and then the windows that overlap it."""

    columns: Columns
    first: int
    counts: tuple[int, int, int]
    """The counts of the scheduler before: received, late, dropped_decided."""
    of_oldest: tuple[int, int]
    """The counts of the oldest window before: late, dropped_decided."""
    received: list[int]
    """Events that each window had received before."""


class _Closing(NamedTuple):
    """A window that is being closed."""

    volume: TNTVolume
    decided_from_us: int | None
    """What the scheduler's `_decided_from_us` becomes."""


class WindowScheduler:
    """The open windows of a stream, oldest first.

    Parameters
    ----------
    config, regressor : see `TNTVolume`.
    hop_us : distance between the starts of windows; at most window_us, its default. Not with
        `window_events`.
    start_us : start of the first window; None: at the first event. Not with `window_events`.
    """

    def __init__(
        self,
        config: TNTConfig,
        hop_us: int | None,
        start_us: int | None,
        regressor: Regressor | None,
    ) -> None:
        self._window_us = window_us = config.window_us
        self._window_events = config.window_events
        if config.window_events is not None:
            for name, value in (("hop_us", hop_us), ("start_us", start_us)):
                if value is not None:
                    raise ValueError(
                        f"`{name}` must not be given with window_events={config.window_events}, "
                        f"got {short(value)}"
                    )
        self.hop_us = window_us if hop_us is None else positive_int("hop_us", hop_us)
        if self.hop_us > window_us:
            raise ValueError(
                f"`hop_us` must be at most window_us = {window_us}, got {short(hop_us)}"
            )
        n_volumes = math.ceil(window_us / self.hop_us)
        if n_volumes > MAX_OPEN_WINDOWS:
            smallest = f"window_us / {MAX_OPEN_WINDOWS} = {math.ceil(window_us / MAX_OPEN_WINDOWS)}"
            got = f"{self.hop_us}: {n_volumes} windows would be open at once"
            raise ValueError(f"`hop_us` must be at least {smallest}, got {got}")
        self.start_us = None if start_us is None else checked_time("start_us", start_us)
        self.regressor = regressor
        self.volumes = [TNTVolume(config, regressor=regressor) for _ in range(n_volumes)]
        self.reset()

    def reset(self) -> None:
        """No window open, all counts zero."""
        for volume in self.volumes:
            volume.reset()
        self._open: deque[TNTVolume] = deque()
        self._free = list(self.volumes)
        # of the next window to be opened; None: at the first event
        self._next_start_us: int | None = self.start_us
        # The start of the windows closed early that lead up to the oldest open one, or to the next
        # where none is.
        self._decided_from_us: int | None = None
        self._n_received = 0
        self._n_late = 0
        self._n_dropped_decided = 0
        self._sharing: _Sharing | None = None
        self._closing: _Closing | None = None

    def __len__(self) -> int:
        return len(self._open)

    @property
    def overlap(self) -> bool:
        """Whether several windows can be open at once."""
        return len(self.volumes) > 1

    @property
    def oldest(self) -> TNTVolume:
        """The oldest open window; an empty one where none is open."""
        return self._open[0] if self._open else self.volumes[0]

    @property
    def late_before_us(self) -> int:
        """Events before this time are late: the start of the oldest open window, or else of the
        next one; -1 if that begins with any event."""
        if self._open:
            return self.oldest.start_us
        return -1 if self._next_start_us is None else self._next_start_us

    @property
    def oldest_end_us(self) -> int:
        """End of the oldest open window."""
        return self.oldest.start_us + self._window_us

    @property
    def room(self) -> int:
        """How many more events the oldest window takes."""
        return (
            MAX_EVENTS
            if self._window_events is None
            else self._window_events - self.oldest.n_events
        )

    @property
    def is_full(self) -> bool:
        """Whether the oldest window holds as many events as a window may."""
        return self._window_events is not None and self.oldest.n_events >= self._window_events

    def absorb(self, columns: Columns, first: int, last: int) -> int:
        """Add events to all open windows, up to the limit; returns the first one not added."""
        if not self.overlap:  # the counts below are not needed
            return self._open[0].absorb(columns, first, last)
        self.begin_sharing(columns, first)
        absorbed = self._open[0].absorb(columns, first, last)
        self.share()
        return absorbed

    def begin_sharing(self, columns: Columns, first: int) -> None:
        """Where windows overlap, note what the oldest one had before it gets the events from
        `first` on."""
        if self.overlap:
            oldest = self._open[0]
            counts = self._n_received, self._n_late, self._n_dropped_decided
            received = [volume.n_received for volume in self._open]
            self._sharing = _Sharing(
                columns, first, counts, (oldest.n_late, oldest.n_dropped_decided), received
            )

    def share(self) -> None:
        """Add the events that the oldest window has absorbed since `begin_sharing` to the others
        that overlap it, and count them once. May be called again after an exception: nothing is
        done twice."""
        sharing = self._sharing
        if sharing is None:
            return
        oldest = self._open[0]
        n = oldest.n_received - sharing.received[0]
        for volume, before in zip(self._open, sharing.received, strict=True):
            if volume.n_received == before:
                volume.absorb(sharing.columns, sharing.first, sharing.first + n)
        n_received, n_late, n_dropped_decided = sharing.counts
        self._n_received = n_received + n
        self._n_late = n_late + oldest.n_late - sharing.of_oldest[0]
        self._n_dropped_decided = (
            n_dropped_decided + oldest.n_dropped_decided - sharing.of_oldest[1]
        )
        self._sharing = None

    def recover(self) -> None:
        """Finish what an exception, such as Ctrl-C, has interrupted, or take it back; otherwise
        nothing changes."""
        self.share()
        if self._closing is not None and self._closing.volume not in self._open:
            self._finish_closing()
        self._closing = None
        self._open = deque(
            volume for volume in self._open if volume.is_open and not self._is_anchored(volume)
        )
        if not self._open and self._next_start_us is not None and self._is_anchored(None):
            self._next_start_us = None
        self._free = [volume for volume in self.volumes if volume not in self._open]
        for volume in self._free:
            if volume.is_open:
                volume.close()
        if self._open:
            self._next_start_us = self._open[-1].start_us + self.hop_us

    def _is_anchored(self, volume: TNTVolume | None) -> bool:
        """Whether an empty window, or the next one (None), begins where it does because of an event
        that was not absorbed: each of `window_events` begins with one, and otherwise the first of a
        stream without `start_us`."""
        if volume is not None and volume.n_events:
            return False
        if self._window_events is not None:
            return True
        return self.start_us is None and not any(one.n_received for one in self.volumes)

    def open_due(self, t_us: int) -> bool:
        """Open the windows that hold `t_us`, or else the next one, so that at least one is open;
        empty ones before them are skipped. Returns whether the oldest window has changed."""
        was_empty = not self._open
        if self._next_start_us is None:
            self._next_start_us = t_us
        start_us = self._next_start_us
        if start_us + self._window_us <= t_us:  # then none is open
            hops = (t_us - self._window_us - start_us) // self.hop_us + 1
            start_us += hops * self.hop_us
            self._decided_from_us = None
        while start_us <= t_us or not self._open:
            self._free[-1].open(start_us)  # first: an impossible time changes nothing
            self._open.append(self._free.pop())
            start_us += self.hop_us
        self._next_start_us = start_us
        if was_empty:
            self._inform_oldest()
        return was_empty

    def set_limit(self, trigger_us: int) -> None:
        """Make `absorb` stop where a window ends or begins, or at `trigger_us`."""
        if self._open and self._next_start_us is not None:
            limit_us = min(self.oldest_end_us, self._next_start_us, trigger_us)
            for volume in self._open:
                volume.set_limit(limit_us)

    def close_oldest(self, early: bool = False) -> None:
        """Close the oldest window; its volume is empty and free for the next one to be opened.

        early : before its end. Events that still arrive for it are counted as `dropped_decided`;
            where windows have a number of events, none do: the next window begins with the next
            event.
        """
        volume = self._open[0]
        decided_from_us = None
        if early and self._window_events is None:
            decided_from_us = (
                volume.start_us if self._decided_from_us is None else self._decided_from_us
            )
        self._closing = _Closing(volume, decided_from_us)
        self._open.popleft()  # from here on, an exception does not keep it open: see `recover`
        self._finish_closing()

    def _finish_closing(self) -> None:
        assert self._closing is not None
        volume = self._closing.volume
        self._decided_from_us = self._closing.decided_from_us
        if self._window_events is not None:
            self._next_start_us = None
        volume.close()
        if volume not in self._free:
            self._free.append(volume)
        if self._open:
            self._inform_oldest()
        self._closing = None

    def _inform_oldest(self) -> None:
        """Tell the oldest volume, which counts late events, from when on the windows before it were
        closed early."""
        if self._decided_from_us is not None:
            self.oldest.set_decided_from(self._decided_from_us)

    def counts(self, n_dropped: int) -> Counts:
        """See `Processor.counts`. `n_dropped` : late events that the decoder has dropped."""
        total = sum((volume.counts for volume in self.volumes), Counts())
        if self.overlap:
            decided = self._n_dropped_decided
            total = replace(
                total, received=self._n_received, dropped_late=self._n_late, dropped_decided=decided
            )
        return total + Counts(received=n_dropped, dropped_late=n_dropped)


class TimeUnitCheck:
    """Warns once if most of a stream's first windows hold next to nothing: its times may be in
    another unit."""

    def __init__(self, config: TNTConfig) -> None:
        self._window_us = config.window_us
        self._left = N_JUDGED if config.window_events is None else 0
        self._n_small = 0

    def watch(self, decisions: list[Decision]) -> list[Decision]:
        """Returns these next decisions of the stream, and looks at the windows that they closed at
        their ends."""
        for decision in decisions if self._left > 0 else ():
            if decision.trigger == "window":
                self.add(decision.events)
        return decisions

    def add(self, n_events: int) -> None:
        """The next window holds so many events."""
        self._left -= 1
        self._n_small += n_events <= FEW_EVENTS
        if self._left == 0 and 2 * self._n_small > N_JUDGED:
            warnings.warn(
                f"{self._n_small} of the first {N_JUDGED} windows hold {FEW_EVENTS} events or "
                "fewer: times are read as "
                f"microseconds, divide nanoseconds by 1000; or windows of {self._window_us} us are "
                "too short",
                stacklevel=4,
            )
