"""Measure how well a network classifies windows.

The accuracy is measured by window, by recording and against time. The probabilities of the
network's decisions are compared with how often the decisions are right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from async_tnt.base.checks import ParameterValueError
from async_tnt.evaluation.scores import calibration_of, share_right
from async_tnt.kernels.training.window_batches import SHOWN
from async_tnt.training.augment import KINDS, showing_nothing, unchanged
from async_tnt.training.pipeline import Pipeline
from async_tnt.training.temperature import fit_temperature, softened
from async_tnt.training.windows import Windows

BATCH = 64
"""Windows that are classified at a time. With 256, the layers' values no longer fit into the
processor's caches: a window takes 240 us instead of 150."""
SURE = 0.9
"""Least probability of a class that counts as sure."""


@dataclass(frozen=True)
class Evaluation:
    """The class probabilities of N windows at M moments, and the scores that follow from them.

    Parameters
    ----------
    windows : the N windows.
    times_ms : the M moments, in milliseconds since a window's start; the last one is its end.
    probabilities : float64, shape (M, N, n_classes), at these moments.
    nothing : name of a kind in `augment.KINDS` -> float64, shape (N, n_classes): probabilities at
        the windows' ends if events of this kind, which show no class, replace those of the
        recordings.
    """

    windows: Windows
    times_ms: tuple[float, ...]
    probabilities: np.ndarray
    nothing: dict[str, np.ndarray]

    @property
    def complete(self) -> np.ndarray:
        """float64, shape (N, n_classes). Probabilities at the windows' ends."""
        ends: np.ndarray = self.probabilities[-1]
        return ends

    @property
    def against_time(self) -> dict[float, float]:
        """Moment, in milliseconds -> the share of windows that are classified right then.

        Empty for windows of a number of events, in which time is no measure.
        """
        if self.windows.stop is not None:
            return {}
        shares = (self.probabilities.argmax(2) == self.windows.labels).mean(1)
        return dict(zip(self.times_ms, shares.tolist(), strict=True))

    @property
    def confusion(self) -> np.ndarray:
        """Number of windows by true class (row) and decided class (column).

        int64, shape (n_classes, n_classes).
        """
        return _confusion(self.windows.labels, self.complete)

    @property
    def recording_confusion(self) -> np.ndarray:
        """Number of recordings by true class (row) and decided class (column).

        int64, shape (n_classes, n_classes). The class of a recording is decided by the mean of its
        windows' probabilities.
        """
        return confusion_by_recording(self.complete, self.windows)

    @property
    def per_window(self) -> float:
        """The share of windows that are classified right."""
        return share_right(self.confusion)

    @property
    def per_recording(self) -> float:
        """The share of recordings that are classified right."""
        return share_right(self.recording_confusion)

    @property
    def calibration_error(self) -> float:
        """The expected calibration error of the decisions at all moments together.

        It is the mean difference between a decision's probability and the share of right decisions
        among those with a similar probability.
        """
        probabilities, labels = self._all_moments
        return calibration_of(probabilities.max(1), probabilities.argmax(1) == labels)[1]

    @property
    def sure_of_nothing(self) -> dict[str, float]:
        """Kind of windows that show no class -> the share of them that are surely given a class.

        The kinds are the keys of `nothing`. A window is surely given a class if some class has at
        least probability `SURE`. All these decisions are wrong.
        """
        shares = {}
        for kind, probabilities in self.nothing.items():
            shares[kind] = float((probabilities.max(1) >= SURE).mean())
        return shares

    @property
    def temperature(self) -> float:
        """The temperature that fits all moments together, see `fit_temperature`."""
        return fit_temperature(*self._all_moments)

    def at_temperature(self, temperature: float) -> Evaluation:
        """The evaluation with all logits divided by `temperature`."""
        nothing = {kind: softened(p, temperature) for kind, p in self.nothing.items()}
        return replace(
            self, probabilities=softened(self.probabilities, temperature), nothing=nothing
        )

    @property
    def _all_moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities at all moments, (M N, n_classes), and their labels, (M N,)."""
        n_moments, _, n_classes = self.probabilities.shape
        return self.probabilities.reshape(-1, n_classes), np.tile(self.windows.labels, n_moments)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "per_window": round(self.per_window, 5),
            "per_recording": round(self.per_recording, 5),
            "against_time_ms": {
                f"{ms:g}": round(share, 5) for ms, share in self.against_time.items()
            },
            "calibration_error": round(self.calibration_error, 5),
            "sure_of_nothing": {
                kind: round(share, 5) for kind, share in self.sure_of_nothing.items()
            },
            "confusion": self.confusion.tolist(),
            "windows": int(self.confusion.sum()),
            "recordings": int(self.recording_confusion.sum()),
        }


def class_probabilities(
    pipeline: Pipeline, windows: Windows, *, until_us: int | None = None, content: int = SHOWN
) -> np.ndarray:
    """Probability of each class for each window: float64, shape (N, n_classes).

    Parameters
    ----------
    pipeline : the model. If it is in training mode, it is in training mode again afterwards.
    windows : the windows to classify.
    until_us : only the events of each window's first `until_us` microseconds count; all by default.
    content : SHOWN, or one of the values of `augment.KINDS`: the windows show events of this kind
        instead of their recordings, see `Draws`.
    """
    if len(windows) == 0:
        raise ParameterValueError("windows", "must hold at least one window", "none")
    parts = []
    was_training = pipeline.training
    pipeline.eval()
    with torch.no_grad():
        for first in range(0, len(windows), BATCH):
            batch = windows[first : first + BATCH]
            draws = unchanged(len(batch), pipeline.config)
            if until_us is not None:
                draws.until_us[:] = until_us
            if content != SHOWN:
                # a fixed seed for each window, so that each evaluation has the same events
                draws.seed[:] = np.arange(first, first + len(batch))
                rng = np.random.default_rng((first, content))
                draws = showing_nothing(draws, np.full(len(batch), content, np.int64), rng)
            logits = pipeline(batch, draws)
            parts.append(torch.softmax(logits.double(), dim=1).cpu().numpy())
    pipeline.train(was_training)
    return np.concatenate(parts)


def confusion_by_recording(probabilities: np.ndarray, windows: Windows) -> np.ndarray:
    """Number of recordings by true class (row) and decided class (column).

    The class of a recording is decided by the mean of its windows' probabilities.
    """
    recordings, index_of_window = np.unique(windows.recording, return_inverse=True)
    # the class with the highest sum is the class with the highest mean
    sums = np.zeros((len(recordings), probabilities.shape[1]))
    np.add.at(sums, index_of_window, probabilities)
    return _confusion(windows.recordings.labels[recordings], sums)


def _confusion(labels: np.ndarray, probabilities: np.ndarray) -> np.ndarray:
    """Counts by true class (row) and most probable class (column): (n_classes, n_classes).

    labels, probabilities : (N,) and (N, n_classes); the rows of `probabilities` need no sum of 1.
    """
    confusion = np.zeros((probabilities.shape[1], probabilities.shape[1]), np.int64)
    np.add.at(confusion, (labels, probabilities.argmax(1)), 1)
    return confusion


def evaluate(
    pipeline: Pipeline, windows: Windows, *, times_ms: tuple[float, ...] = ()
) -> Evaluation:
    """Classify all windows at their ends, and at the earlier moments `times_ms`.

    Parameters
    ----------
    pipeline : the model, see `pipeline_of`.
    windows : the windows to classify.
    times_ms : moments, in milliseconds since a window's start. Moments at its end or later are left
        out. A window that has no event before a moment is classified by its empty volume.
    """
    end_ms = pipeline.config.window_us / 1e3
    moments = [float(ms) for ms in times_ms if ms < end_ms]
    times = (*moments, end_ms)
    probabilities = [
        class_probabilities(pipeline, windows, until_us=round(1e3 * ms)) for ms in times
    ]
    nothing = {}
    for name, kind in KINDS.items():
        nothing[name] = class_probabilities(pipeline, windows, content=kind)
    return Evaluation(windows, times, np.stack(probabilities), nothing)
