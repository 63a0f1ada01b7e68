"""When a processor decides, apart from the end of each window: settings, checked, and as the kernels read them."""

from __future__ import annotations

import math
from dataclasses import dataclass
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


class Triggers:
    """The triggers of one processor: their settings, and what they remember of the stream.

    Attributes
    ----------
    next_due_us : next moment of `every_us` in the oldest window.
    n_decided : events of the oldest window at its last triggered decision.
    """

    def __init__(self) -> None:
        self.every_us: int | None = None
        self.every_events: int | None = None
        self.confidence: float | None = None
        self.activity: LeakyIntegrator | None = None
        self.state = np.zeros(T.SIZE)
        self._ints = self.state.view(np.int64)
        self.set()
        self.forget()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._ints = self.state.view(np.int64)  # a view again, and not a copy

    def set(self, **settings: Any) -> None:
        """Change some of `every_us`, `every_events`, `confidence`, `activity`; None switches one off.

        Raises
        ------
        ValueError, TypeError : an invalid value. Nothing changes then.
        """
        for name, value in settings.items():
            settings[name] = None if value is None else _CHECKS[name](name, value)
        restarts = settings.get("activity", self.activity) != self.activity
        vars(self).update(settings)
        self.state[T.CONFIDENCE] = math.inf if self.confidence is None else self.confidence
        activity = self.activity
        self.state[T.THRESHOLD] = math.inf if activity is None else activity.threshold
        if activity is not None:
            self.state[T.LEAK_US], self.state[T.CHARGE] = activity.leak_us, activity.charge
        self._ints[T.EVERY_EVENTS] = self.every_events or 0
        others = (self.every_us, self.every_events, self.activity)
        self._ints[T.EACH_EVENT] = self.confidence is not None and others == (None, None, None)
        if restarts:
            self._discharge()

    def forget(self) -> None:
        """Forget the stream: no window, no potential."""
        self.next_due_us = NEVER_US
        self.n_decided = 0
        self._discharge()

    def _discharge(self) -> None:
        self.state[T.POTENTIAL] = 0.0
        self._ints[T.CHARGED_US] = 0

    def schedule(self, now_us: int, start_us: int) -> None:
        """Set the next moment of `every_us`: the first after `now_us` in a window that starts at `start_us`."""
        self.next_due_us = NEVER_US
        if self.every_us is not None:
            due_us = start_us + ((now_us - start_us) // self.every_us + 1) * self.every_us
            self.next_due_us = min(due_us, NEVER_US)

    @property
    def by_event(self) -> bool:
        """Whether a single event may make a decision due."""
        return bool(self._ints[T.EVERY_EVENTS] or self._ints[T.EACH_EVENT] or self.activity is not None)


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
