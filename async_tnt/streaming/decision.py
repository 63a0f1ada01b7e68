"""Decision: what a window shows at one moment; Object: what stands where; Counts: what became of
the events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Trigger = Literal["window", "every_us", "every_events", "confidence", "fire", "end"]


@dataclass(frozen=True, slots=True)
class Object:
    """Something that a map model has found."""

    label: str
    """Name of its likeliest class."""
    index: int
    """Number of that class, from 0."""
    probability: float
    """Of that class, at this place."""
    x: float
    """Where it stands, in sensor pixels."""
    y: float
    id: int
    """The same from decision to decision while it moves little. A new object that `fire` finds has
    the number of the next one; the next decision may give it to another."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; probability to six decimals, position to two."""
        numbers = {
            "probability": round(self.probability, 6),
            "x": round(self.x, 2),
            "y": round(self.y, 2),
        }
        return {"id": self.id, "label": self.label, **numbers}


LIKELIEST = 3
"""Classes, or objects, that the `repr` of a decision names."""


# arrays have no truth value to compare by
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Decision:
    """What a window shows at one moment: its class, or with a map model the objects in it."""

    label: str | None
    """Name of the likeliest class; of objects the likeliest one's, None where there is none."""
    index: int
    """Number of that class, from 0; -1 where there is no object."""
    probabilities: np.ndarray
    """Softmax of the logits: float64, shape (n_classes,); of n objects (n, n_classes + 1), the last
    column nothing."""
    logits: np.ndarray
    """What the classifier answered: float32, shape (n_classes,); of a map model (n_classes + 1, R,
    C), read-only, and valid until the next decision: copy it to keep it."""
    window_start_us: int
    """Start of the window, in microseconds."""
    time_us: int
    """Time of the newest event in the window, in microseconds; the window's start if it has
    none."""
    events: int
    """Events in the window so far."""
    complete: bool
    """Whether this decision closes the window: at its end, or early by `confidence`; not at the end
    of the stream."""
    trigger: Trigger
    """What caused it: `window` (which closed), `every_us`, `every_events`, `confidence` (which
    closed the window), `fire` (on demand), `end` (of the stream)."""
    objects: tuple[Object, ...] | None = None
    """What a map model has found, the likeliest first; None with any other model."""

    @property
    def probability(self) -> float:
        """Probability of the likeliest class; 0 where there is no object."""
        if self.objects is None:
            return float(self.probabilities[self.index])
        return self.objects[0].probability if self.objects else 0.0

    def __repr__(self) -> str:
        """What was decided, why and when, on one line: the arrays may hold thousands of numbers."""
        if self.objects is None:
            best = np.argsort(-self.probabilities, kind="stable")[:LIKELIEST].tolist()
            listed = ", ".join(f"{k}: {self.probabilities[k]:.3f}" for k in best)
            rest = f"likeliest={{{listed}}}"
        else:
            named = [
                f"{one.label!r} at ({one.x:.1f}, {one.y:.1f})" for one in self.objects[:LIKELIEST]
            ]
            more = len(self.objects) - len(named)
            rest = f"objects=[{', '.join([*named, *([f'{more} more'] if more else [])])}]"
        return (
            f"Decision(label={self.label!r}, probability={self.probability:.3f}, "
            f"trigger={self.trigger!r}, "
            f"time_us={self.time_us}, events={self.events}, {rest})"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; probabilities to six decimals, no logits. With a map model
        `objects` in place of `probabilities`."""
        if self.objects is None:
            answer: dict[str, Any] = {
                "probabilities": [round(float(p), 6) for p in self.probabilities]
            }
        else:
            answer = {"objects": [found.to_dict() for found in self.objects]}
        return {
            "time_us": self.time_us,
            "window_start_us": self.window_start_us,
            "label": self.label,
            "probability": round(self.probability, 6),
            **answer,
            "events": self.events,
            "complete": self.complete,
            "trigger": self.trigger,
        }


def class_of_recording(classes: Sequence[str], windows: Sequence[np.ndarray]) -> tuple[str, str]:
    """The class of the highest mean probability over the last decisions of its windows; and that
    mean, in words."""
    mean = np.mean(windows, axis=0)
    best = int(mean.argmax())
    n_windows = "1 window" if len(windows) == 1 else f"{len(windows)} windows"
    return classes[best], f"mean probability {mean[best]:.3f} of {n_windows}"
