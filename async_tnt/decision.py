"""Decision: what the classifier says about a window at one moment; Counts: what became of the events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)  # arrays have no truth value to compare by
class Decision:
    """What the classifier says about a window at one moment."""

    label: str
    """Name of the likeliest class."""
    index: int
    """Its number."""
    probabilities: np.ndarray
    """float64, shape (n_classes,): softmax of the logits."""
    logits: np.ndarray
    """float32, shape (n_classes,)."""
    window_start_us: int
    time_us: int
    """Newest event in the window; the window's start if it has none."""
    events: int
    """Events in the window so far."""
    complete: bool
    """Whether the window is closed, so that this is its last decision."""
    trigger: str
    """Why it fired: `window` (closed), `every_us`, `every_events`, `activity`, `confidence` (and closed the window),
    `fire` (on demand), `end` (of the stream)."""

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

    Every event received is kept or in exactly one of the dropped ones (where windows do not overlap):
    received = kept + dropped_outside + dropped_tau_zero + dropped_late + dropped_unstored + dropped_decided.
    """

    received: int = 0
    kept: int = 0
    dropped_outside: int = 0
    """The transform put it outside the grid."""
    dropped_tau_zero: int = 0
    """At the very start of its window, where TNT time is zero."""
    dropped_late: int = 0
    """Before the start of every open window and not `dropped_decided`, or late under late="drop"."""
    dropped_unstored: int = 0
    """The replay buffer of landmark "window" or "regressor" was full."""
    dropped_decided: int = 0
    """Late, and the newest window that holds it had been closed early by `confidence`. Remembered are the 1024 windows
    before the oldest open one; what is older than those counts as `dropped_late`."""

    @property
    def moved_off(self) -> int:
        """Events that the transform has no place for: they are part of what it does, and no loss."""
        return self.dropped_outside + self.dropped_tau_zero

    @property
    def lost(self) -> int:
        """Events that a window should have had, or has no more use for: all others that were dropped."""
        return self.received - self.kept - self.moved_off

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(getattr(self, f) + getattr(other, f) for f in self.__dataclass_fields__))
