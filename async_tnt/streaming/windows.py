"""The open windows of a stream, each with its own volume.

Windows of a duration lie end to end, or overlap with `hop_us`. A window of `window_events` begins
with the first event after the window before it.

`TimeUnitCheck` warns if the stream's times are probably not in microseconds.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.checks import ParameterValueError, checked_time, positive_int
from async_tnt.base.messages import short
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.volume.absorb import absorb_into_others
from async_tnt.kernels.volume.state import NEVER_US, RECEIVED
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.models.spiking_volume import SpikingVolume
from async_tnt.streaming.decision import Decision
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.counts import Counts
from async_tnt.volume.events import Columns
from async_tnt.volume.regressor import Regressor
from async_tnt.volume.state import MAX_EVENTS
from async_tnt.volume.volume import TNTVolume

MAX_OPEN_WINDOWS = 256
"""The most windows that may be open at once."""
N_JUDGED = 32
"""Number of windows at the beginning of a stream by which the unit of its times is judged."""
FEW_EVENTS = 2
"""Up to this many events are too few for a window."""


class _Sharing(NamedTuple):
    """Events that the oldest window absorbs, and then the windows that overlap it."""

    columns: Columns
    first: int
    counts: tuple[int, int, int]
    """The scheduler's counts before these events: received, late, dropped_decided."""
    oldest_counts: tuple[int, int]
    """The oldest window's counts before these events: late, dropped_decided."""
    received: np.ndarray
    """Number of events that each window had received before these events, int64."""


class _Closing(NamedTuple):
    """A window that is being closed."""

    volume: TNTVolume
    decided_from_us: int | None
    """The value that the scheduler's `_decided_from_us` gets."""


class WindowScheduler:
    """The open windows of a stream, oldest first.

    Parameters
    ----------
    config, regressor : see `TNTVolume`.
    spiking : the network that the events of each window go through; None if there is none.
    keep_neurons : see `SpikingVolume`.
    hop_us : distance between the starts of windows, at most window_us, which is the default. Not
        with `window_events`.
    start_us : start of the first window; None: at the first event. Not with `window_events`.
    """

    def __init__(
        self,
        config: TNTConfig,
        hop_us: int | None,
        start_us: int | None,
        regressor: Regressor | None,
        spiking: SpikingNetwork | None = None,
        keep_neurons: bool = False,
    ) -> None:
        self._window_us = NEVER_US if config.slides else config.window_us
        if config.slides and hop_us is not None:
            rule = "must not be given with a window that slides: its decisions come at any moment"
            raise ParameterValueError("hop_us", rule, short(hop_us))
        self._slides = config.slides
        self._window_events = config.window_events
        if config.window_events is not None:
            for name, value in (("hop_us", hop_us), ("start_us", start_us)):
                if value is not None:
                    rule = f"must not be given with window_events={config.window_events}"
                    raise ParameterValueError(name, rule, short(value))
        # a window that slides is the only one of its stream
        self.hop_us = NEVER_US if config.slides else _checked_hop(hop_us, config.window_us)
        self.start_us = None if start_us is None else checked_time("start_us", start_us)
        self.regressor = regressor
        n_volumes = math.ceil(config.window_us / self.hop_us)
        self.volumes: list[TNTVolume] = []
        for _ in range(n_volumes):
            if spiking is None:
                self.volumes.append(TNTVolume(config, regressor=regressor))
            else:
                self.volumes.append(SpikingVolume(spiking, keep_neurons=keep_neurons))
        if keep_neurons and spiking is None:
            raise ParameterValueError("keep_neurons", "is for spiking models", True)
        if keep_neurons and self.overlap:
            rule = "must not be given with overlapping windows, as each has neurons of its own"
            raise ParameterValueError("keep_neurons", rule, True)
        # Where events are stored for a replay, they are not absorbed before a volume is read.
        # Neurons have a state beside the volume's own.
        has_cells_alone = not config.needs_replay and spiking is None
        self._absorbs_at_once = self.overlap and has_cells_alone
        self._share_memory()
        self.reset()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._share_memory()

    def _share_memory(self) -> None:
        """Lay the states of overlapping windows side by side, so that one call takes them all."""
        if not self._absorbs_at_once:
            return
        prepare(absorb_into_others)
        self._states = np.empty((len(self.volumes), self.volumes[0].buffer.size))
        self._rows = {volume: row for row, volume in enumerate(self.volumes)}
        for volume, memory in zip(self.volumes, self._states, strict=True):
            volume.move_to(memory)

    def reset(self) -> None:
        """Close all windows, and set all counts to zero."""
        for volume in self.volumes:
            volume.reset()
        self._open: deque[TNTVolume] = deque()
        self._free = list(self.volumes)
        # start of the next window to be opened; None: at the first event
        self._next_start_us: int | None = self.start_us
        # Windows were closed early from this time on, without a gap, up to the oldest open window
        # or to the next one if none is open. None: the window before was not closed early.
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
        """The volume of the oldest open window; an empty volume if no window is open."""
        return self._open[0] if self._open else self.volumes[0]

    @property
    def late_before_us(self) -> int:
        """The time before which events are late: the start of the oldest open window.

        If no window is open, it is the start of the next window, or -1 if the next window begins
        with any event.
        """
        if self._slides:
            # whether events are late is known only when they come
            return NEVER_US
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
        if self._window_events is None:
            return MAX_EVENTS
        return self._window_events - self.oldest.n_arrived

    @property
    def is_full(self) -> bool:
        """Whether the oldest window holds as many events as a window may."""
        return self._window_events is not None and self.oldest.n_arrived >= self._window_events

    def absorb(self, columns: Columns, first: int, last: int) -> int:
        """Add events to all open windows, up to the limit; returns the first event not added."""
        # the usual case, which does not need the counts of sharing
        if not self.overlap:
            return self._open[0].absorb(columns, first, last)
        self.begin_sharing(columns, first)
        absorbed = self._open[0].absorb(columns, first, last)
        self.share()
        return absorbed

    def begin_sharing(self, columns: Columns, first: int) -> None:
        """Keep the counts before the oldest window absorbs the events from `first` on.

        If windows do not overlap, nothing is kept, and `share` does nothing.
        """
        if self.overlap:
            oldest = self._open[0]
            counts = (self._n_received, self._n_late, self._n_dropped_decided)
            oldest_counts = (oldest.n_late, oldest.n_dropped_decided)
            self._sharing = _Sharing(columns, first, counts, oldest_counts, self._received())

    def share(self) -> None:
        """Add the oldest window's events since `begin_sharing` to the other open windows.

        The scheduler counts them once. This may be called again after an exception: nothing is done
        twice.
        """
        sharing = self._sharing
        if sharing is None:
            return
        oldest = self._open[0]
        n = oldest.n_received - int(sharing.received[0])
        if n:
            self._absorb_into_others(sharing, sharing.first + n)
        n_received, n_late, n_decided = sharing.counts
        oldest_n_late, oldest_n_decided = sharing.oldest_counts
        self._n_received = n_received + n
        self._n_late = n_late + oldest.n_late - oldest_n_late
        self._n_dropped_decided = n_decided + oldest.n_dropped_decided - oldest_n_decided
        self._sharing = None

    def _absorb_into_others(self, sharing: _Sharing, last: int) -> None:
        """Add events up to `last` to each other window that has not received them yet."""
        columns = sharing.columns
        if self._absorbs_at_once:
            rows = self._open_rows()
            absorb_into_others.call(
                self._states, rows, sharing.received, *columns[:4], sharing.first, last
            )
            return
        for volume, n_before in zip(self._open, sharing.received, strict=True):
            if volume.n_received == n_before:
                volume.absorb(columns, sharing.first, last)

    def _open_rows(self) -> np.ndarray:
        """The rows of the open windows' states, the oldest first."""
        rows = self._rows
        return np.array([rows[volume] for volume in self._open])

    def _received(self) -> np.ndarray:
        """How many events each open window has received so far, int64."""
        if self._absorbs_at_once:
            received: np.ndarray = self._states.view(np.int64)[self._open_rows(), RECEIVED]
            return received
        return np.array([volume.n_received for volume in self._open])

    def recover(self) -> None:
        """Finish what an exception, such as Ctrl-C, has interrupted, or take it back.

        If nothing was interrupted, nothing changes.
        """
        # Some windows may lack events that others have received, and a window may be half closed.
        self.share()
        if self._closing is not None and self._closing.volume not in self._open:
            self._finish_closing()
        self._closing = None

        # Drop windows that the exception left half open, or open for an event that was never
        # absorbed.
        self._open = deque(volume for volume in self._open if self._stays_open(volume))
        if not self._open and self._empty_begins_with_event():
            self._next_start_us = None
        self._free = [volume for volume in self.volumes if volume not in self._open]
        for volume in self._free:
            if volume.is_open:
                volume.close()
        if self._open:
            self._next_start_us = self._open[-1].start_us + self.hop_us

    def _stays_open(self, volume: TNTVolume) -> bool:
        """Whether a window is open, and not only for an event that was never absorbed."""
        if not volume.is_open:
            return False
        return volume.n_arrived > 0 or not self._empty_begins_with_event()

    def _empty_begins_with_event(self) -> bool:
        """Whether a window without events would begin at the time of its first event.

        This holds for each window of `window_events`, and for the first window of a stream without
        `start_us`.
        """
        if self._window_events is not None:
            return True
        return self.start_us is None and not any(volume.n_received for volume in self.volumes)

    def open_due(self, t_us: int) -> bool:
        """Open the windows that hold `t_us`; if there are none, open the next window.

        Empty windows before them are skipped. Returns whether the oldest window has changed.
        """
        was_empty = not self._open
        if self._next_start_us is None:
            self._next_start_us = t_us
        start_us = self._next_start_us

        # If the next window has ended before `t_us`, no window is open. Empty windows are skipped.
        if start_us + self._window_us <= t_us:
            # up to the first window whose end is after `t_us`
            n_skipped = (t_us - self._window_us - start_us) // self.hop_us + 1
            start_us += n_skipped * self.hop_us
            self._decided_from_us = None

        while start_us <= t_us or not self._open:
            # `open` comes first, because it refuses an impossible time. Nothing has changed then.
            self._free[-1].open(start_us)
            self._open.append(self._free.pop())
            start_us += self.hop_us
        self._next_start_us = start_us
        if was_empty:
            self._inform_oldest()
        return was_empty

    def set_limit(self, trigger_us: int) -> None:
        """Make `absorb` stop where a window ends or begins, or at `trigger_us`."""
        if self._open and self._next_start_us is not None:
            # A limit for the oldest window is enough: the other windows get the events that it
            # absorbs, and end later.
            limit_us = min(self.oldest_end_us, self._next_start_us, trigger_us)
            self._open[0].set_limit(limit_us)

    def close_oldest(self, early: bool = False) -> None:
        """Close the oldest window. Its volume is then empty, and free for another window.

        early : whether the window is closed before its end. Events that still arrive for the window
            are counted as `dropped_decided`. There are no such events for a window of
            `window_events`, because the next window begins with the next event.
        """
        volume = self._open[0]
        decided_from_us = None
        if early and self._window_events is None:
            decided_from_us = self._decided_from_us
            if decided_from_us is None:
                decided_from_us = volume.start_us
        self._closing = _Closing(volume, decided_from_us)
        # from here on `recover` does not keep the window open after an exception
        self._open.popleft()
        self._finish_closing()

    def _finish_closing(self) -> None:
        assert self._closing is not None
        volume = self._closing.volume
        self._decided_from_us = self._closing.decided_from_us
        if self._window_events is not None or self._slides:
            self._next_start_us = None
        volume.close()
        if volume not in self._free:
            self._free.append(volume)
        if self._open:
            self._inform_oldest()
        self._closing = None

    def _inform_oldest(self) -> None:
        """Tell the oldest volume from which time on the windows before it were closed early.

        The volume needs this time to count late events.
        """
        if self._decided_from_us is not None:
            self.oldest.set_decided_from(self._decided_from_us)

    def counts(self, n_dropped: int) -> Counts:
        """What became of the events, see `Processor.counts`.

        n_dropped : late events that the decoder has dropped.
        """
        total = sum((volume.counts for volume in self.volumes), Counts())
        if self.overlap:
            total = replace(
                total,
                received=self._n_received,
                dropped_late=self._n_late,
                dropped_decided=self._n_dropped_decided,
            )
        return total + Counts(received=n_dropped, dropped_late=n_dropped)


def _checked_hop(hop_us: int | None, window_us: int) -> int:
    """The distance between the starts of windows, in microseconds; by default their duration."""
    if hop_us is None:
        return window_us
    hop_us = positive_int("hop_us", hop_us)
    if hop_us > window_us:
        rule = f"must be at most window_us = {window_us}"
        raise ParameterValueError("hop_us", rule, short(hop_us))
    n_open = math.ceil(window_us / hop_us)
    if n_open > MAX_OPEN_WINDOWS:
        smallest = math.ceil(window_us / MAX_OPEN_WINDOWS)
        rule = f"must be at least window_us / {MAX_OPEN_WINDOWS} = {smallest}"
        got = f"{hop_us}: {n_open} windows would be open at once"
        raise ParameterValueError("hop_us", rule, got)
    return hop_us


class TimeUnitCheck:
    """A check that warns, once, if most of a stream's first windows hold hardly any events.

    The times of such a stream may be in another unit than microseconds.
    """

    def __init__(self, config: TNTConfig) -> None:
        self._window_us = config.window_us
        self._n_unjudged = N_JUDGED if config.window_events is None else 0
        self._n_small = 0

    def watch(self, decisions: list[Decision]) -> list[Decision]:
        """Look at the windows that these next decisions of the stream closed at their ends.

        Returns the same decisions.
        """
        if self._n_unjudged > 0:
            for decision in decisions:
                if decision.trigger == "window":
                    self.add(decision.events)
        return decisions

    def add(self, n_events: int) -> None:
        """Count the next window, which holds `n_events`; warn when enough windows are known."""
        self._n_unjudged -= 1
        if n_events <= FEW_EVENTS:
            self._n_small += 1
        if self._n_unjudged == 0 and 2 * self._n_small > N_JUDGED:
            warnings.warn(
                f"{self._n_small} of the first {N_JUDGED} windows hold {FEW_EVENTS} events or "
                "fewer: times are read as microseconds, divide nanoseconds by 1000; or windows of "
                f"{self._window_us} us are too short",
                stacklevel=4,
            )
