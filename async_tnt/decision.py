"""Decision: what the classifier says of one window at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .kernels.network import softmax


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
    """Whether the window is closed: no event can come any more."""
    trigger: str
    """Why it fired: `window` (closed), `every_us`, `every_events`, `fire` (on demand), `end` (of the stream)."""

    @property
    def probability(self) -> float:
        """Probability of the likeliest class."""
        return float(self.probabilities[self.index])


def decide(
    logits: np.ndarray, classes: Sequence[str], start_us: int, time_us: int, n_events: int, complete: bool, trigger: str
) -> Decision:
    """A Decision from the logits (float32, shape (n_classes,)) of a window.

    Raises
    ------
    ValueError : there is not one finite logit for each class.
    """
    if logits.size != len(classes):
        raise ValueError(f"`classifier` must return {len(classes)} logits, one for each class, got {logits.size}")
    probabilities = np.empty(logits.size)
    index = softmax(logits, probabilities) if logits.size else -1
    if index < 0:
        raise ValueError(f"`classifier` must return finite logits, got {logits.tolist()}")
    return Decision(classes[index], index, probabilities, logits, start_us, time_us, n_events, complete, trigger)
