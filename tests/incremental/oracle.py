"""What a processor with `every_events` decides, by a plain loop: one event at a time, the whole network each time.

No Processor, no packets, no compiled triggers: a TNTVolume that opens its windows itself, and a function on arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from async_tnt import Decision, TNTVolume


class Near(tuple):
    """Probabilities that are equal up to the last bits of exp(), which are not the same everywhere."""

    __hash__ = tuple.__hash__

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, tuple)
            and len(self) == len(other)
            and all(math.isclose(a, b, rel_tol=1e-13, abs_tol=1e-300) for a, b in zip(self, other, strict=True))
        )


Row = tuple[str, int, int, int, bool, bytes, Near]


def row(decision: Decision) -> Row:
    """All fields of a decision, comparable; the logits by their bits."""
    return (
        decision.trigger,
        decision.window_start_us,
        decision.time_us,
        decision.events,
        decision.complete,
        decision.logits.tobytes(),
        Near(decision.probabilities.tolist()),
    )


def decisions_one_by_one(
    events: np.ndarray, new_volume: Callable[[], TNTVolume], network: Callable[[np.ndarray], np.ndarray], every: int
) -> list[Row]:
    """Windows end to end from the first event; a decision after every so many of a window's events."""
    volume, rows = new_volume(), []

    def decide(trigger: str, complete: bool = False) -> None:
        logits = network(volume.array)
        rows.append(
            (
                trigger,
                volume.start_us,
                volume.newest_us,
                volume.n_events,
                complete,
                logits.tobytes(),
                softmax(logits.tolist()),
            )
        )

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
    largest = max(logits)
    exps = [math.exp(value - largest) for value in logits]
    total = math.fsum(exps)
    return Near(value / total for value in exps)
