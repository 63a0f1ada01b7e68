"""Decision: the classification of a window at one moment; Counts: what became of the events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Trigger = Literal["window", "every_us", "every_events", "activity", "confidence", "fire", "end"]


@dataclass(frozen=True, slots=True, eq=False)  # arrays have no truth value to compare by
class Decision:
    """The classification of a window at one moment."""

    label: str
    """Name of the likeliest class."""
    index: int
    """Number of that class, from 0."""
    probabilities: np.ndarray
    """Softmax of the logits: float64, shape (n_classes,)."""
    logits: np.ndarray
    """What the classifier answered: float32, shape (n_classes,)."""
    window_start_us: int
    """Start of the window, in microseconds."""
    time_us: int
    """Time of the newest event in the window, in microseconds; the window's start if it has none."""
    events: int
    """Events in the window so far."""
    complete: bool
    """Whether this decision closes the window: at its end, or early by `confidence`; not at the end of the stream."""
    trigger: Trigger
    """What caused it: `window` (which closed), `every_us`, `every_events`, `activity`, `confidence` (which closed the
    window), `fire` (on demand), `end` (of the stream)."""

    @property
    def probability(self) -> float:
        """Probability of the likeliest class."""
        return float(self.probabilities[self.index])

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; probabilities to six decimals, no logits."""
        return {
            "time_us": self.time_us,
            "window_start_us": self.window_start_us,
            "label": self.label,
            "probability": round(self.probability, 6),
            "probabilities": [round(float(p), 6) for p in self.probabilities],
            "events": self.events,
            "complete": self.complete,
            "trigger": self.trigger,
        }


@dataclass(frozen=True)
class Counts:
    """What became of the events since the volume was made or reset.

    Where windows do not overlap, every event is counted once, as kept or as dropped for one reason: received =
    kept + dropped_outside + dropped_tau_zero + dropped_late + dropped_unstored + dropped_decided.
    """

    received: int = 0
    """Events in total."""
    kept: int = 0
    """Added to the volume."""
    dropped_outside: int = 0
    """The transform moved it off the grid."""
    dropped_tau_zero: int = 0
    """At the very start of its window, where TNT time is zero."""
    dropped_late: int = 0
    """Older than all open windows and not `dropped_decided`, or late under late="drop"."""
    dropped_unstored: int = 0
    """The replay buffer of landmark "window" or "regressor" was full."""
    dropped_decided: int = 0
    """Late, and all windows from the newest one that holds it up to the oldest open one were closed early by
    `confidence`."""

    @property
    def moved_off(self) -> int:
        """Events that the transform moves off the grid, as it is meant to: they are not lost."""
        return self.dropped_outside + self.dropped_tau_zero

    @property
    def lost(self) -> int:
        """Events dropped for any other reason."""
        return self.dropped_late + self.dropped_unstored + self.dropped_decided

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(getattr(self, f) + getattr(other, f) for f in self.__dataclass_fields__))
