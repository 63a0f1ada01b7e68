"""Processor: from packets of events to decisions, window by window.

A packet:    push -> EventDecoder.decode -> WindowScheduler.absorb -> TNTVolume.absorb -> a kernel
A decision:  time passes (`_advance`), or an event makes it due (`_absorb_until_decision`)
             -> WindowClassifier.decide
Both:        with a CompiledClassifier, in one compiled call (`_absorb_stretch`)
             -> WindowClassifier.decide_stretch
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Generic, cast

import numpy as np

from async_tnt.base.checks import ParameterValueError, checked_time
from async_tnt.base.messages import short
from async_tnt.base.running import Method, Running, one_at_a_time
from async_tnt.kernels.decisions.trigger import NOT_DUE, ONLY_IF_SURE, until_due, why_due
from async_tnt.kernels.volume.absorb import ABSORBED, AT_LIMIT, LATE
from async_tnt.kernels.volume.state import NEVER_US
from async_tnt.networks.models.compiled import CompiledClassifier
from async_tnt.networks.models.compiled_network import CompiledNetwork
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.models.spiking_volume import SpikingVolume
from async_tnt.streaming.decision import Trigger
from async_tnt.streaming.output import AnswerT
from async_tnt.streaming.restarts import OnRestart, RestartWatch, part_of
from async_tnt.streaming.saved_state import dump_state, load_state, named_networks
from async_tnt.streaming.stream_networks import networks_of
from async_tnt.streaming.stretches import STRETCH, TRIGGER_NAMES
from async_tnt.streaming.triggers import (
    TriggerAttributes,
    Triggers,
    TriggerSettings,
    warn_if_never_due,
)
from async_tnt.streaming.window_classifier import Classifier, WindowClassifier
from async_tnt.streaming.window_outputs import WindowOutputs
from async_tnt.streaming.window_spikes import WindowSpikes
from async_tnt.streaming.windows import WindowScheduler
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.counts import Counts
from async_tnt.volume.events import LARGER_CAMERA, Columns, EventDecoder, Late
from async_tnt.volume.regressor import Regressor
from async_tnt.volume.single_event import SingleEventReader
from async_tnt.volume.volume import TNTVolume


def _check_same_kind(saved: Any, network: Any) -> None:
    """Refuse a network of another kind than that of a saved stream, or with other outputs."""
    kinds = {True: "a spiking network", False: "another network"}
    is_spiking = isinstance(network, SpikingNetwork)
    if isinstance(saved, WindowSpikes) != is_spiking:
        rule = f"must be of a stream with {kinds[is_spiking]}"
        raise ParameterValueError("state", rule, f"one with {kinds[not is_spiking]}")
    outputs = None
    if is_spiking:
        outputs = network.outputs
    elif isinstance(network, CompiledNetwork):
        outputs = dict(zip(network.names, network.output_shapes, strict=True))
    saved_outputs = getattr(saved, "outputs", None)
    if saved_outputs != outputs:
        rule = f"must be of a stream with the raw outputs {short(outputs)}"
        raise ParameterValueError("state", rule, short(saved_outputs))


def _recovering(method: Method) -> Method:
    """Decorate a method so that an exception in it leaves the Processor's state consistent."""

    @functools.wraps(method)
    def recovering(self: Any, *args: Any, **kwargs: Any) -> Any:
        try:
            return method(self, *args, **kwargs)
        except BaseException:
            self._recover()
            raise

    return cast(Method, recovering)


class Processor(TriggerAttributes, Generic[AnswerT]):
    """A stream of events that is classified, window by window, while the events arrive.

    Windows lie end to end, from `start_us` or else from the first event. A window is classified
    when it closes, and skipped if it holds no events. A window of `window_events` begins with the
    first event after the previous window, and is classified when its last event arrives. The
    decisions do not depend on how the stream is cut into packets.

    With a model of raw outputs each answer is an `Output`, not a `Decision`: for type checkers,
    `Processor[Output](model)`. Its arrays are views, which the next call changes. If a packet makes
    several answers due, all but the last get arrays of their own.

    Parameters
    ----------
    model : a Model, its name or path, or a TNTConfig together with `classifier`.
    classifier : a callable from a volume (float32 array, shape (C, H, W), read-only, valid during
        the call) to finite logits. By default the model's own network, compiled, which computes
        only what has changed since the last decision. Others are in `async_tnt.networks`.
    classes : class names; by default the model's, or "0", "1", ...
    start_us : start of the first window, in microseconds. Not with `window_events`.
    hop_us : distance between the starts of windows, by default `window_us`. With a smaller distance
        windows overlap. Triggers and `fire` then concern the oldest open window, the most complete
        one. Not with `window_events`.
    every_us : decide also at every multiple of this time, in microseconds, after the window's
        start, if new events have arrived. The decision is made when the first event at or after
        that moment arrives, and only for the oldest window.
    every_events : decide also whenever this many more events of the window have arrived.
    confidence : close the window early, with a last decision, as soon as the likeliest class has
        this probability. It is checked at every decision of the other triggers, or after every
        event if there are no others. Events that still arrive for the window are counted as
        `dropped_decided`. A window that slides goes on: there a decision is due when the likeliest
        class has this probability and is another one than at the last decision by confidence. Not
        for models that find objects.
    regressor, late : see `TNTVolume`; a model has a compiled regressor of its own.
    on_restart : what to do where the clock of the events begins again, as in a recording that is
        read twice or after a camera was plugged in again, so that whole packets are older than the
        open window. "warn": warn once; the events are dropped as late. "reset": decide about the
        open windows, call `reset()`, and use these events. "raise": raise a ValueError before any
        event of the packet is used. `async_tnt.streaming.restarts` says how a restart is told from
        late events.
    keep_neurons : whether the neurons of a spiking model go on from window to window, see
        `SpikingVolume`. By default each window begins with neurons at rest.

    A copy continues the stream, bit for bit, and so does a pickle. `every_us`, `every_events`,
    `confidence` and `classifier` are attributes, too, and may change between calls. A call raises a
    RuntimeError while another call is running, in another thread or further up in the same thread.

    Examples
    --------
    >>> config = TNTConfig(window_us=1000)
    >>> processor = Processor(config, classifier=lambda volume: [volume.sum(), 0.0])
    >>> processor.push(([0, 10, 999], [16, 17, 16], [16, 16, 17], [1, 1, 1]))
    []
    >>> [decision.events for decision in processor.push(([1000], [5], [5], [0]))]
    [3]
    """

    # Slots make it an error to assign a trigger whose name is mistyped.
    __slots__ = (
        "__weakref__",
        "_accepts_late",
        "_classifier",
        "_decides_by_event",
        "_decides_in_stretches",
        "_decoder",
        "_direct_volume",
        "_known_oldest",
        "_late_before_us",
        "_read_one",
        "_restarts",
        "_running",
        "_stream_time_us",
        "_triggers",
        "_windows",
        "config",
    )

    def __init__(
        self,
        model: Model | TNTConfig | str | Path,
        *,
        classifier: Classifier | None = None,
        regressor: Regressor | None = None,
        classes: Sequence[str] | None = None,
        start_us: int | None = None,
        hop_us: int | None = None,
        every_us: int | None = None,
        every_events: int | None = None,
        confidence: float | None = None,
        late: Late = "accept",
        on_restart: OnRestart = "warn",
        keep_neurons: bool = False,
    ) -> None:
        networks = networks_of(model, classifier, regressor, classes)
        config = networks.config
        self.config = config
        self._classifier: WindowClassifier | WindowOutputs | WindowSpikes
        spiking: SpikingNetwork | None = None
        if isinstance(networks.classifier, SpikingNetwork):
            spiking = networks.classifier
            self._classifier = WindowSpikes(spiking, tuple(networks.classes or ()), confidence)
        elif isinstance(networks.classifier, CompiledNetwork):
            self._classifier = WindowOutputs(config, networks.classifier, confidence)
        else:
            self._classifier = WindowClassifier(
                config, networks.classifier, networks.classes, confidence
            )
        self._running = Running("Processor")
        self._triggers = Triggers(
            TriggerSettings(every_us=every_us, every_events=every_events, confidence=confidence)
        )
        warn_if_never_due(self._triggers.settings, config)
        self._decoder = EventDecoder(config.sensor, late, LARGER_CAMERA)
        self._read_one = SingleEventReader()
        self._accepts_late = late == "accept"
        self._restarts = RestartWatch(on_restart, config.window_us)
        self._windows = WindowScheduler(
            config, hop_us, start_us, networks.regressor, spiking, keep_neurons
        )
        self._choose_ways()
        self.reset()

    def __repr__(self) -> str:
        return (
            f"Processor({self.config}, {len(self._windows)} open windows, "
            f"{self.counts.received} events received)"
        )

    @one_at_a_time
    @_recovering
    def reset(self) -> None:
        """Forget the stream: no window open, all counts zero. Classifier and settings stay."""
        self._reset()

    def _reset(self) -> None:
        self._restarts.reset()
        self._decoder.reset()
        self._windows.reset()
        self._classifier.forget()
        self._begin_oldest(-1)
        if self.start_us is not None:
            self._open_windows(self.start_us)
            self._stream_time_us = -1  # no event has come

    def push(self, events: Any) -> list[AnswerT]:
        """Process a packet of `events`, in any form that `async_tnt.volume.event_forms` lists.

        Returns
        -------
        list : one decision for each window that the packet closes and for each trigger that fires.

        Raises
        ------
        ValueError, TypeError : the packet is invalid. The message names field, rule, value and
            event; nothing changes.
        Exception : an error of the classifier or the regressor passes through. The events before
            the failed decision have been processed then, and the other events have not. But if
            `late` is not "accept", all events of the packet have been seen, and are late if they
            are pushed again. The packet's earlier decisions are lost. The next push repeats a
            failed decision at a window's end or of `every_us`; a failed decision that an event made
            due is lost.
        """
        # the usual forms first: to look for a single event of another form takes 200 ns
        is_four = type(events) is tuple and len(events) == 4
        kind = type(events[0]) if is_four else type(events)
        if is_four and kind is int:
            return self.push_one(*events)
        if kind is not np.ndarray:
            event = self._read_one(events)
            if event is not None:
                return self.push_one(*event)
        # the lines of `Running.begin`: a call of this method would take another 30 ns
        running = self._running
        if running.now:
            raise running.overlap()
        running.now = True
        try:
            decoder = self._decoder
            columns = decoder.decode(events, False)
            if decoder.first_us < self._late_before_us:
                return self._take_watched(columns, [])
            if not self._accepts_late:
                columns = decoder.apply_policy(columns)
            return self._absorb(columns, [])
        except BaseException:
            self._recover()
            raise
        finally:
            running.now = False

    def push_one(self, t: int, x: int, y: int, p: int) -> list[AnswerT]:
        """`push` for one event.

        `t` is in microseconds, `x` and `y` are in pixels. The polarity `p` is 0 or 1, or -1 or +1.
        """
        # the lines of `Running.begin`: a call of this method would take another 30 ns
        running = self._running
        if running.now:
            raise running.overlap()
        running.now = True
        try:
            volume = self._direct_volume
            if volume is None:
                return self._take_watched(self._decoder.decode_one(t, x, y, p, False), [])
            n_before = volume.n_arrived if self._decides_by_event else -1
            outcome = volume.absorb_one(t, x, y, p)
            # the usual case, in which no single event makes a decision due
            if outcome == ABSORBED and n_before < 0:
                return []

            decisions: list[AnswerT] = []
            if outcome == AT_LIMIT:
                self._advance(t, decisions)
                n_before = volume.n_arrived
                outcome = volume.absorb_one(t, x, y, p)
            if outcome == LATE:
                self._look_at_late(t, x, y, p, decisions)
            elif outcome != ABSORBED:
                self._take_watched(self._decoder.decode_one(t, x, y, p, False), decisions)
            elif self._decides_by_event:
                self._accept(self._decide_if_due(n_before, decisions), volume.newest_us, decisions)
            return decisions
        except BaseException:
            self._recover()
            raise
        finally:
            running.now = False

    def _recover(self) -> None:
        """Make the state consistent, as if the stream had ended at some event of the packet.

        This is called after any exception, also after Ctrl-C in the middle of a step. After an
        error of a classifier the state is consistent already.
        """
        windows = self._windows
        windows.recover()
        self._triggers.set(self._triggers.settings)
        self._choose_ways()
        if self._known_oldest != self._oldest_window():
            self._begin_oldest(self._newest_us)
        self._triggers.n_at_decision = min(self._triggers.n_at_decision, windows.oldest.n_arrived)
        windows.set_limit(self._triggers.next_due_us)

    def _oldest_window(self) -> tuple[TNTVolume, int] | None:
        """The oldest open window and its start; None if no window is open."""
        windows = self._windows
        if not len(windows):
            return None
        return windows.oldest, windows.oldest.start_us

    def _take_watched(self, columns: Columns, decisions: list[AnswerT]) -> list[AnswerT]:
        """Add checked events. If the first event is late, first look for restarts."""
        if self._decoder.first_us >= self._late_before_us:
            return self._absorb(self._decoder.apply_policy(columns), decisions)
        first = self._look(columns)
        # the clock may begin again several times in one packet
        while first is not None:
            columns = self._begin_again(columns, first, decisions)
            first = self._look(columns)
        self._absorb(self._decoder.apply_policy(columns), decisions)
        self._restarts.note(self._newest_us, self._windows.oldest.n_arrived)
        return decisions

    def _look(self, columns: Columns) -> int | None:
        """The event of the packet with which a new stream begins, see `RestartWatch.look`."""
        return self._restarts.look(columns, self._newest_us, self._windows.oldest.n_arrived)

    def _look_at_late(self, t: int, x: int, y: int, p: int, decisions: list[AnswerT]) -> None:
        """Check whether the clock has begun again at an event that has been counted as late."""
        columns = self._decoder.decode_one(t, x, y, p, False)
        first = self._look(columns)
        if first is not None:
            columns = self._begin_again(columns, first, decisions)
            self._absorb(self._decoder.apply_policy(columns), decisions)

    @property
    def _newest_us(self) -> int:
        """Time of the stream's newest event so far; -1 if there was none."""
        return max(self._stream_time_us, self._windows.oldest.newest_us)

    def _begin_again(self, columns: Columns, first: int, decisions: list[AnswerT]) -> Columns:
        """End the stream, and begin another one with the packets that waited.

        Returns the events from `first` on, with which the new stream goes on.
        """
        waiting = self._restarts.waiting
        self._absorb(self._decoder.apply_policy(part_of(columns, 0, first)), decisions)
        self._finish(decisions)
        self._reset()
        for packet in waiting:
            self._absorb(self._decoder.apply_policy(packet), decisions)
        return part_of(columns, first, columns.n)

    def _absorb(self, columns: Columns, decisions: list[AnswerT]) -> list[AnswerT]:
        """Add checked events, and append the decisions that became due."""
        windows = self._windows
        first = 0
        n = columns.n
        # If the classifier raised an error when a window became full, this window is still open,
        # and full before the first event.
        while first < n or windows.is_full:
            if not len(windows):
                self._open_windows(int(columns.t[first]))
            if self._decides_by_event:
                first = self._absorb_until_decision(columns, first, decisions)
            else:
                first = windows.absorb(columns, first, n)

            if windows.is_full:
                self._decide_and_close_oldest(windows.oldest.newest_us, decisions)
            elif first < n and len(windows):
                is_due = self._triggers.next_due_us < windows.oldest_end_us
                if is_due and self._decides_in_stretches and n - first >= STRETCH:
                    first = self._absorb_stretch(columns, first, decisions)
                else:
                    self._advance(int(columns.t[first]), decisions)
        return decisions

    def _absorb_until_decision(self, columns: Columns, first: int, decisions: list[AnswerT]) -> int:
        """Add events until one of them makes a decision due, and make this decision.

        Compiled code goes on after a decision that does not close the window. Returns the first
        event not added.
        """
        if self._decides_in_stretches:
            return self._absorb_stretch(columns, first, decisions)
        windows = self._windows
        oldest = windows.oldest
        n_before = oldest.n_arrived
        last = min(columns.n, first + windows.room)
        stop = until_due.call(self._triggers.state, n_before, first, last)
        absorbed = windows.absorb(columns, first, stop)
        # a full window gets its last decision when it is closed
        if not windows.is_full:
            self._accept(self._decide_if_due(n_before, decisions), oldest.newest_us, decisions)
        return absorbed

    def _absorb_stretch(self, columns: Columns, first: int, decisions: list[AnswerT]) -> int:
        """Add events up to the window's end, or to a decision that closes the window.

        Returns the first event not added.
        """
        oldest = self._windows.oldest
        self._windows.begin_sharing(columns, first)
        assert not isinstance(self._classifier, WindowOutputs)
        absorbed, new_decisions, error = self._classifier.decide_stretch(
            oldest, self._triggers.state, columns, first, columns.n
        )
        self._windows.share()
        if error is not None:
            raise error
        self._accept(cast(list[Any], new_decisions), oldest.newest_us, decisions)
        return absorbed

    def _decide(
        self,
        decisions: list[AnswerT],
        trigger: Trigger,
        complete: bool = False,
    ) -> Any:
        """The decision about the oldest window as it is now.

        Parameters
        ----------
        decisions : the earlier decisions of this call. If their arrays are views, the new decision
            would change the last one: it gets arrays of its own.
        trigger, complete : see `WindowClassifier.decide`.
        """
        if decisions and self._classifier.answers_are_views:
            decisions[-1] = copy.copy(decisions[-1])
        return self._classifier.decide(self._windows.oldest, trigger, complete)

    def _is_sure(self, decision: Any) -> bool:
        """Whether a decision is one by `confidence`. Then it says so, and closes its window."""
        level = self._triggers.settings.confidence
        if level is None:
            return False
        self._classifier.check_confidence(level)  # the first answer may be of objects
        slides = self.config.slides
        if not self._triggers.is_sure(decision.index, decision.probability, slides):
            return False
        decision.trigger = "confidence"
        decision.complete = not slides
        return True

    def _decide_if_due(self, n_before: int, decisions: list[AnswerT]) -> list[AnswerT]:
        """The decision that the oldest window's newest event made due, if any.

        Parameters
        ----------
        n_before : number of events in the window before the newest events were added.
        decisions : the earlier decisions of this call.
        """
        oldest = self._windows.oldest
        triggers = self._triggers
        why = why_due.call(triggers.state, n_before, oldest.n_arrived)
        if why == NOT_DUE:
            return []
        decision = self._decide(decisions, TRIGGER_NAMES[why])
        is_sure = self._is_sure(decision)
        # With `confidence` alone, the window is classified after each event, but only an answer
        # that reaches the confidence is a decision.
        if why == ONLY_IF_SURE and not is_sure:
            return []
        triggers.n_at_decision = oldest.n_arrived
        return [decision]

    def _advance(self, t_us: int, decisions: list[AnswerT]) -> None:
        """Let time pass to `t_us`. On the way, `every_us` fires, and windows close and open."""
        windows = self._windows
        triggers = self._triggers
        while len(windows):
            oldest = windows.oldest
            end_us = windows.oldest_end_us
            if triggers.next_due_us <= t_us and triggers.next_due_us < end_us:
                new_decisions = []
                if oldest.n_arrived > triggers.n_at_decision:
                    oldest.advance(triggers.next_due_us)
                    decision = self._decide(decisions, "every_us")
                    self._is_sure(decision)
                    new_decisions = [decision]
                    triggers.n_at_decision = oldest.n_arrived
                triggers.schedule(min(t_us, end_us), oldest.start_us)
                self._accept(new_decisions, t_us, decisions)
            elif end_us <= t_us:
                self._decide_and_close_oldest(end_us, decisions)
            else:
                break
        self._open_windows(t_us)

    def _decide_and_close_oldest(self, now_us: int, decisions: list[AnswerT]) -> None:
        """Decide about the complete oldest window, unless it is empty, and close it."""
        oldest = self._windows.oldest
        # The decision is made before the window is closed, so that the window stays open if the
        # classifier raises an error.
        if oldest.n_arrived:
            decisions.append(self._decide(decisions, "window", complete=True))
        self._stream_time_us = max(self._newest_us, now_us)
        self._windows.close_oldest()
        self._begin_oldest(now_us)

    def _open_windows(self, t_us: int) -> None:
        """Open the windows that are due at `t_us`."""
        if self._windows.open_due(t_us):
            self._begin_oldest(t_us)
        self._windows.set_limit(self._triggers.next_due_us)

    def _accept(self, new: list[AnswerT], now_us: int, decisions: list[AnswerT]) -> None:
        """Append new decisions about the oldest window. A complete decision closes it early."""
        decisions += new
        if new and new[-1].complete:
            self._stream_time_us = max(self._newest_us, now_us)
            self._windows.close_oldest(early=True)
            self._begin_oldest(now_us)
            self._windows.set_limit(self._triggers.next_due_us)

    def _begin_oldest(self, now_us: int) -> None:
        """Set what depends on the oldest window, after another one has become the oldest.

        This is also called when no window is open any more.

        now_us : a time at or after all events so far.
        """
        windows = self._windows
        self._stream_time_us = now_us
        self._late_before_us = NEVER_US if self._restarts.looks_at_all else windows.late_before_us
        if len(windows):
            start_us = windows.oldest.start_us
            self._triggers.begin_window(max(now_us, start_us), start_us)
        else:
            self._triggers.begin_window(now_us, None)
        self._known_oldest = self._oldest_window()

    def fire(self, at_us: int | None = None) -> AnswerT:
        """Classify the open window as it is now, without any change to the stream.

        Before the first event, an empty volume is classified.

        at_us : the time that it is now, in microseconds, for a window of `last_us`: older events
            have left it by then. By default it is the time of the newest event.
        """
        self._running.begin()
        try:
            if at_us is not None:
                self._windows.oldest.advance(checked_time("at_us", at_us))
            answer: AnswerT = self._decide([], "fire")
            return answer
        finally:
            self._running.now = False

    @one_at_a_time
    @_recovering
    def finish(self) -> list[AnswerT]:
        """End the stream: classify the open windows that hold events, and close them.

        The decisions have `complete` False and the trigger `end`. Events of these windows that
        still come are late. But if windows have a number of events, or slide, such events begin
        another window.
        """
        return self._finish([])

    def _finish(self, decisions: list[AnswerT]) -> list[AnswerT]:
        end_us = self._newest_us
        # If the classifier raised an error when this window became full, the window is still open.
        # It is complete, so its decision has the trigger `window`, not `end`.
        if self._windows.is_full:
            self._decide_and_close_oldest(self._windows.oldest.newest_us, decisions)
        while len(self._windows):
            oldest = self._windows.oldest
            if oldest.n_arrived:
                decisions.append(self._decide(decisions, "end"))
            self._stream_time_us = end_us
            self._windows.close_oldest()
            self._begin_oldest(end_us)
        return decisions

    @one_at_a_time
    def volume(self) -> np.ndarray:
        """The (oldest) open window's volume as it is now: float32, shape (C, H, W), read-only.

        Copy it to keep it.
        """
        return self._windows.oldest.array

    @property
    def landmark(self) -> tuple[float, float]:
        """The (oldest) open window's landmark (x, y), in grid pixels."""
        return self._windows.oldest.landmark

    @property
    def layer_spikes(self) -> dict[str, int]:
        """Layer of neurons -> its spikes in the (oldest) open window; empty for other networks."""
        volume = self._windows.oldest
        if not isinstance(volume, SpikingVolume):
            return {}
        return {layer: volume.spikes(layer) for layer in volume.network.layers}

    @property
    def counts(self) -> Counts:
        """What became of the events.

        Where windows overlap, `received`, `dropped_late` and `dropped_decided` count an event once.
        The other counts include an event once for each window that contains it.
        """
        return self._windows.counts(self._decoder.n_dropped)

    @property
    def classifier(self) -> Classifier | SpikingNetwork:
        """The callable from a volume to logits, or a spiking model's network.

        A classifier that is assigned is used from the next decision on. It is refused if it cannot
        fit the model.
        """
        return self._classifier.classifier

    @classifier.setter
    @one_at_a_time
    def classifier(self, classifier: Classifier) -> None:
        self._classifier.exchange(classifier, self._triggers.settings.confidence)
        self._choose_ways()

    @one_at_a_time
    def exchange(self, model: Model) -> None:
        """Decide with another model from now on, such as one to which a class was taught.

        Open windows and settings stay as they are.

        Parameters
        ----------
        model : a model of windows with the same configuration. Its classes may be others.

        Raises
        ------
        ValueError : the model has another configuration, or it or the Processor decides about
            something else than windows, or its landmark needs a network.
        """
        classifier = self._classifier
        of_windows = bool(model.classes) and not model.is_spiking and model.places is None
        is_one = isinstance(classifier, WindowClassifier) and not classifier.finds_objects
        if not of_windows or not is_one or self.config.needs_regressor:
            rule = (
                "must decide about windows, as this Processor does, and without a landmark "
                "network: make a new Processor"
            )
            raise ParameterValueError("model", rule)
        if model.config != self.config:
            rule = f"must be of the configuration {self.config}"
            raise ParameterValueError("model", rule, f"one of {model.config}")
        assert isinstance(classifier, WindowClassifier)
        confidence = self._triggers.settings.confidence
        classifier.exchange(CompiledClassifier(model), confidence, model.classes)
        self._triggers.forget()  # classes have other numbers now
        self._choose_ways()

    @property
    def classes(self) -> tuple[str, ...] | None:
        """Class names; None before the first decision if none were given.

        They are empty for a model of raw outputs.
        """
        return self._classifier.classes

    @property
    def answers_are_views(self) -> bool:
        """Whether answers are `Output` values, whose arrays the next call changes."""
        return self._classifier.answers_are_views

    @property
    def start_us(self) -> int | None:
        """Start of the first window, in microseconds; None: at the first event."""
        return self._windows.start_us

    @property
    def late(self) -> Late:
        """What is done with an event older than the newest one: `accept`, `drop` or `raise`."""
        return self._decoder.late

    @property
    def on_restart(self) -> OnRestart:
        """What is done where the clock begins again: `warn`, `reset` or `raise`."""
        return self._restarts.on_restart

    @one_at_a_time
    @_recovering
    def _set_triggers(self, settings: TriggerSettings) -> None:
        """Change the triggers; they apply to the open window, too."""
        self._classifier.check_confidence(settings.confidence)
        if settings.confidence != self._triggers.settings.confidence:
            self._triggers.forget()
        self._triggers.set(settings)
        self._choose_ways()
        if len(self._windows):
            oldest = self._windows.oldest
            self._triggers.schedule(max(oldest.start_us, oldest.newest_us), oldest.start_us)
        self._windows.set_limit(self._triggers.next_due_us)

    def _choose_ways(self) -> None:
        """Choose how events are absorbed, as the settings and the classifier allow."""
        settings = self._triggers.settings
        overlap = self._windows.overlap
        # With one volume that takes late events, single events go to the volume without the
        # decoder, unless all events are looked at for restarts. `_direct_volume` is this volume,
        # or None if single events need the decoder.
        needs_no_decoder = not overlap and self._accepts_late and not self._restarts.looks_at_all
        self._direct_volume: TNTVolume | None = self._windows.oldest if needs_no_decoder else None
        self._decides_by_event = settings.by_event
        # With overlap and `every_us`, time passes for several windows at once, which the compiled
        # call cannot do.
        times_several_windows = overlap and settings.every_us is not None
        self._decides_in_stretches = (
            self._classifier.decides_in_stretches and not times_several_windows
        )
        if self._decides_in_stretches and (settings.by_event or settings.every_us is not None):
            assert not isinstance(self._classifier, WindowOutputs)
            self._classifier.prepare_stretches()

    @one_at_a_time
    def save_state(self) -> bytes:
        """The state of the stream as bytes, without the classifier and the regressor.

        The state is much smaller than a pickle of the Processor. `from_state` continues the stream,
        bit for bit, in any process of the same release. The state is a pickle, too: do not load a
        state that you do not trust.
        """
        networks = named_networks(self.classifier, self._windows.regressor)
        return dump_state(super().__getstate__(), networks)

    @classmethod
    def from_state(
        cls,
        state: bytes,
        model: Model | TNTConfig,
        *,
        classifier: Classifier | None = None,
        regressor: Regressor | None = None,
    ) -> Processor[AnswerT]:
        """A Processor that continues the stream of `save_state`, with the same settings.

        `model`, `classifier` and `regressor` are those that the saved Processor was made with.

        Raises
        ------
        ValueError : the bytes are not the state of a stream, or this stream had another
            configuration or other classes.
        """
        networks = networks_of(model, classifier, regressor, None)
        values = load_state(state, named_networks(networks.classifier, networks.regressor))
        if not (isinstance(values, tuple) and len(values) == 2 and isinstance(values[1], dict)):
            rule = "must be what `save_state` returned"
            raise ParameterValueError("state", rule, f"a pickle of {type(values).__name__}")
        processor = cls.__new__(cls)
        processor.__setstate__(values)

        config = networks.config
        if processor.config != config:
            rule = f"must be of the configuration {config}"
            raise ParameterValueError("state", rule, f"one of {processor.config}")
        _check_same_kind(processor._classifier, networks.classifier)
        classes = networks.classes
        if classes is not None and processor.classes != tuple(classes):
            raise ValueError(
                f"`state` must be of the classes {short(classes)}, got {short(processor.classes)}"
            )
        return processor

    def __copy__(self) -> Processor[AnswerT]:
        """A Processor that continues the stream by itself, as a Processor from a pickle does."""
        return copy.deepcopy(self)

    @one_at_a_time
    def __getstate__(self) -> Any:
        # a copy, made while no other call runs
        return copy.deepcopy(super().__getstate__())

    def __setstate__(self, state: tuple[None, dict[str, Any]]) -> None:
        for name, value in state[1].items():
            setattr(self, name, value)
        # this prepares kernels, as this process has perhaps compiled nothing yet
        self._choose_ways()
