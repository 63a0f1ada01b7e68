"""The windows and triggers of a Processor in plain Python: integers, floats, lists, one event at a time.

Written from the docstrings, not from the code: time passes to an event's time first, moment by moment, and windows
close and open on the way; then the event is added to every open window that holds it, and the triggers that see
events are asked. The oldest open window is the one that decides.

What a window shows is kept in a TNTVolume of its own, opened by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from async_tnt import LeakyIntegrator, TNTConfig, TNTVolume

Values = tuple[str, int, int, int, bool, bytes]


class Window:
    """An open window."""

    def __init__(self, config: TNTConfig, start_us: int) -> None:
        self.start_us, self.end_us = start_us, start_us + config.window_us
        self.volume = TNTVolume(config)
        self.volume.open(start_us)
        self.times: list[int] = []


class Oracle:
    """See `Processor` for the settings, which may be changed at any time by `change`."""

    def __init__(
        self,
        config: TNTConfig,
        classify: Callable[[np.ndarray], np.ndarray],
        *,
        hop_us: int | None = None,
        start_us: int | None = None,
        late: str = "accept",
        **triggers: object,
    ) -> None:
        self.config, self.classify, self.late = config, classify, late
        self.hop_us = hop_us or config.window_us
        self.windows: list[Window] = []
        self.next_start_us = start_us
        self.decided: set[int] = set()  # starts of windows that confidence closed
        self.newest_us = -1  # of all events, for `late`
        self.potential, self.charged_us = 0.0, 0
        self.n_decided = 0  # events of the oldest window at its last decision
        self.passed_us = 0  # moments up to this one are over
        self.received = self.dropped_late = self.dropped_decided = 0
        self.close_calls = 0  # potentials so near the threshold that exp's last bit decides
        self.every_us: int | None = None
        self.every_events: int | None = None
        self.confidence: float | None = None
        self.activity: LeakyIntegrator | None = None
        self.change(**triggers)
        if start_us is not None:
            self._open_windows(start_us)

    def change(self, **triggers: object) -> None:
        """Another activity begins as on a new stream: no potential, and none charged before."""
        if triggers.get("activity", self.activity) != self.activity:
            self.potential, self.charged_us = 0.0, 0
        vars(self).update(triggers)

    def push(self, event: tuple[int, int, int, int]) -> list[Values]:
        t_us = event[0]
        self.received += 1
        if self.late != "accept":
            if t_us < self.newest_us:
                self.dropped_late += 1
                return []
            self.newest_us = t_us
        decisions = self._pass_time(t_us) if self.windows else []
        self._open_windows(t_us)
        oldest = self.windows[0]
        if t_us < oldest.start_us:
            newest_us = oldest.start_us - -(-(oldest.start_us - t_us) // self.hop_us) * self.hop_us  # that holds it
            decided = newest_us in self.decided
            self.dropped_decided += decided
            self.dropped_late += not decided
            return decisions
        for window in self.windows:
            if window.start_us <= t_us:
                window.volume.update_one(*event)
                window.times.append(t_us)
        trigger = "activity" if self._charge(t_us) else ""
        if self.every_events is not None and len(oldest.times) % self.every_events == 0:
            trigger = "every_events"
        only_confidence = self.confidence is not None and not (self.every_us or self.every_events or self.activity)
        if trigger or only_confidence:
            decisions += self._decide(oldest, trigger, now_us=max(oldest.times))
        return decisions

    def finish(self) -> list[Values]:
        decisions = [self._decision(window, "end")[0] for window in self.windows if window.times]
        self.windows = []
        return decisions

    def _pass_time(self, t_us: int) -> list[Values]:
        """What is due at moments up to `t_us`."""
        decisions: list[Values] = []
        while self.windows:
            oldest = self.windows[0]
            moment_us = self._next_moment_us(oldest)
            if moment_us <= t_us and moment_us < oldest.end_us:
                self.passed_us = moment_us
                if len(oldest.times) > self.n_decided:
                    decisions += self._decide(oldest, "every_us", now_us=t_us)
            elif oldest.end_us <= t_us:
                if oldest.times:
                    decisions.append(self._decision(oldest, "window", complete=True)[0])
                self._close(decided=False, now_us=oldest.end_us)
            else:
                break
        return decisions

    def _next_moment_us(self, window: Window) -> float:
        """The next multiple of `every_us` from the window's start on that is not over."""
        if self.every_us is None:
            return math.inf
        passed_us = max(self.passed_us, window.start_us, *window.times)
        return window.start_us + ((passed_us - window.start_us) // self.every_us + 1) * self.every_us

    def _open_windows(self, t_us: int) -> None:
        """Those on the grid that hold `t_us`; where none is open, the next one, though it may begin later."""
        if self.next_start_us is None:
            self.next_start_us = t_us
        while self.next_start_us + self.config.window_us <= t_us:
            gap = (t_us - self.config.window_us - self.next_start_us) // self.hop_us
            self.next_start_us += max(gap, 1) * self.hop_us
        while self.next_start_us <= t_us or not self.windows:
            if not self.windows:
                self.n_decided, self.passed_us = 0, max(t_us, self.next_start_us)
            self.windows.append(Window(self.config, self.next_start_us))
            self.next_start_us += self.hop_us

    def _close(self, decided: bool, now_us: int) -> None:
        """Close the oldest window; the next one decides from now on."""
        oldest = self.windows.pop(0)
        if decided:
            self.decided.add(oldest.start_us)
        self.n_decided, self.passed_us = 0, now_us

    def _charge(self, t_us: int) -> bool:
        """v <- v exp(-dt / leak_us) + charge; True, and zero again, where it reaches the threshold."""
        if self.activity is None:
            return False
        if t_us > self.charged_us:
            self.potential *= math.exp(-(t_us - self.charged_us) / self.activity.leak_us)
            self.charged_us = t_us
        self.potential += self.activity.charge
        difference = self.potential - self.activity.threshold
        self.close_calls += 0 < abs(difference) < 1e-12
        if difference < 0:
            return False
        self.potential = 0.0
        return True

    def _decide(self, oldest: Window, trigger: str, now_us: int) -> list[Values]:
        """A decision of the oldest window, which may close it."""
        decision, probability = self._decision(oldest, trigger)
        if self.confidence is not None:
            self.close_calls += 0 < abs(probability - self.confidence) < 1e-12
            if probability >= self.confidence:
                self._close(decided=True, now_us=now_us)
                return [("confidence", *decision[1:4], True, decision[5])]
        if not trigger:
            return []
        self.n_decided = len(oldest.times)
        return [decision]

    def _decision(self, window: Window, trigger: str, complete: bool = False) -> tuple[Values, float]:
        logits = np.asarray(self.classify(window.volume.array), np.float32)
        probability = 1 / math.fsum(math.exp(float(v) - float(max(logits))) for v in logits)
        newest_us, n = max(window.times), len(window.times)
        return (trigger, window.start_us, newest_us, n, complete, logits.tobytes()), probability


def as_values(decision) -> Values:
    """A Processor's decision in the oracle's form."""
    return (
        decision.trigger,
        decision.window_start_us,
        decision.time_us,
        decision.events,
        decision.complete,
        decision.logits.tobytes(),
    )
