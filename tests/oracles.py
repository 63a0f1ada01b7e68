"""Slow twins: the classifier in NumPy, and a Processor's windows and triggers in plain Python.

The classifier's twin is equal bit for bit.

The classifier (`forward`) spells out each operation, rounded once. It uses nothing of the product
except the order of its sums, which is part of what the product promises:

    convolution     bias, then row by row and tap by tap of the kernel the channels
    pooling         0, then row by row each place times 1/4
    dense 1         what each place adds, filter by filter; sums of a row's places; bias, then the
                    rows' sums
    dense 2         bias, then unit by unit

Each term is added with one rounding (fma). At last 0 is added, which makes a -0 of a convolution or
of a part of a dense layer 0.

The windows and triggers (`Oracle`) are integers, floats and lists, one event at a time, written
from the docstrings. Time passes to an event's time first, moment by moment, and windows close and
open on the way. Then the event is added to every open window that holds it, and the triggers that
see events are asked. The oldest open window decides. What a window shows is kept in a TNTVolume of
its own, opened by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from async_tnt import Counts, TNTConfig, TNTVolume


def fma(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """a b + c in float32 with one rounding.

    The product of two float32 is exact in float64. The sum is rounded there to odd: where it is not
    exact, the last bit is made 1, so that the second rounding still sees that something was left
    out (Boldo and Melquiond 2008).
    """
    product = np.float64(a) * np.float64(b)
    c = np.float64(c)
    total = product + c
    rest = total - product
    # exactly what the sum lacks (Knuth's two-sum)
    error = (product - (total - rest)) + (c - rest)
    is_even = total.view(np.int64) & 1 == 0
    neighbour = np.nextafter(total, np.where(error > 0, np.inf, -np.inf))
    odd = np.where((error != 0) & is_even, neighbour, total)
    return odd.astype(np.float32)


def relu(x: np.ndarray) -> np.ndarray:
    return np.where(x < 0, np.float32(0), x)


def pool(x: np.ndarray) -> np.ndarray:
    """(H, W, F) -> (H // 2, W // 2, F)."""
    rows = x.shape[0] // 2
    columns = x.shape[1] // 2
    total = np.zeros((rows, columns, x.shape[2]), np.float32)
    for r, q in np.ndindex(2, 2):
        total = fma(np.float32(0.25), x[r : 2 * rows : 2, q : 2 * columns : 2], total)
    return total


def convolve(x: np.ndarray, weights: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """(H, W, C), (F, C, 3, 3) -> (H, W, F), zeros around."""
    height, width, n_channels = x.shape
    framed = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    total = np.broadcast_to(bias, (height, width, len(bias)))
    for i, j, c in np.ndindex(3, 3, n_channels):
        total = fma(weights[:, c, i, j], framed[i : i + height, j : j + width, c, None], total)
    return total + np.float32(0)


def dense(x: np.ndarray, weights: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """(H, W, F), (U, F * H * W) as torch flattens (F, H, W) -> (U,)."""
    rows, columns, n_filters = x.shape
    weights = weights.reshape(-1, n_filters, rows, columns)
    if rows * columns == 1:
        total = bias
        for f in range(n_filters):
            total = fma(x[0, 0, f], weights[:, f, 0, 0], total)
        return total + np.float32(0)
    partial = np.zeros((rows, columns, len(bias)), np.float32)
    for y, x_, f in np.ndindex(rows, columns, n_filters):
        partial[y, x_] = fma(x[y, x_, f], weights[:, f, y, x_], partial[y, x_])
    partial = partial + np.float32(0)
    sums = partial[0] if rows == 1 else partial[:, 0]
    if rows > 1:
        for column in range(1, columns):
            sums = sums + partial[:, column]
    total = bias
    for part in sums:
        total = total + part
    return total


def forward(weights: Mapping[str, np.ndarray], volume: np.ndarray) -> np.ndarray:
    """The thesis' network: (C, H, W) -> logits (K,)."""
    x = np.ascontiguousarray(volume.transpose(1, 2, 0))
    x = pool(relu(convolve(x, weights["conv1.weight"], weights["conv1.bias"])))
    x = pool(relu(convolve(x, weights["conv2.weight"], weights["conv2.bias"])))
    hidden = relu(dense(x, weights["fc1.weight"], weights["fc1.bias"]))
    return dense(hidden[None, None], weights["fc2.weight"], weights["fc2.bias"])


Values = tuple[str, int, int, int, bool, bytes]


class Window:
    """An open window."""

    def __init__(self, config: TNTConfig, start_us: int, regressor: Callable | None) -> None:
        self.start_us = start_us
        self.end_us = start_us + config.window_us
        self.volume = TNTVolume(config, regressor=regressor)
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
        regressor: Callable | None = None,
        **triggers: object,
    ) -> None:
        self.config = config
        self.classify = classify
        self.late = late
        self.regressor = regressor
        self.hop_us = hop_us or config.window_us
        self.windows: list[Window] = []
        self.next_start_us = start_us
        # start of the last windows in a row that confidence closed
        self.decided_from_us = math.inf
        # newest time of all events, for `late`
        self.newest_us = -1
        # events of the oldest window at its last decision
        self.n_decided = 0
        # moments up to this one are over
        self.passed_us = 0
        # probabilities so near the level that exp's last bit decides
        self.close_calls = 0
        self.received = 0
        self.dropped_late = 0
        self.dropped_decided = 0
        # what became of the events of each window that is no longer open
        self.closed: list[Counts] = []
        self.every_us: int | None = None
        self.every_events: int | None = None
        self.confidence: float | None = None
        self.change(**triggers)
        if start_us is not None:
            self._open_windows(start_us)

    def change(self, **triggers: object) -> None:
        vars(self).update(triggers)

    def push(self, event: tuple[int, int, int, int]) -> list[Values]:
        """The decisions that one event makes."""
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
            if t_us >= self.decided_from_us:
                self.dropped_decided += 1
            else:
                self.dropped_late += 1
            return decisions

        for window in self.windows:
            if window.start_us <= t_us:
                window.volume.update_one(*event)
                window.times.append(t_us)

        n = len(oldest.times)
        newest_us = max(oldest.times)
        by_events = self.every_events is not None and n % self.every_events == 0
        only_confidence = self.confidence is not None and not (self.every_us or self.every_events)
        if n == self.config.window_events:
            decisions.append(self._decision(oldest, "window", complete=True)[0])
            self._close(decided=False, now_us=newest_us)
        elif by_events:
            decisions += self._decide(oldest, "every_events", now_us=newest_us)
        elif only_confidence:
            decisions += self._decide(oldest, "", now_us=newest_us)
        return decisions

    def push_all(self, events: np.ndarray) -> list[Values]:
        return [decision for event in events.tolist() for decision in self.push(event)]

    def finish(self) -> list[Values]:
        decisions = [self._decision(window, "end")[0] for window in self.windows if window.times]
        self.closed += [window.volume.counts for window in self.windows]
        if self.windows and not self.config.window_events:
            self.decided_from_us = math.inf
        self.windows = []
        return decisions

    @property
    def counts(self) -> Counts:
        """What became of the events, see `Processor.counts`."""
        of_windows = [*self.closed, *(window.volume.counts for window in self.windows)]
        return Counts(
            received=self.received,
            kept=sum(counts.kept for counts in of_windows),
            dropped_outside=sum(counts.dropped_outside for counts in of_windows),
            dropped_tau_zero=sum(counts.dropped_tau_zero for counts in of_windows),
            dropped_late=self.dropped_late,
            dropped_decided=self.dropped_decided,
        )

    def _pass_time(self, t_us: int) -> list[Values]:
        """The decisions that are due at moments up to `t_us`."""
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
        n_passed = (passed_us - window.start_us) // self.every_us
        return window.start_us + (n_passed + 1) * self.every_us

    def _open_windows(self, t_us: int) -> None:
        """Open the windows on the grid that hold `t_us`; if none is open then, the next one.

        That one may begin later.
        """
        if self.next_start_us is None:
            self.next_start_us = t_us
        while self.next_start_us + self.config.window_us <= t_us:
            gap = (t_us - self.config.window_us - self.next_start_us) // self.hop_us
            self.next_start_us += max(gap, 1) * self.hop_us
            self.decided_from_us = math.inf
        while self.next_start_us <= t_us or not self.windows:
            if not self.windows:
                self.n_decided = 0
                self.passed_us = max(t_us, self.next_start_us)
            self.windows.append(Window(self.config, self.next_start_us, self.regressor))
            self.next_start_us += self.hop_us

    def _close(self, decided: bool, now_us: int) -> None:
        """Close the oldest window; the next one decides from now on."""
        oldest = self.windows.pop(0)
        self.closed.append(oldest.volume.counts)
        if self.config.window_events:
            self.next_start_us = None  # at the next event
        elif decided:
            self.decided_from_us = min(self.decided_from_us, oldest.start_us)
        else:
            self.decided_from_us = math.inf
        self.n_decided = 0
        self.passed_us = now_us

    def _decide(self, oldest: Window, trigger: str, now_us: int) -> list[Values]:
        """A decision of the oldest window, which may close it."""
        decision, probability = self._decision(oldest, trigger)
        if self.confidence is not None:
            if 0 < abs(probability - self.confidence) < 1e-12:
                self.close_calls += 1
            if probability >= self.confidence:
                self._close(decided=True, now_us=now_us)
                return [("confidence", *decision[1:4], True, decision[5])]
        if not trigger:
            return []
        self.n_decided = len(oldest.times)
        return [decision]

    def _decision(
        self, window: Window, trigger: str, complete: bool = False
    ) -> tuple[Values, float]:
        logits = np.asarray(self.classify(window.volume.array), np.float32)
        probability = 1 / math.fsum(math.exp(float(v) - float(max(logits))) for v in logits)
        newest_us = max(window.times)
        n = len(window.times)
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
