"""Decision: what the classifier says of one window at one moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)  # arrays have no truth value to compare by
class Decision:
    """What the classifier says of one window at one moment."""

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
    """Whether the window is closed: nothing more will be said of it."""
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
