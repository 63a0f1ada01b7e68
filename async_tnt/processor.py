"""Processor: from packets of events to decisions, window by window.

A packet:    push -> EventDecoder.decode -> WindowScheduler.absorb -> TNTVolume.absorb -> kernels.absorb
A decision:  time passes (`_advance`), or an event makes one due (`_absorb_until_decision`) -> WindowClassifier.decide
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from async_tnt.checked_tensors import checked_array, read_state, state_bytes, with_prefix, without_prefix
from async_tnt.checks import checked_time
from async_tnt.config import TNTConfig
from async_tnt.decision import Counts, Decision
from async_tnt.deferred_landmark import Regressor
from async_tnt.events import Columns, EventDecoder
from async_tnt.kernels.absorb import ABSORBED, AT_LIMIT, REFUSED
from async_tnt.kernels.state import NEVER_US
from async_tnt.kernels.trigger import NOT_DUE, advance_triggers, why_due
from async_tnt.networks.model import Model
from async_tnt.triggers import LeakyIntegrator, Triggers
from async_tnt.window_classifier import TRIGGER_NAMES, Classifier, WindowClassifier, networks_of
from async_tnt.windows import WindowScheduler


def _trigger(name: str) -> property:
    """A trigger's setting, which may be changed while the stream runs."""
    return property(lambda self: getattr(self._triggers, name), lambda self, value: self._set(name, value))


class Processor:
    """Takes events as they come and classifies windows of them.

    Windows lie end to end from `start_us`, or else from the first event. A window that closes is classified; one
    without events is skipped. The decisions do not depend on how the stream is cut into packets.

    Parameters
    ----------
    model : a Model, or a TNTConfig together with `classifier`.
    classifier : any callable from a volume (float32 array, shape (C, H, W), read-only, valid during the call)
        to logits, finite ones; by default the model's own network, compiled, which computes only what has changed
        since the last decision. Others are in `async_tnt.networks`.
    regressor : with landmark `regressor`, see `TNTVolume`; by default the model's own network, compiled. Its errors
        are treated as the classifier's are, see `push`.
    classes : class names; by default the model's, or else "0", "1", ...
    start_us : start of the first window, in microseconds.
    hop_us : distance between the starts of windows, by default `window_us`. A smaller one gives overlapping
        windows; triggers and `fire` then concern the oldest open window, the most complete one.
    every_us : decide also whenever so much time has passed since the window's start, if events came meanwhile.
        The decision falls when the first event at or after that moment shows that it has come. With overlapping
        windows: at those moments of a window at which it is the oldest.
    every_events : decide also after every so many events of the window.
    confidence : close the window early, with a last decision, as soon as the likeliest class has this probability.
        It is looked for at every decision of the other triggers, or after every event if there are none. Events that
        still come for the window are counted as `dropped_decided`.
    activity : a `LeakyIntegrator`: decide also when much happens in little time.
    late : `accept`, `drop` or `raise`: what to do with an event older than the newest one seen. Events before
        every open window are always dropped and counted.
    replay_events : see `TNTVolume`.

    The triggers `every_us`, `every_events`, `confidence` and `activity` are attributes, too, and may be changed at
    any time; so may `classifier`.

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
        confidence: float | None = None,
        activity: LeakyIntegrator | None = None,
        late: str = "accept",
        replay_events: int = 1 << 20,
    ) -> None:
        self.config, classifier, regressor, classes = networks_of(model, classifier, regressor, classes)
        self._classifier = WindowClassifier(self.config, classifier, classes)
        start_us = None if start_us is None else checked_time("start_us", start_us)
        self._decoder = EventDecoder(self.config.sensor, late)
        self._new_windows = partial(WindowScheduler, self.config, hop_us, start_us, replay_events, regressor)
        self._windows = self._new_windows()
        hop_us = self._windows.hop_us  # the same settings must be where the stream continues
        self._fixed: dict[str, Any] = {
            "config": self.config.to_dict(),
            "hop_us": hop_us,
            "start_us": start_us,
            "late": late,
        }
        self._triggers = Triggers()
        self._triggers.set(every_us=every_us, every_events=every_events, confidence=confidence, activity=activity)
        self.reset()

    def __repr__(self) -> str:
        return f"Processor({self.config}, {len(self._windows)} open windows, {self.counts.received} events received)"

    def reset(self) -> None:
        """Forget the stream: no window open, all counts zero. Classifier and settings stay."""
        self._decoder.reset()
        self._windows.reset()
        self._triggers.forget()
        self._choose_paths()
        if self.start_us is not None:
            self._open_windows(self.start_us)

    # -- settings that may change ------------------------------------------------------------------------

    @property
    def classifier(self) -> Classifier:
        """From a volume to logits. A new one takes over at the next decision."""
        return self._classifier.classifier

    @classifier.setter
    def classifier(self, classifier: Classifier) -> None:
        self._classifier.classifier = classifier

    @property
    def classes(self) -> tuple[str, ...] | None:
        """Class names; if nobody gave any, known from the first decision on."""
        return self._classifier.classes

    @property
    def start_us(self) -> int | None:
        """Start of the first window, in microseconds; None: of the first event."""
        return self._fixed["start_us"]

    @property
    def late(self) -> str:
        """What is done with an event older than the newest one seen: `accept`, `drop` or `raise`."""
        return self._decoder.late

    every_us = _trigger("every_us")
    every_events = _trigger("every_events")
    confidence = _trigger("confidence")
    activity = _trigger("activity")

    def _set(self, name: str, value: Any) -> None:
        """Change a trigger; the open window goes on with it."""
        self._triggers.set(**{name: value})
        self._choose_paths()
        if len(self._windows):
            oldest = self._windows.oldest
            self._triggers.schedule(max(oldest.start_us, oldest.newest_us), oldest.start_us)
            self._windows.set_limit(self._triggers.next_due_us)

    def _choose_paths(self) -> None:
        """Choose the shortest path: where the settings allow it, a single event goes straight to the open volume."""
        direct = not self._windows.overlap and self._decoder.late == "accept" and self.activity is None
        self._absorb_one = self._windows.oldest.absorb_one if direct else _refuse
        self._by_event = self._triggers.by_event

    # -- events in ---------------------------------------------------------------------------------------

    def push(self, events: Any) -> list[Decision]:
        """Take a packet of events, in any form that `async_tnt.event_forms` lists.

        Columns that are already in the decoder's own form are not copied: do not change them until `push` returns.

        Returns
        -------
        The decisions: one for every window that the packet closed and every trigger that fired.

        Raises
        ------
        ValueError, TypeError : the packet breaks a rule; the message names field, rule, value and event. The
            processor is as it was before.

        What the classifier raises passes through. Then the events before that decision have been processed and the rest
        of the packet has not (but counts for `late`: pushed again, it is late), and the earlier decisions of the packet
        are lost. The end of a window, and `every_us`, are tried again at the next push; a decision that an event made
        due has been missed.
        """
        if type(events) is tuple and len(events) == 4 and type(events[0]) is int:
            return self.push_one(*events)
        return self._absorb(self._decoder.decode(events))

    def push_one(self, t: int, x: int, y: int, p: int) -> list[Decision]:
        """Take one event: microseconds, pixels, polarity 0/1 or -1/+1. Otherwise as `push`."""
        n_before = self._windows.oldest.n_events if self._by_event else 0
        answer = self._absorb_one(t, x, y, p)
        decisions: list[Decision] = []
        if answer == AT_LIMIT:
            self._advance(t, decisions)
            n_before = self._windows.oldest.n_events
            answer = self._absorb_one(t, x, y, p)
        if answer != ABSORBED:
            return self._absorb(self._decoder.decode_one(t, x, y, p))
        if self._by_event:
            self._accept(self._decide_if_due(n_before), self._windows.oldest.newest_us, decisions)
        return decisions

    def _absorb(self, columns: Columns) -> list[Decision]:
        """Add checked events and decide meanwhile."""
        windows = self._windows
        decisions: list[Decision] = []
        first, n = 0, columns.n
        while first < n:
            if not len(windows):
                self._open_windows(int(columns.t[first]))
            if self._by_event:
                first = self._absorb_until_decision(columns, first, decisions)
            else:
                first = windows.absorb(columns, first, n)
            if first < n and len(windows):
                self._advance(int(columns.t[first]), decisions)
        if self.config.needs_replay:
            windows.warn()
        return decisions

    def _absorb_until_decision(self, columns: Columns, first: int, decisions: list[Decision]) -> int:
        """Add events until one makes a decision due, or more in compiled code; returns the first one not added."""
        windows, triggers = self._windows, self._triggers
        oldest, error = windows.oldest, None
        if self._classifier.decides_in_stretches:
            before = oldest.n_late, oldest.n_decided
            absorbed, new, error = self._classifier.decide_stretch(oldest, triggers.state, columns, first, columns.n)
            windows.count_absorbed(columns, first, absorbed, before)
        else:
            n_before = oldest.n_events
            stop, fires = advance_triggers(triggers.state, oldest.buffer, columns.t, first, columns.n)
            absorbed = windows.absorb(columns, first, stop)
            new = self._decide_if_due(n_before, fires)
        if error is not None:
            raise error
        self._accept(new, oldest.newest_us, decisions)
        return absorbed

    def _decide_if_due(self, n_before: int, fires: bool = False) -> list[Decision]:
        """Decide about the oldest window if its newest event made that due; it held `n_before` events before."""
        oldest, triggers = self._windows.oldest, self._triggers
        why = why_due(triggers.state, n_before, oldest.n_events, fires)
        if why == NOT_DUE:
            return []
        decision = self._classifier.decide(oldest, TRIGGER_NAMES[why], confidence=triggers.confidence)
        return [decision] if decision.trigger else []

    # -- time passes -------------------------------------------------------------------------------------

    def _advance(self, t_us: int, decisions: list[Decision]) -> None:
        """Let time pass to `t_us`: `every_us` fires, windows close and open on the way."""
        windows, triggers = self._windows, self._triggers
        while len(windows):
            oldest, end_us = windows.oldest, windows.oldest_end_us
            if triggers.next_due_us <= t_us and triggers.next_due_us < end_us:
                new = []
                if oldest.n_events > triggers.n_decided:
                    new.append(self._classifier.decide(oldest, "every_us", confidence=triggers.confidence))
                triggers.schedule(min(t_us, end_us), oldest.start_us)
                self._accept(new, t_us, decisions)
            elif end_us <= t_us:
                if oldest.n_events:  # first: should the classifier raise, the window stays open
                    decisions.append(self._classifier.decide(oldest, "window", complete=True))
                windows.close_oldest()
                self._begin_oldest(end_us)
            else:
                break
        self._open_windows(t_us)

    def _open_windows(self, t_us: int) -> None:
        """Open the windows that are due at `t_us`."""
        if self._windows.open_due(t_us):
            self._begin_oldest(max(t_us, self._windows.oldest.start_us))
        self._windows.set_limit(self._triggers.next_due_us)

    def _accept(self, new: list[Decision], now_us: int, decisions: list[Decision]) -> None:
        """Append decisions about the oldest window; a complete one closes it early."""
        if not new:
            return
        decisions += new
        self._triggers.n_decided = new[-1].events
        if new[-1].complete:
            self._windows.close_oldest(early=True)
            self._begin_oldest(now_us)
            if len(self._windows):
                self._windows.set_limit(self._triggers.next_due_us)

    def _begin_oldest(self, now_us: int) -> None:
        """Another window has become the oldest, or none is open."""
        self._triggers.n_decided = 0
        self._triggers.next_due_us = NEVER_US
        if len(self._windows):
            self._triggers.schedule(now_us, self._windows.oldest.start_us)

    # -- results -----------------------------------------------------------------------------------------

    def fire(self) -> Decision:
        """Classify the open window as it stands. Changes nothing: no trigger, no window, no count.

        Before the first event, and after `finish`, the window is empty (`events` is 0).
        """
        return self._classifier.decide(self._windows.oldest, "fire")

    def finish(self) -> list[Decision]:
        """The stream is over: classify the windows that are still open and hold events, and close them.

        Their `complete` is False and their trigger `end`. Events that follow nevertheless belong to later windows:
        those before the next window's start are late.
        """
        decisions = []
        while len(self._windows):
            if self._windows.oldest.n_events:
                decisions.append(self._classifier.decide(self._windows.oldest, "end"))
            self._windows.close_oldest()
        return decisions

    def volume(self) -> np.ndarray:
        """The (oldest) open window's volume as it stands: float32, shape (C, H, W), read-only; copy to keep."""
        return self._windows.oldest.array

    @property
    def landmark(self) -> tuple[float, float]:
        """The (oldest) open window's landmark (x, y), in grid pixels."""
        return self._windows.oldest.landmark

    @property
    def counts(self) -> Counts:
        """What became of the events, see `Counts`. Where windows overlap, `received`, `dropped_late` and
        `dropped_decided` count an event once, the others once in every window it belongs to."""
        return self._windows.counts(self._decoder.n_dropped)

    # -- stop here, continue elsewhere -------------------------------------------------------------------

    def save_state(self) -> bytes:
        """The state of the stream: open windows, counts, triggers, not the classifier.

        After `restore_state`, another processor with the same configuration and settings, in any process, continues
        with the same volumes and decisions, bit for bit.
        """
        arrays = self._windows.save() | with_prefix("triggers", self._triggers.save())
        arrays["door"] = np.array((self._decoder.newest_us, self._decoder.n_dropped), np.int64)
        return state_bytes(arrays, {"fixed": self._fixed, "triggers": self._triggers.settings()})

    def restore_state(self, state: bytes) -> None:
        """Continue where `save_state` was called. The triggers are set as they were there.

        Raises
        ------
        ValueError : damaged, or of a processor with other settings (the message names them). Nothing has changed then.
        """
        arrays, about = read_state(state, self._fixed)
        windows, triggers = self._new_windows(), Triggers()
        try:
            windows.restore(arrays)
            triggers.restore(without_prefix("triggers", arrays), about.get("triggers"))
            newest_us, n_dropped = checked_array(arrays, "door", np.int64, (2,)).tolist()
            self._decoder.restore(newest_us, n_dropped)
        except (TypeError, ValueError) as error:
            raise ValueError(f"`state` cannot be restored here: {error}") from None
        self._windows, self._triggers = windows, triggers
        self._choose_paths()
        if len(windows):
            windows.set_limit(triggers.next_due_us)


def _refuse(t: int, x: int, y: int, p: int) -> int:
    return REFUSED
