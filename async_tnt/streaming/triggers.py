"""When a processor decides, apart from the end of each window: settings, checked, and as the
kernels read them."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.base.checks import positive_int, real_number, short
from async_tnt.kernels.decisions import trigger as T
from async_tnt.kernels.volume.state import NEVER_US
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class TriggerSettings:
    """When a processor decides apart from the end of each window, see `Processor`; None switches a
    trigger off.

    Raises
    ------
    ValueError, TypeError : an invalid value; the message names its rule.
    """

    every_us: int | None = None
    every_events: int | None = None
    confidence: float | None = None

    def __post_init__(self) -> None:
        for name, check in _CHECKS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, check(name, value))

    @property
    def by_event(self) -> bool:
        """Whether a single event may make a decision due."""
        return self.every_events is not None or self.each_event

    @property
    def each_event(self) -> bool:
        """Whether `confidence` is checked after every event, as no other trigger is set."""
        return self.confidence is not None and self.every_us is None and self.every_events is None


def warn_if_never_due(settings: TriggerSettings, config: TNTConfig, stacklevel: int = 3) -> None:
    """Warn of triggers that no window is long enough for.

    As often as a window's duration, or its number of events, is no mistake: windows themselves are
    decided so often.
    """
    never = []
    if config.window_events is None:
        if settings.every_us is not None and settings.every_us > config.window_us:
            never.append(
                f"`every_us` = {settings.every_us} is longer than a window, {config.window_us} us"
            )
    elif settings.every_events is not None and settings.every_events > config.window_events:
        never.append(
            f"`every_events` = {settings.every_events} is more than a window has, "
            f"{config.window_events}"
        )
    for which in never:
        warnings.warn(
            f"{which}: it never makes a decision due, windows are decided at their ends",
            stacklevel=stacklevel,
        )


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
        self.set(settings)
        self.begin_window(0, None)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._ints = self.state.view(np.int64)  # a view again, and not a copy

    def set(self, settings: TriggerSettings) -> None:
        """Use these settings from now on."""
        self.settings = settings
        self.state[T.CONFIDENCE] = math.inf if settings.confidence is None else settings.confidence
        self._ints[T.EVERY_EVENTS] = settings.every_events or 0
        self._ints[T.EACH_EVENT] = settings.each_event
        self._ints[T.EVERY_US] = settings.every_us or 0

    def begin_window(self, now_us: int, start_us: int | None) -> None:
        """The window that starts at `start_us` has become the oldest one; None: no window is
        open."""
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
        return int(self._ints[T.N_AT_DECISION])

    @n_at_decision.setter
    def n_at_decision(self, n: int) -> None:
        self._ints[T.N_AT_DECISION] = n


class TriggerAttributes:
    """The three triggers as attributes of a `Processor`, which may change between calls."""

    __slots__ = ()
    _triggers: Triggers
    config: TNTConfig

    def _set_triggers(self, settings: TriggerSettings) -> None:
        """Use these settings, for the open window, too."""
        raise NotImplementedError

    def _change(self, **changes: Any) -> None:
        """Use the settings with some of them changed; called by a setter, which is called by the
        user."""
        before = self._triggers.settings
        self._set_triggers(replace(before, **changes))
        if self._triggers.settings != before:
            warn_if_never_due(self._triggers.settings, self.config, stacklevel=4)

    @property
    def every_us(self) -> int | None:
        """Decide also whenever this many microseconds have passed; None: never. May change between
        calls."""
        return self._triggers.settings.every_us

    @every_us.setter
    def every_us(self, every_us: int | None) -> None:
        self._change(every_us=every_us)

    @property
    def every_events(self) -> int | None:
        """Decide also after every this many events of the window; None: never. May change between
        calls."""
        return self._triggers.settings.every_events

    @every_events.setter
    def every_events(self, every_events: int | None) -> None:
        self._change(every_events=every_events)

    @property
    def confidence(self) -> float | None:
        """Close a window at a decision whose class has this probability; None: never. May change
        between calls."""
        return self._triggers.settings.confidence

    @confidence.setter
    def confidence(self, confidence: float | None) -> None:
        self._change(confidence=confidence)


def _level(name: str, value: Any) -> float:
    number = real_number(name, value)
    if not 0 < number <= 1:
        raise ValueError(f"`{name}` must be a probability in (0, 1], got {short(value)}")
    return number


_CHECKS = {"every_us": positive_int, "every_events": positive_int, "confidence": _level}
