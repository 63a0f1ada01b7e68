"""Decision: the classification of a window at one moment; Counts: what became of the events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any, Literal

import numpy as np

Trigger = Literal["window", "every_us", "every_events", "activity", "confidence", "fire", "end"]
LONGEST_TEXT = 300  # of a cell in a notebook, such as a list of names


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
    """Whether the window is closed: this is its last decision."""
    trigger: Trigger
    """What caused it: `window` (which closed), `every_us`, `every_events`, `activity`, `confidence` (which closed the
    window), `fire` (on demand), `end` (of the stream)."""

    @property
    def probability(self) -> float:
        """Probability of the likeliest class."""
        return float(self.probabilities[self.index])

    def _repr_html_(self) -> str:
        rows: dict[str, str | float] = {self.label: self.probability}
        rows["time"] = f"{self.time_us / 1e3:,.3f} ms, window from {self.window_start_us / 1e3:,.3f} ms on"
        return html_table(rows | {"events": f"{self.events:,}", "trigger": self.trigger})

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


def html_table(rows: Mapping[str, str | float]) -> str:
    """What notebooks show of an object: a row for each name, with its text as it is or a bar for a number in [0, 1]."""
    cells = [f"<tr><th>{escape(name[:LONGEST_TEXT])}</th><td>{_cell(value)}</td></tr>" for name, value in rows.items()]
    return f"<table>{''.join(cells)}</table>"


def _cell(value: str | float) -> str:
    if isinstance(value, float):
        return f'<meter value="{value:.4f}"></meter> {value:.1%}'
    return escape(value[:LONGEST_TEXT])
