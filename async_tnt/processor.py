"""Processor: from packets of events to decisions, window by window."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.checks import checked_time
from async_tnt.config import TNTConfig
from async_tnt.decider import Classifier, Decider, networks_of
from async_tnt.decision import Decision
from async_tnt.decision_counts import Counts
from async_tnt.events import Columns, EventDoor
from async_tnt.kernels.absorb import ABSORBED, AT_LIMIT, REFUSED
from async_tnt.landmark_at_read import Regressor
from async_tnt.networks.model import Model
from async_tnt.stream_state import TRIGGERS, read_stream, restore_stream, save_stream
from async_tnt.timeline import Timeline
from async_tnt.triggers import LeakyIntegrator, Triggers
from async_tnt.windows import OpenWindows


def _trigger(name: str) -> property:
    """A trigger's setting, which may be changed while the stream runs."""
    return property(lambda self: getattr(self._triggers, name), lambda self, value: self._set(**{name: value}))


class Processor:
    """Takes events as they come and classifies windows of them.

    Windows are laid end to end from `start_us`, or else from the first event. A window that closes is
    classified; one without events is skipped. What is decided does not depend on how the stream is cut into
    packets.

    Parameters
    ----------
    model : a Model, or a TNTConfig together with `classifier`.
    classifier : any callable from a volume (float32 array, shape (C, H, W), read-only, valid during the call)
        to logits, finite ones; by default the model's own network, compiled, which computes only what has changed
        since the last decision. Others are in `async_tnt.networks`.
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
    confidence : close the window early, with a last decision, as soon as the likeliest class has this probability.
        It is looked for at every decision that the other triggers make, and where there is none, after every event.
        The window's remaining events are counted as `dropped_decided`.
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
        if isinstance(classes, str):
            raise TypeError(f"`classes` must be a sequence of names, got the single string {classes!r}")
        self._decider = Decider(self.config, classifier, classes)
        start_us = None if start_us is None else checked_time("start_us", start_us)
        self._start_us = start_us
        self._door = EventDoor(self.config.sensor, late)
        self._windows = OpenWindows(self.config, hop_us, start_us, replay_events, regressor)
        self._triggers = Triggers()
        self._timeline = Timeline(self._windows, self._triggers, self._decider)
        self._triggers.set(every_us=every_us, every_events=every_events, confidence=confidence, activity=activity)
        self.reset()

    def __repr__(self) -> str:
        return f"Processor({self.config}, {len(self._windows)} open windows, {self.counts.received} events received)"

    def reset(self) -> None:
        """Forget the stream: no window open, all counts zero. Classifier and settings stay."""
        self._door.reset()
        self._windows.reset()
        self._triggers.forget()
        self._choose_ways()
        if self._start_us is not None:
            self._timeline.open_windows(self._start_us)

    # -- settings that may change ------------------------------------------------------------------------

    @property
    def classifier(self) -> Classifier:
        """From a volume to logits. Another one takes over with the next decision."""
        return self._decider.classifier

    @classifier.setter
    def classifier(self, classifier: Classifier) -> None:
        self._decider.classifier = classifier

    @property
    def classes(self) -> tuple[str, ...] | None:
        """Class names; where nobody named them, known from the first decision on."""
        return self._decider.classes

    @property
    def start_us(self) -> int | None:
        """Start of the first window, in microseconds; None: of the first event."""
        return self._start_us

    @property
    def late(self) -> str:
        """What is done with an event older than the newest one seen: `accept`, `drop` or `raise`."""
        return self._door.late

    every_us = _trigger("every_us")
    every_events = _trigger("every_events")
    confidence = _trigger("confidence")
    activity = _trigger("activity")

    def _set(self, **settings: Any) -> None:
        self._triggers.set(**settings)
        self._choose_ways()
        self._timeline.wait_anew()

    def _choose_ways(self) -> None:
        """Take the shortest way for an event that the settings allow."""
        # One event by itself goes straight to the volume where nothing else has to be looked after.
        direct = not self._windows.overlap and self._door.late == "accept" and self.activity is None
        self._add = self._windows.oldest.add if direct else _ask_the_door
        self._look_at_events = self._triggers.look_at_events

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
        the packet is not (though `late="drop"` and `"raise"` have seen it: pushed again, what is older than its newest
        event is late). The end of a window, and `every_us`, are tried again at the next push; a decision that one event
        made due has been missed, and those that this packet had brought before are lost.
        """
        if type(events) is tuple and len(events) == 4 and type(events[0]) is int:
            return self.push_one(*events)
        return self._push(self._door(events))

    def push_one(self, t: int, x: int, y: int, p: int) -> list[Decision]:
        """Take one event: microseconds, pixels, polarity 0/1 or -1/+1. Otherwise as `push`."""
        if self._look_at_events:
            n_before = self._windows.oldest.n_events
        answer = self._add(t, x, y, p)
        decisions: list[Decision] = []
        if answer == AT_LIMIT:
            self._timeline.advance(t, decisions)
            n_before = self._windows.oldest.n_events
            answer = self._add(t, x, y, p)
        if answer == ABSORBED:
            if self._look_at_events and self._windows.oldest.n_events > n_before:  # else it was late
                self._timeline.taken_one(decisions)
            return decisions
        columns = self._door.one(t, x, y, p)
        return self._push(self._door(([t], [x], [y], [p])) if columns is None else columns)

    def _push(self, columns: Columns) -> list[Decision]:
        decisions = self._timeline.take(columns)
        if self.config.needs_replay:
            for volume in self._windows.volumes:
                volume.warn()
        return decisions

    # -- stop here, go on there --------------------------------------------------------------------------

    def save_state(self) -> bytes:
        """What the stream has left in this processor: open windows, counts, triggers.

        Another one with the same configuration and settings, in this process or in another, goes on from there after
        `restore_state`, with the same volumes and decisions, bit for bit. The classifier is not in it.
        """
        return save_stream(self._fixed_settings(), self._windows, self._triggers, self._door)

    def restore_state(self, state: bytes) -> None:
        """Go on where `save_state` was called. The triggers are set as they were there.

        Raises
        ------
        ValueError : damaged, or of a processor of other settings; the message names them. This one is then reset, or
            as it was before.
        """
        before = {name: getattr(self, name) for name in TRIGGERS}
        arrays, triggers = read_stream(state, self._fixed_settings())
        try:
            restore_stream(arrays, triggers, self._windows, self._triggers, self._door)
        except (TypeError, ValueError) as error:
            self._triggers.set(**before)
            self.reset()
            raise ValueError(f"`state` cannot be restored here: {error}") from None
        self._choose_ways()

    def _fixed_settings(self) -> dict[str, Any]:
        return {
            "config": self.config.to_dict(),
            "hop_us": self._windows.hop_us,
            "start_us": self.start_us,
            "late": self.late,
        }

    # -- decisions out -----------------------------------------------------------------------------------

    def fire(self) -> Decision:
        """Classify the open window as it stands. Changes nothing: no trigger, no window, no count.

        Before the first event, and after `finish`, the window is empty (`events` is 0).
        """
        return self._decider.decide(self._windows.oldest, "fire")

    def finish(self) -> list[Decision]:
        """The stream is over: classify the windows that are still open and hold events, and close them.

        Their `complete` is False and their trigger `end`. Should events follow all the same, they belong to
        later windows: those before the next window's start are late.
        """
        return self._timeline.finish()

    # -- looking in --------------------------------------------------------------------------------------

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
        return self._windows.counts(self._door.n_dropped)


def _ask_the_door(t: int, x: int, y: int, p: int) -> int:
    return REFUSED
