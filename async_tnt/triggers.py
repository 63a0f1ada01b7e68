"""When a processor decides, apart from the end of each window: settings, checked, and as the kernels read them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.checks import positive_int, real_number, short
from async_tnt.kernels import trigger as T
from async_tnt.kernels.state import NEVER_US


@dataclass(frozen=True)
class LeakyIntegrator:
    """A leaky integrate-and-fire trigger: it fires when much happens in little time.

    Each event of the window adds `charge` to a potential that leaks away with time. Where the potential reaches
    `threshold`, the trigger fires and the potential returns to zero:

        v <- v exp(-dt / leak_us) + charge

    Events dt apart bring it to charge / (1 - exp(-dt / leak_us)), about charge (leak_us / dt + 1/2). They never fire if
    that is below the threshold; above it, the denser, the more often. Irregular ones of the same rate may fire below.

    Parameters
    ----------
    threshold : the potential at which it fires.
    leak_us : time constant in microseconds; math.inf for no leak, which is `every_events` across windows.
    charge : what each event adds.
    """

    threshold: float
    leak_us: float
    charge: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            number = real_number(name, value)
            if not number > 0 or (number == math.inf and name != "leak_us"):
                raise ValueError(f"`{name}` must be a positive number, got {short(value)}")
            object.__setattr__(self, name, number)


@dataclass(frozen=True)
class TriggerSettings:
    """When a processor decides apart from the end of each window, see `Processor`; None switches a trigger off.

    Raises
    ------
    ValueError, TypeError : an invalid value; the message names its rule.
    """

    every_us: int | None = None
    every_events: int | None = None
    confidence: float | None = None
    activity: LeakyIntegrator | None = None

    def __post_init__(self) -> None:
        for name, check in _CHECKS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, check(name, value))

    @property
    def by_event(self) -> bool:
        """Whether a single event may make a decision due."""
        return self.every_events is not None or self.activity is not None or self.each_event

    @property
    def each_event(self) -> bool:
        """Whether `confidence` is checked after every event, as no other trigger is set."""
        others = (self.every_us, self.every_events, self.activity)
        return self.confidence is not None and others == (None, None, None)


class Triggers:
    """The triggers of one processor: their settings, and what they remember of the stream.

    Attributes
    ----------
    settings : TriggerSettings.
    state : float64, the settings and what changes as kernels read them, see `kernels.trigger`.
    """

    def __init__(self, settings: TriggerSettings) -> None:
        self.state = np.zeros(T.SIZE)
        self._ints = self.state.view(np.int64)
        self.settings = settings
        self.set(settings)
        self.forget()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._ints = self.state.view(np.int64)  # a view again, and not a copy

    def set(self, settings: TriggerSettings) -> None:
        """Use these settings from now on; the potential stays where `activity` does not change."""
        restarts = settings.activity != self.settings.activity
        self.settings = settings
        activity = settings.activity
        self.state[T.CONFIDENCE] = math.inf if settings.confidence is None else settings.confidence
        self.state[T.THRESHOLD] = math.inf if activity is None else activity.threshold
        if activity is not None:
            self.state[T.LEAK_US], self.state[T.CHARGE] = activity.leak_us, activity.charge
        self._ints[T.EVERY_EVENTS] = settings.every_events or 0
        self._ints[T.EACH_EVENT] = settings.each_event
        self._ints[T.EVERY_US] = settings.every_us or 0
        if restarts:
            self._discharge()

    def forget(self) -> None:
        """Forget the stream: no window, no potential."""
        self.begin_window(0, None)
        self._discharge()

    def _discharge(self) -> None:
        self.state[T.POTENTIAL] = 0.0
        self._ints[T.CHARGED_US] = 0

    def begin_window(self, now_us: int, start_us: int | None) -> None:
        """The window that starts at `start_us` has become the oldest one; None: no window is open."""
        self.n_at_decision = 0
        self._ints[T.DUE_US] = NEVER_US
        if start_us is not None:
            self.schedule(now_us, start_us)

    def schedule(self, now_us: int, start_us: int) -> None:
        """See `kernels.trigger.schedule`."""
        T.schedule(self.state, now_us, start_us)

    @property
    def next_due_us(self) -> int:
        """Next moment of `every_us` in the oldest window."""
        return int(self._ints[T.DUE_US])

    @property
    def n_at_decision(self) -> int:
        """Events of the oldest window at its last triggered decision."""
        return int(self._ints[T.N_DECIDED])

    @n_at_decision.setter
    def n_at_decision(self, n: int) -> None:
        self._ints[T.N_DECIDED] = n


class TriggerAttributes:
    """The four triggers as attributes of a `Processor`, which may change between calls."""

    __slots__ = ()
    _triggers: Triggers

    def _set_triggers(self, settings: TriggerSettings) -> None:
        """Use these settings, for the open window, too."""
        raise NotImplementedError

    @property
    def every_us(self) -> int | None:
        """Decide also whenever this many microseconds have passed; None: never. May change between calls."""
        return self._triggers.settings.every_us

    @every_us.setter
    def every_us(self, every_us: int | None) -> None:
        self._set_triggers(replace(self._triggers.settings, every_us=every_us))

    @property
    def every_events(self) -> int | None:
        """Decide also after every this many events of the window; None: never. May change between calls."""
        return self._triggers.settings.every_events

    @every_events.setter
    def every_events(self, every_events: int | None) -> None:
        self._set_triggers(replace(self._triggers.settings, every_events=every_events))

    @property
    def confidence(self) -> float | None:
        """Close a window at a decision whose class has this probability; None: never. May change between calls."""
        return self._triggers.settings.confidence

    @confidence.setter
    def confidence(self, confidence: float | None) -> None:
        self._set_triggers(replace(self._triggers.settings, confidence=confidence))

    @property
    def activity(self) -> LeakyIntegrator | None:
        """Decide also when much happens in little time; None: never. May change between calls."""
        return self._triggers.settings.activity

    @activity.setter
    def activity(self, activity: LeakyIntegrator | None) -> None:
        self._set_triggers(replace(self._triggers.settings, activity=activity))


def _level(name: str, value: Any) -> float:
    number = real_number(name, value)
    if not 0 < number <= 1:
        raise ValueError(f"`{name}` must be a probability in (0, 1], got {short(value)}")
    return number


def _integrator(name: str, value: Any) -> LeakyIntegrator:
    if not isinstance(value, LeakyIntegrator):
        raise TypeError(f"`{name}` must be a LeakyIntegrator(threshold, leak_us), got {short(value)}")
    return value


_CHECKS = {"every_us": positive_int, "every_events": positive_int, "confidence": _level, "activity": _integrator}
