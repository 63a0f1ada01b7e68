"""Processor: from packets of events to decisions, window by window."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import numpy as np

from .classifier import CompiledClassifier
from .config import TNTConfig
from .decision import Decision, decide
from .events import Columns, EventDoor
from .kernels.update import ABSORBED, AT_LIMIT, REFUSED
from .landmark_at_read import Regressor
from .model import Model
from .regressor import CompiledRegressor
from .volume import Counts, TNTVolume, checked_time

Classifier = Callable[[np.ndarray], Any]
NEVER = 1 << 62
MAX_OPEN_WINDOWS = 256


class Processor:
    """Takes events as they come and classifies windows of them.

    Windows are laid end to end from `start_us`, or else from the first event. A window that closes is
    classified; one without events is skipped. What is decided does not depend on how the stream is cut into
    packets.

    Parameters
    ----------
    model : a Model, or a TNTConfig together with `classifier`.
    classifier : any callable from a volume (float32 array, shape (C, H, W), read-only, valid during the call)
        to logits, finite ones; by default the model's own network, compiled. For a torch module `net`:
        `lambda volume: net(torch.tensor(volume)[None]).detach()`.
    regressor : with landmark `regressor`, see `TNTVolume`; by default the model's own network, compiled. What it
        raises is treated as the classifier's errors are, see `push`.
    classes : class names; by default the model's, or else "0", "1", ...
    start_us : start of the first window, in microseconds.
    hop_us : distance between the starts of windows, by default `window_us`. A smaller one gives overlapping
        windows; triggers and `fire` then speak of the oldest open window, the most complete one.
    every_us : decide also whenever so much time has passed since the window's start, if events came meanwhile.
        The decision falls when the first event at or after that moment shows that it has come. With overlapping
        windows: at those moments of a window at which it is the oldest.
    every_events : decide also after every so many events of the window.
    late : `accept`, `drop` or `raise`: what to do with an event older than the newest one seen. Events before
        every open window are always dropped and counted.
    replay_events : see `TNTVolume`.

    Examples
    --------
    >>> processor = Processor(TNTConfig(window_us=1000), classifier=lambda volume: [volume.sum(), 0.0])
    >>> processor.push(([0, 10, 999], [16, 17, 16], [16, 16, 17], [1, 1, 1]))
    []
    >>> [decision.events for decision in processor.push(([1000], [5], [5], [0]))]
    [3]
    """

    def __init__(
        self,
        model: Model | TNTConfig,
        *,
        classifier: Classifier | None = None,
        regressor: Regressor | None = None,
        classes: Sequence[str] | None = None,
        start_us: int | None = None,
        hop_us: int | None = None,
        every_us: int | None = None,
        every_events: int | None = None,
        late: str = "accept",
        replay_events: int = 1 << 20,
    ) -> None:
        if isinstance(model, Model):
            self.config = model.config
            classes = model.classes if classes is None else classes
            classifier = CompiledClassifier(model) if classifier is None else classifier
            if regressor is None and model.config.needs_regressor:
                regressor = CompiledRegressor(model)
        elif isinstance(model, TNTConfig):
            self.config = model
        else:
            raise TypeError(
                f"`model` must be a Model or a TNTConfig, got {type(model).__name__}; load_model(name) loads one"
            )
        if classifier is None:
            raise TypeError("`classifier` is missing: a TNTConfig alone cannot decide; pass a Model or a callable")
        if not callable(classifier):
            raise TypeError(f"`classifier` must be callable, got {type(classifier).__name__}")
        window_us = self.config.window_us
        self._hop_us = window_us if hop_us is None else _positive("hop_us", hop_us)
        if self._hop_us > window_us:
            raise ValueError(f"`hop_us` must be at most window_us = {window_us}, got {hop_us}")
        self._every_us = None if every_us is None else _positive("every_us", every_us)
        self._every_events = None if every_events is None else _positive("every_events", every_events)
        start_us = None if start_us is None else checked_time("start_us", start_us)
        if isinstance(classes, str):
            raise TypeError(f"`classes` must be a sequence of names, got the single string {classes!r}")
        self.classifier = classifier
        self.classes = None if classes is None else tuple(classes)
        self._start_us = start_us
        self._door = EventDoor(self.config.sensor, late)
        n_volumes = -(-window_us // self._hop_us)
        if n_volumes > MAX_OPEN_WINDOWS:
            raise ValueError(
                f"`hop_us` must be at least window_us / {MAX_OPEN_WINDOWS} = {-(-window_us // MAX_OPEN_WINDOWS)}, "
                f"got {self._hop_us}: {n_volumes} windows would be open at once"
            )
        self._volumes = [
            TNTVolume(self.config, replay_events=replay_events, regressor=regressor) for _ in range(n_volumes)
        ]
        # One event by itself goes straight to the volume where nothing else has to be looked after.
        direct = n_volumes == 1 and every_events is None and late == "accept"
        self._add = self._volumes[0].add if direct else _ask_the_door
        self._may_warn = self.config.needs_replay
        self.reset()

    def __repr__(self) -> str:
        return f"Processor({self.config}, {len(self._open)} open windows, {self.counts.received} events received)"

    def reset(self) -> None:
        """Forget the stream: no window open, all counts zero. Classifier and settings stay."""
        self._door.reset()
        for volume in self._volumes:
            volume.reset()
        self._open: deque[TNTVolume] = deque()  # oldest first
        self._free = list(self._volumes)
        self._next_start_us: int | None = self._start_us  # of the next window to be opened; None: at the first event
        self._trigger_us = NEVER  # next time trigger of the oldest window
        self._n_decided = 0  # events of the oldest window at its last triggered decision
        self._n_received = 0
        self._n_late = 0
        if self._start_us is not None:
            self._open_windows(self._start_us)

    # -- events in ---------------------------------------------------------------------------------------

    def push(self, events: Any) -> list[Decision]:
        """Take a packet of events, in any form that `async_tnt.event_forms` lists.

        Arrays in the door's own form are read where they lie: leave them alone until `push` returns.

        Returns
        -------
        The decisions that fell: one for every window that the packet closed and every trigger it tripped.

        Raises
        ------
        ValueError, TypeError : the packet breaks a rule; the message names field, rule, value and event. The
            processor is as it was before.

        What the classifier raises passes through. Then the events before that decision are taken and the rest of
        the packet is not; the next push tries the decision again.
        """
        if type(events) is tuple and len(events) == 4 and type(events[0]) is int:
            return self.push_one(*events)
        return self._push(self._door(events))

    def push_one(self, t: int, x: int, y: int, p: int) -> list[Decision]:
        """Take one event: microseconds, pixels, polarity 0/1 or -1/+1. Otherwise as `push`."""
        answer = self._add(t, x, y, p)
        if answer == ABSORBED:
            return []
        if answer == AT_LIMIT:
            decisions: list[Decision] = []
            if self._open:
                self._advance(t, decisions)
            else:
                self._open_windows(t)
            self._add(t, x, y, p)
            return decisions
        columns = self._door.one(t, x, y, p)
        return self._push(self._door(([t], [x], [y], [p])) if columns is None else columns)

    def _push(self, columns: Columns) -> list[Decision]:
        decisions: list[Decision] = []
        n = columns.n
        if n and not self._open:
            self._open_windows(int(columns.t[0]))
        first = 0
        while first < n:
            last = n
            if self._every_events is not None:
                last = min(n, first + self._every_events - self._open[0].n_events % self._every_events)
            taken = self._take(columns, first, last)
            if self._every_events is not None and taken > first:
                self._fire_if_new("every_events", decisions, self._open[0].n_events % self._every_events == 0)
            if taken < last:
                self._advance(int(columns.t[taken]), decisions)
            first = taken
        if self._may_warn:
            for volume in self._volumes:
                volume.warn()
        return decisions

    def _take(self, columns: Columns, first: int, last: int) -> int:
        """Add events to all open windows up to the next moment when something has to happen."""
        oldest = self._open[0]
        if len(self._volumes) == 1:  # it counts for itself
            return oldest.take(columns, first, last)
        late = oldest.n_late
        taken = oldest.take(columns, first, last)
        self._n_late += oldest.n_late - late
        self._n_received += taken - first
        for volume in islice(self._open, 1, None):
            volume.take(columns, first, taken)
        return taken

    def _advance(self, t_us: int, decisions: list[Decision]) -> None:
        """Let time pass to `t_us`: trip triggers, close windows and open new ones on the way."""
        window_us = self.config.window_us
        while self._open:
            end_us = self._open[0].start_us + window_us
            if self._trigger_us <= t_us and self._trigger_us < end_us:
                self._fire_if_new("every_us", decisions)
                self._set_trigger(min(t_us, end_us))
            elif end_us <= t_us:
                volume = self._open[0]
                if volume.n_events:  # first: should the classifier raise, the window stays open
                    decisions.append(self._decide(volume, "window", complete=True))
                self._free.append(self._open.popleft())
                self._n_decided = 0
                self._set_trigger(end_us)
            else:
                break
        self._open_windows(t_us)

    def _open_windows(self, t_us: int) -> None:
        """Open every window on the grid that holds `t_us` and is not open yet; skip the empty ones between."""
        if self._next_start_us is None:
            self._next_start_us = t_us
        window_us, hop_us = self.config.window_us, self._hop_us
        start_us = self._next_start_us
        if start_us + window_us <= t_us:
            start_us += ((t_us - window_us - start_us) // hop_us + 1) * hop_us
        while start_us <= t_us or not self._open:
            volume = self._free.pop()
            volume.open(start_us)
            self._open.append(volume)
            if len(self._open) == 1:
                self._n_decided = 0
                self._set_trigger(max(t_us, start_us))
            start_us += hop_us
        self._next_start_us = start_us
        oldest_end_us = self._open[0].start_us + window_us
        limit_us = min(oldest_end_us, start_us, self._trigger_us)
        for volume in self._open:
            volume.set_limit(limit_us)

    def _set_trigger(self, now_us: int) -> None:
        """The oldest window's next time trigger after `now_us`."""
        self._trigger_us = NEVER
        if self._every_us is not None and self._open:
            start_us = self._open[0].start_us
            self._trigger_us = start_us + ((now_us - start_us) // self._every_us + 1) * self._every_us

    # -- decisions out -----------------------------------------------------------------------------------

    def fire(self) -> Decision:
        """Classify the open window as it stands. Changes nothing: no trigger, no window, no count.

        Before the first event, and after `finish`, the window is empty (`events` is 0).
        """
        return self._decide(self._oldest, "fire")

    def finish(self) -> list[Decision]:
        """The stream is over: classify the windows that are still open and hold events, and close them.

        Their `complete` is False and their trigger `end`. Should events follow all the same, they belong to
        later windows: those before the next window's start are late.
        """
        decisions = []
        while self._open:
            volume = self._open[0]
            if volume.n_events:
                decisions.append(self._decide(volume, "end"))
            volume.close()
            self._free.append(self._open.popleft())
        return decisions

    def _fire_if_new(self, trigger: str, decisions: list[Decision], due: bool = True) -> None:
        oldest = self._open[0]
        if due and oldest.n_events > self._n_decided:
            decisions.append(self._decide(oldest, trigger))
            self._n_decided = oldest.n_events

    def _decide(self, volume: TNTVolume, trigger: str, complete: bool = False) -> Decision:
        logits = self.classifier(volume.array)
        if not isinstance(self.classifier, CompiledClassifier):  # which returns them as they should be
            logits = np.asarray(logits).astype(np.float32).reshape(-1)  # a copy
        classes = tuple(str(k) for k in range(logits.size)) if self.classes is None else self.classes
        start_us, n_events = volume.start_us, volume.n_events
        time_us = volume.newest_us if n_events else start_us
        decision = decide(logits, classes, start_us, time_us, n_events, complete, trigger)
        self.classes = classes  # from the first answer on, where nobody named them
        return decision

    # -- looking in --------------------------------------------------------------------------------------

    @property
    def _oldest(self) -> TNTVolume:
        return self._open[0] if self._open else self._volumes[0]

    def volume(self) -> np.ndarray:
        """The (oldest) open window's volume as it stands: float32, shape (C, H, W), read-only; copy to keep."""
        return self._oldest.array

    @property
    def landmark(self) -> tuple[float, float]:
        """The (oldest) open window's landmark (x, y), in grid pixels."""
        return self._oldest.landmark

    @property
    def counts(self) -> Counts:
        """What became of the events, see `Counts`. Where windows overlap, `received` and `dropped_late` count
        an event once, the others once in every window it belongs to."""
        total = sum((volume.counts for volume in self._volumes), Counts())
        if len(self._volumes) == 1:
            received, late = total.received, total.dropped_late
        else:
            received, late = self._n_received, self._n_late
        dropped = self._door.n_dropped
        return Counts(
            received + dropped, total.kept, total.dropped_outside, total.dropped_tau_zero, late + dropped,
            total.dropped_unstored,
        )  # fmt: skip


def _ask_the_door(t: int, x: int, y: int, p: int) -> int:
    return REFUSED


def _positive(name: str, value: int) -> int:
    if not hasattr(value, "__index__") or isinstance(value, bool):
        raise TypeError(f"`{name}` must be a whole number, got {value!r}")
    if value < 1:
        raise ValueError(f"`{name}` must be at least 1, got {value}")
    return int(value)
