"""Slow twins: the classifier in NumPy, bit for bit, and the decisions of a Processor by a plain loop.

The classifier spells out each operation, rounded once. Nothing of the product is used here but the order of its
sums, which is part of what it promises:

    convolution 1   bias, then channel by channel the nine taps      fma
    convolution 2   bias, then tap by tap the channels               fma
    pooling         0 + the four places, row by row; times 1/4
    dense 1         what each place adds, filter by filter (fma); sums of a row's places; sums of rows; + bias
    dense 2         bias, then unit by unit, product and sum rounded each
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from async_tnt import Decision, TNTVolume


def fma(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """a b + c in float32 with one rounding.

    The product of two float32 is exact in float64. The sum is rounded there to odd: where it is not exact, the last
    bit is made 1, which keeps what is left out in view of the second rounding (Boldo and Melquiond 2008).
    """
    product = np.float64(a) * np.float64(b)
    c = np.float64(c)
    total = product + c
    rest = total - product
    error = (product - (total - rest)) + (c - rest)  # exactly what the sum lacks (Knuth's two-sum)
    even = total.view(np.int64) & 1 == 0
    odd = np.where((error != 0) & even, np.nextafter(total, np.where(error > 0, np.inf, -np.inf)), total)
    return odd.astype(np.float32)


def relu(x: np.ndarray) -> np.ndarray:
    return np.where(x < 0, np.float32(0), x)


def pool(x: np.ndarray) -> np.ndarray:
    """(H, W, F) -> (H // 2, W // 2, F)."""
    rows, columns = x.shape[0] // 2, x.shape[1] // 2
    total = np.zeros((rows, columns, x.shape[2]), np.float32)
    for r, q in np.ndindex(2, 2):
        total = total + x[r : 2 * rows : 2, q : 2 * columns : 2]
    return total * np.float32(0.25)


def convolve(x: np.ndarray, weights: np.ndarray, bias: np.ndarray, channels_first: bool) -> np.ndarray:
    """(H, W, C), (F, C, 3, 3) -> (H, W, F), zeros around."""
    height, width, n_channels = x.shape
    framed = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    total = np.broadcast_to(bias, (height, width, len(bias)))
    order = np.ndindex(n_channels, 3, 3) if channels_first else ((c, i, j) for i, j, c in np.ndindex(3, 3, n_channels))
    for c, i, j in order:
        total = fma(weights[:, c, i, j], framed[i : i + height, j : j + width, c, None], total)
    return total


def forward(weights: Mapping[str, np.ndarray], volume: np.ndarray) -> np.ndarray:
    """(C, H, W) -> logits (K,)."""
    x = np.ascontiguousarray(volume.transpose(1, 2, 0))
    x = pool(relu(convolve(x, weights["conv1.weight"], weights["conv1.bias"], channels_first=True)))
    x = pool(relu(convolve(x, weights["conv2.weight"], weights["conv2.bias"], channels_first=False)))
    rows, columns, n_filters = x.shape
    dense = weights["fc1.weight"].reshape(-1, n_filters, rows, columns)  # torch flattens (F, H, W)
    hidden = np.zeros(len(dense), np.float32)
    for row in range(rows):
        row_sum = np.zeros(len(dense), np.float32)
        for column in range(columns):
            partial = np.zeros(len(dense), np.float32)
            for f in range(n_filters):
                partial = fma(x[row, column, f], dense[:, f, row, column], partial)
            row_sum = row_sum + partial
        hidden = hidden + row_sum
    hidden = relu(hidden + weights["fc1.bias"])
    logits = weights["fc2.bias"].copy()
    for j, value in enumerate(hidden):
        logits = logits + value * weights["fc2.weight"][:, j]
    return logits


class Near(tuple):
    """Probabilities that are equal up to the last bits of exp(), which differ between machines."""

    __hash__ = tuple.__hash__

    def __eq__(self, other: object) -> bool:
        return len(self) == len(other) and all(
            math.isclose(a, b, rel_tol=1e-13, abs_tol=1e-300) for a, b in zip(self, other, strict=True)
        )


Row = tuple[str, int, int, int, bool, bytes, Near]


def row(decision: Decision) -> Row:
    """All fields of a decision, comparable; the logits by their bits."""
    values = decision.trigger, decision.window_start_us, decision.time_us, decision.events, decision.complete
    return *values, decision.logits.tobytes(), Near(decision.probabilities.tolist())


def decisions_one_by_one(
    events: np.ndarray, volume: TNTVolume, network: Callable[[np.ndarray], np.ndarray], every: int
) -> list[Row]:
    """What a Processor with `every_events` decides: windows end to end from the first event, a decision after every
    so many of a window's events, one event at a time and the whole network each time."""
    rows = []

    def decide(trigger: str, complete: bool = False) -> None:
        logits = network(volume.array)
        values = trigger, volume.start_us, volume.newest_us, volume.n_events, complete
        rows.append((*values, logits.tobytes(), softmax(logits.tolist())))

    for event in events.tolist():
        n_before = volume.n_events
        if n_before and event[0] >= volume.start_us + volume.config.window_us:
            decide("window", complete=True)
            n_before = 0
        volume.update_one(*event)
        if volume.n_events > n_before and volume.n_events % every == 0:
            decide("every_events")
    if volume.n_events:
        decide("end")
    return rows


def softmax(logits: list[float]) -> Near:
    exps = [math.exp(value - max(logits)) for value in logits]
    return Near(value / math.fsum(exps) for value in exps)
