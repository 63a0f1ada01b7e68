"""How well a network classifies windows: by window, by recording, and against time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from async_tnt.archive.scores import share_right
from async_tnt.training.augment import unchanged
from async_tnt.training.pipeline import Pipeline
from async_tnt.training.windows import Windows

BATCH = 256


@dataclass(frozen=True)
class Evaluation:
    """What `evaluate` found.

    Parameters
    ----------
    against_time : milliseconds since the window's start -> share of windows that are right by then.
    confusion : (n_classes, n_classes), windows by true class (row) and decided class (column).
    recording_confusion : the same of recordings, each decided by the mean of its windows' probabilities.
    """

    against_time: dict[float, float]
    confusion: np.ndarray
    recording_confusion: np.ndarray

    @property
    def per_window(self) -> float:
        """Share of windows classified right."""
        return share_right(self.confusion)

    @property
    def per_recording(self) -> float:
        """Share of recordings classified right."""
        return share_right(self.recording_confusion)

    @property
    def n_windows(self) -> int:
        return int(self.confusion.sum())

    @property
    def n_recordings(self) -> int:
        return int(self.recording_confusion.sum())

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "per_window": round(self.per_window, 5),
            "per_recording": round(self.per_recording, 5),
            "against_time_ms": {f"{ms:g}": round(a, 5) for ms, a in self.against_time.items()},
            "confusion": self.confusion.tolist(),
            "windows": self.n_windows,
            "recordings": self.n_recordings,
        }


def class_probabilities(pipeline: Pipeline, windows: Windows, *, until_us: int | None = None) -> np.ndarray:
    """Probability of each class for each window: float64, shape (N, n_classes).

    Parameters
    ----------
    until_us : only the events of each window's first `until_us` microseconds; all by default.
    """
    if len(windows) == 0:
        raise ValueError("`windows` must hold at least one window, got none")
    parts = []
    was_training = pipeline.training
    pipeline.eval()
    with torch.no_grad():
        for first in range(0, len(windows), BATCH):
            some = windows[first : first + BATCH]
            logits = pipeline(some, None if until_us is None else unchanged(len(some), pipeline.config, until_us))
            parts.append(torch.softmax(logits.double(), dim=1).cpu().numpy())
    pipeline.train(was_training)
    return np.concatenate(parts)


def confusion_by_recording(probabilities: np.ndarray, windows: Windows) -> np.ndarray:
    """Recordings by true class (row) and the class of their windows' mean probability (column)."""
    recordings, place = np.unique(windows.recording, return_inverse=True)
    total = np.zeros((len(recordings), probabilities.shape[1]))
    np.add.at(total, place, probabilities)
    return _confusion(windows.recordings.labels[recordings], total)


def _confusion(labels: np.ndarray, probabilities: np.ndarray) -> np.ndarray:
    confusion = np.zeros((probabilities.shape[1], probabilities.shape[1]), np.int64)
    np.add.at(confusion, (labels, probabilities.argmax(1)), 1)
    return confusion


def evaluate(pipeline: Pipeline, windows: Windows, *, times_ms: tuple[float, ...] = ()) -> Evaluation:
    """Classify all windows, complete and after each of `times_ms`.

    Parameters
    ----------
    times_ms : milliseconds since the window's start. A window without any event by then is decided from the empty
        volume.
    """
    labels = windows.labels
    complete = class_probabilities(pipeline, windows)
    against_time = {}
    for ms in times_ms:
        early = class_probabilities(pipeline, windows, until_us=round(1e3 * ms))
        against_time[float(ms)] = float((early.argmax(1) == labels).mean())
    return Evaluation(against_time, _confusion(labels, complete), confusion_by_recording(complete, windows))
