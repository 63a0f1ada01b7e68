"""How well a network classifies windows: by window, by recording, and against time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from async_tnt.training.augment import unchanged
from async_tnt.training.pipelines import Pipeline
from async_tnt.training.windows import Windows

BATCH = 256


@dataclass(frozen=True)
class Evaluation:
    """What `evaluate` found.

    Parameters
    ----------
    per_window : share of windows classified right.
    per_recording : share of recordings right by the mean of their windows' probabilities.
    against_time : milliseconds since the window's start -> share of windows right by the events until then.
    confusion : (n_classes, n_classes), windows by true class (row) and decided class (column).
    recording_confusion : the same of recordings.
    n_windows, n_recordings : how many.
    """

    per_window: float
    per_recording: float
    against_time: dict[float, float]
    confusion: np.ndarray
    recording_confusion: np.ndarray
    n_windows: int
    n_recordings: int

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


def accuracy_by_recording(probabilities: np.ndarray, windows: Windows) -> tuple[float, int]:
    """Share of recordings right by the mean of their windows' probabilities, and how many recordings."""
    confusion = confusion_by_recording(probabilities, windows)
    n_recordings = int(confusion.sum())
    return float(np.trace(confusion) / n_recordings), n_recordings


def confusion_by_recording(probabilities: np.ndarray, windows: Windows) -> np.ndarray:
    """Recordings by true class (row) and the class of their windows' mean probability (column)."""
    recordings, place = np.unique(windows.recording, return_inverse=True)
    total = np.zeros((len(recordings), probabilities.shape[1]))
    np.add.at(total, place, probabilities)
    confusion = np.zeros((probabilities.shape[1], probabilities.shape[1]), np.int64)
    np.add.at(confusion, (windows.recordings.labels[recordings], total.argmax(1)), 1)
    return confusion


def evaluate(pipeline: Pipeline, windows: Windows, *, times_ms: tuple[float, ...] = ()) -> Evaluation:
    """Classify all windows, complete and after each of `times_ms`.

    Parameters
    ----------
    times_ms : milliseconds since the window's start. A window without any event by then is decided all the
        same, from the empty volume.
    """
    labels = windows.labels
    complete = class_probabilities(pipeline, windows)
    decided = complete.argmax(1)
    confusion = np.zeros((complete.shape[1], complete.shape[1]), np.int64)
    np.add.at(confusion, (labels, decided), 1)
    per_recording, n_recordings = accuracy_by_recording(complete, windows)
    by_recording = confusion_by_recording(complete, windows)
    against_time = {}
    for ms in times_ms:
        early = class_probabilities(pipeline, windows, until_us=round(1e3 * ms))
        against_time[float(ms)] = float((early.argmax(1) == labels).mean())
    return Evaluation(
        float((decided == labels).mean()),
        per_recording,
        against_time,
        confusion,
        by_recording,
        len(windows),
        n_recordings,
    )
