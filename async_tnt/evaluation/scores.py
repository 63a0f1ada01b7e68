"""How many windows and recordings are classified right, and how far probabilities can be
believed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

N_BINS = 10
"""Of probability, for the calibration."""


def scores_of(
    classes: Sequence[str], confusion: np.ndarray, window_confusion: np.ndarray
) -> dict[str, Any]:
    """What is read from confusion matrices, as plain values for JSON.

    Parameters
    ----------
    classes : K names.
    confusion : int64, shape (K, K), recordings by true class (row) and decided class (column). A
        recording is decided by the mean of its windows' probabilities.
    window_confusion : the same of windows, each by itself.

    Returns
    -------
    accuracy, window_accuracy : shares of recordings, and of windows, decided right.
    per_class : class name -> share of its recordings decided right; None where it has none.
    balanced_accuracy : mean of `per_class`: a model that always answers the most frequent class
        scores low.
    recordings, windows : how many. And what was given.
    """
    per_class = {
        name: None if not row.sum() else float(row[k] / row.sum())
        for k, (name, row) in enumerate(zip(classes, confusion, strict=True))
    }
    return {
        "accuracy": share_right(confusion),
        "window_accuracy": share_right(window_confusion),
        "balanced_accuracy": float(
            np.mean([share for share in per_class.values() if share is not None])
        ),
        "recordings": int(confusion.sum()),
        "windows": int(window_confusion.sum()),
        "classes": list(classes),
        "per_class": per_class,
        "confusion": confusion.tolist(),
        "window_confusion": window_confusion.tolist(),
    }


def score_recordings(
    classes: Sequence[str], labels: Sequence[int] | np.ndarray, probabilities: Sequence[np.ndarray]
) -> dict[str, Any]:
    """Compare decisions with the truth, see `scores_of`.

    Parameters
    ----------
    classes : K names.
    labels : R, the class of each recording, in [0, K); R at least 1.
    probabilities : R arrays of shape (n, K), of each recording's windows; n at least 1.

    Examples
    --------
    >>> windows = [np.array([[0.9, 0.1], [0.4, 0.6]]), np.array([[0.7, 0.3]])]
    >>> scores = score_recordings(["left", "right"], [0, 1], windows)
    >>> scores["accuracy"], round(scores["window_accuracy"], 3), scores["per_class"]
    (0.5, 0.333, {'left': 1.0, 'right': 0.0})
    """
    confusion = np.zeros((len(classes), len(classes)), np.int64)
    window_confusion = np.zeros_like(confusion)
    for label, windows in zip(labels, probabilities, strict=True):
        confusion[label, np.mean(windows, axis=0).argmax()] += 1
        np.add.at(window_confusion[label], np.argmax(windows, axis=1), 1)
    return scores_of(classes, confusion, window_confusion)


def share_right(confusion: np.ndarray) -> float:
    """The diagonal's share of a confusion matrix."""
    return float(np.trace(confusion) / confusion.sum())


def calibration_of(
    probability: np.ndarray, right: np.ndarray
) -> tuple[list[dict[str, Any]], float]:
    """Decisions in `N_BINS` of probability, without empty ones, and the expected calibration error.

    Parameters
    ----------
    probability : float64, shape (N,), of the decided class. right : bool, shape (N,).

    References
    ----------
    Guo, Pleiss, Sun, Weinberger 2017, arXiv:1706.04599, equation 3.

    Examples
    --------
    >>> bins, error = calibration_of(np.array([0.9, 1.0, 0.75, 0.75]), np.array([True, True, True, False]))
    >>> [(row["decisions"], row["accuracy"]) for row in bins], round(error, 3)
    ([(2, 0.5), (2, 1.0)], 0.15)
    """
    place = np.minimum((probability * N_BINS).astype(np.int64), N_BINS - 1)
    rows = []
    error = 0.0
    for k in np.unique(place):
        some = place == k
        mean, accuracy = float(probability[some].mean()), float(right[some].mean())
        rows.append({"decisions": int(some.sum()), "probability": mean, "accuracy": accuracy})
        error += float(some.mean()) * abs(mean - accuracy)
    return rows, error
