"""The triggers of a processor: when it decides before the end of a window.

This module has their settings, and their state in the kernels.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError, ParameterWarning, positive_int, real_number
from async_tnt.base.messages import short
from async_tnt.kernels.decisions import trigger as T
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.volume.state import NEVER_US
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class TriggerSettings:
    """The settings of `Processor` that make it decide before the end of a window.

    None switches a trigger off.

    Raises
    ------
    ParameterValueError, ParameterTypeError : the value of a setting is invalid.
    """

    every_us: int | None = None
    every_events: int | None = None
    confidence: float | None = None

    def __post_init__(self) -> None:
        for name, value in self._set_values().items():
            # The dataclass is frozen, so a plain assignment is refused.
            object.__setattr__(self, name, _CHECKS[name](name, value))

    def _set_values(self) -> dict[str, Any]:
        """Name -> value of each trigger that is set."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def by_event(self) -> bool:
        """Whether a single event may make a decision due."""
        return self.every_events is not None or self.each_event

    @property
    def each_event(self) -> bool:
        """Whether `confidence` is checked after every event, because no other trigger is set."""
        return self._set_values().keys() == {"confidence"}


def warn_if_never_due(settings: TriggerSettings, config: TNTConfig, stacklevel: int = 3) -> None:
    """Warn of a trigger that never fires, because no window is long enough for it.

    An `every_us` that equals the window's duration is no mistake: a decision is made at the end of
    each window. The same holds for an `every_events` that equals the number of a window's events.
    """
    window_us = config.window_us
    window_events = config.window_events
    every_us = settings.every_us
    every_events = settings.every_events

    if config.slides:  # its window never ends before a decision is due
        return
    if every_us is not None and every_us > window_us:
        name = "every_us"
        problem = f"= {every_us} is longer than a window, {window_us} us"
    elif window_events is not None and every_events is not None and every_events > window_events:
        name = "every_events"
        problem = f"= {every_events} is more than a window has, {window_events}"
    else:
        return
    rule = f"{problem}: it never makes a decision due, windows are decided at their ends"
    warnings.warn(ParameterWarning(name, rule), stacklevel=stacklevel)


def once_in_its_length(config: TNTConfig) -> dict[str, Any]:
    """Settings with which a window that slides decides once in its length.

    Such a window has no end at which to decide. For other windows both settings are None.
    """
    return {"every_us": config.last_us, "every_events": config.last_events}


class Triggers:
    """The triggers of one processor: their settings, and what they remember of the stream.

    Attributes
    ----------
    settings : TriggerSettings.
    state : float64, the settings and what the triggers remember, as kernels read them, see
        `kernels.decisions.trigger`.
    """

    def __init__(self, settings: TriggerSettings) -> None:
        self.state = np.zeros(T.SIZE)
        self._ints = self.state.view(np.int64)
        self.set(settings)
        self.begin_window(0, None)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._ints = self.state.view(np.int64)  # a view of the new state, not of the old one
        self._prepare()  # perhaps in another process

    def _prepare(self) -> None:
        """Compile the kernels, so that no event waits for that."""
        prepare(T.schedule)
        if self.settings.by_event:
            prepare(T.until_due, T.why_due)

    def set(self, settings: TriggerSettings) -> None:
        """Use these settings from now on."""
        self.settings = settings
        self.state[T.CONFIDENCE] = math.inf if settings.confidence is None else settings.confidence
        self._ints[T.EVERY_EVENTS] = settings.every_events or 0
        self._ints[T.EACH_EVENT] = settings.each_event
        self._ints[T.EVERY_US] = settings.every_us or 0
        self._prepare()

    def forget(self) -> None:
        """Forget the class of the last decision by `confidence`, in a window that slides."""
        self._ints[T.SURE_CLASS] = -1

    def is_sure(self, index: int, probability: float, slides: bool) -> bool:
        """Whether a decision for class `index` is one by `confidence`.

        In a window that slides, the class must be another one than at the last such decision, and
        is remembered. `kernels.decisions.trigger.is_sure` is the same rule.
        """
        if probability < self.state[T.CONFIDENCE]:
            return False
        if slides:
            if self._ints[T.SURE_CLASS] == index:
                return False
            self._ints[T.SURE_CLASS] = index
        return True

    def begin_window(self, now_us: int, start_us: int | None) -> None:
        """Begin again for the oldest open window.

        start_us : where the window starts; None if no window is open.
        """
        self.n_at_decision = 0
        self.forget()
        self._ints[T.DUE_US] = NEVER_US
        if start_us is not None:
            self.schedule(now_us, start_us)

    def schedule(self, now_us: int, start_us: int) -> None:
        """Set the next moment of `every_us` after `now_us`, in the window from `start_us` on."""
        T.schedule.call(self.state, now_us, start_us)

    @property
    def next_due_us(self) -> int:
        """Next moment of `every_us` in the oldest window."""
        return int(self._ints[T.DUE_US])

    @property
    def n_at_decision(self) -> int:
        """Events of the oldest window at its last triggered decision."""
        return int(self._ints[T.N_AT_DECISION])

    @n_at_decision.setter
    def n_at_decision(self, n: int) -> None:
        self._ints[T.N_AT_DECISION] = n


class TriggerAttributes:
    """The triggers as attributes of a `Processor`, which may change between calls."""

    # `Processor` has slots, too
    __slots__ = ()
    _triggers: Triggers
    config: TNTConfig

    def _set_triggers(self, settings: TriggerSettings) -> None:
        """Use these settings, for the open window, too."""
        raise NotImplementedError

    def _change(self, **changes: Any) -> None:
        """Use the settings with some of them changed."""
        before = self._triggers.settings
        self._set_triggers(replace(before, **changes))
        if self._triggers.settings != before:
            # The level that names the user's line: 1 is `warn_if_never_due`, 2 this method, 3 the
            # setter, 4 the user.
            warn_if_never_due(self._triggers.settings, self.config, stacklevel=4)

    @property
    def every_us(self) -> int | None:
        """Decide also whenever this many microseconds have passed; None: never.

        May change between calls.
        """
        return self._triggers.settings.every_us

    @every_us.setter
    def every_us(self, every_us: int | None) -> None:
        self._change(every_us=every_us)

    @property
    def every_events(self) -> int | None:
        """Decide also whenever this many more events of the window have arrived; None: never.

        May change between calls.
        """
        return self._triggers.settings.every_events

    @every_events.setter
    def every_events(self, every_events: int | None) -> None:
        self._change(every_events=every_events)

    @property
    def confidence(self) -> float | None:
        """Close a window at a decision whose likeliest class has this probability; None: never.

        A window that slides is not closed: see `Processor`. May change between calls.
        """
        return self._triggers.settings.confidence

    @confidence.setter
    def confidence(self, confidence: float | None) -> None:
        self._change(confidence=confidence)


def _probability(name: str, value: Any) -> float:
    number = real_number(name, value)
    if not 0 < number <= 1:
        raise ParameterValueError(name, "must be a probability in (0, 1]", short(value))
    return number


_CHECKS = {
    "every_us": positive_int,
    "every_events": positive_int,
    "confidence": _probability,
}
"""Name of a trigger -> check(name, value), which returns the value as it is kept."""
