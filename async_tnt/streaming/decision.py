"""Decision: what a window shows at one moment. Object: a thing in the window, and its place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from async_tnt.volume.config import TNTConfig

Trigger = Literal["window", "every_us", "every_events", "confidence", "fire", "end"]


# Not frozen: that would make it take three times as long to create.
@dataclass(slots=True, unsafe_hash=True)
class Object:
    """An object that a map model has found in a window."""

    label: str
    """Name of the object's likeliest class."""
    index: int
    """Number of that class, from 0."""
    probability: float
    """Probability of that class at this place."""
    x: float
    """Column of the object's place, in sensor pixels."""
    y: float
    """Row of the object's place, in sensor pixels."""
    id: int
    """Number of the object. It stays the same while the object moves little between two decisions.
    A new object gets the next unused number. `fire` uses up no number: the number of an object that
    only `fire` has found may go to another object at the next decision."""
    width: float | None = None
    """Width of the object's box, in sensor pixels. None if the model says no sizes."""
    height: float | None = None
    """Height of the object's box, in sensor pixels. None if the model says no sizes."""

    @property
    def box(self) -> tuple[float, float, float, float] | None:
        """The object's box (x0, y0, x1, y1) around its place, in sensor pixels.

        It may reach beyond the sensor. None if the model says no sizes.
        """
        if self.width is None or self.height is None:
            return None
        half_width = self.width / 2
        half_height = self.height / 2
        return (
            self.x - half_width,
            self.y - half_height,
            self.x + half_width,
            self.y + half_height,
        )

    def to_dict(self) -> dict[str, Any]:
        """A dictionary of plain values, for JSON: probability to six decimals, places to two.

        It has a `box` if the model says sizes.
        """
        values: dict[str, Any] = {
            "id": self.id,
            "label": self.label,
            "probability": round(self.probability, 6),
            "x": round(self.x, 2),
            "y": round(self.y, 2),
        }
        if self.box is not None:
            values["box"] = [round(side, 2) for side in self.box]
        return values


LIKELIEST = 3
"""Number of classes, or of objects, that the `repr` of a decision names."""


# eq=False, because a comparison of two arrays is an array, which has no truth value. Not frozen,
# because a frozen decision would take six times as long to create.
@dataclass(slots=True, eq=False, repr=False)
class Decision:
    """What a window shows at one moment: its class, or with a map model the objects in it."""

    label: str | None
    """Name of the likeliest class. With a map model the class of the likeliest object, or None if
    there is no object."""
    index: int
    """Number of that class, from 0; -1 if there is no object."""
    probabilities: np.ndarray
    """Softmax of the logits: float64, shape (n_classes,). With a map model the shape is (n_objects,
    n_classes + 1), and the last column is the probability of no object."""
    logits: np.ndarray
    """The classifier's answer: float32, shape (n_classes,). With a map model the shape is
    (n_classes + 1, R, C), and the array is read-only and valid until the next decision: copy it to
    keep it."""
    window_start_us: int
    """Start of the window, in microseconds."""
    time_us: int
    """Time of the newest event in the window, in microseconds. If the window has no events, its
    start."""
    events: int
    """Events in the window so far."""
    complete: bool
    """Whether this decision closes the window, at the window's end or early by `confidence`. It is
    False for a decision at the end of the stream, and in a window that slides."""
    trigger: Trigger
    """The cause of the decision: `window` (the window has ended), `every_us`, `every_events`,
    `confidence` (which closed the window, or in a window that slides has found another class),
    `fire` (on demand) or `end` (the stream has ended)."""
    objects: tuple[Object, ...] | None = None
    """Objects that a map model has found, the likeliest first; None with any other model."""

    @property
    def probability(self) -> float:
        """Probability of the likeliest class, or of the likeliest object; 0 without objects."""
        if self.objects is None:
            return float(self.probabilities[self.index])
        if not self.objects:
            return 0.0
        return self.objects[0].probability

    def __repr__(self) -> str:
        """What was decided, why and when, on one line.

        The arrays are left out, because they may hold thousands of numbers.
        """
        answer = self._likeliest_classes() if self.objects is None else self._likeliest_objects()
        return (
            f"Decision(label={self.label!r}, probability={self.probability:.3f}, "
            f"trigger={self.trigger!r}, time_us={self.time_us}, events={self.events}, {answer})"
        )

    def _likeliest_classes(self) -> str:
        best = np.argsort(-self.probabilities, kind="stable")[:LIKELIEST].tolist()
        texts = ", ".join(f"{k}: {self.probabilities[k]:.3f}" for k in best)
        return f"likeliest={{{texts}}}"

    def _likeliest_objects(self) -> str:
        objects = self.objects or ()
        texts = [
            f"{thing.label!r} at ({thing.x:.1f}, {thing.y:.1f})" for thing in objects[:LIKELIEST]
        ]
        n_more = len(objects) - len(texts)
        if n_more:
            texts.append(f"{n_more} more")
        return f"objects=[{', '.join(texts)}]"

    def to_dict(self) -> dict[str, Any]:
        """A dictionary of plain values, for JSON.

        It has no logits, and has probabilities to six decimals. With a map model it has `objects`
        in place of `probabilities`.
        """
        values: dict[str, Any] = {
            "time_us": self.time_us,
            "window_start_us": self.window_start_us,
            "label": self.label,
            "probability": round(self.probability, 6),
        }
        if self.objects is None:
            values["probabilities"] = [round(float(p), 6) for p in self.probabilities]
        else:
            values["objects"] = [thing.to_dict() for thing in self.objects]
        values["events"] = self.events
        values["complete"] = self.complete
        values["trigger"] = self.trigger
        return values


def class_of_recording(classes: Sequence[str], windows: Sequence[np.ndarray]) -> tuple[str, str]:
    """The class that the windows of a recording show on average, and its mean probability in words.

    classes : names of the classes.
    windows : probabilities of the classes in the last decision of each window.
    """
    mean_probabilities = np.mean(windows, axis=0)
    best = int(mean_probabilities.argmax())
    n_windows = "1 window" if len(windows) == 1 else f"{len(windows)} windows"
    return classes[best], f"mean probability {mean_probabilities[best]:.3f} of {n_windows}"


def in_windows(
    decisions: Iterable[Decision], config: TNTConfig
) -> Iterator[tuple[int, list[Decision]]]:
    """The decisions of one window after the other, each with the window's start.

    A window that slides has no end. So a stream of `last_us` is divided into stretches as long as a
    window, from its first event on, and in a stream of `last_events` each decision stands alone.
    """
    start_us = 0
    window: list[Decision] = []
    last: Decision | None = None
    for decision in decisions:
        if config.last_events is not None and decision.trigger == "end" and last is not None:
            is_again = (decision.time_us, decision.events) == (last.time_us, last.events)
            if is_again:  # no event has come since
                continue
        last = decision
        if config.last_us is not None and window:
            passed_us = decision.time_us - start_us
            if passed_us >= config.last_us:
                yield start_us, window
                window = []
                start_us += passed_us // config.last_us * config.last_us
        elif not window:
            start_us = decision.window_start_us
        window.append(decision)
        is_over = decision.trigger in ("window", "end") or config.last_events is not None
        if is_over:
            yield start_us, window
            window = []
