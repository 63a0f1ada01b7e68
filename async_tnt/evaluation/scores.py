"""How many windows and recordings are right, and how far the probabilities can be believed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

N_BINS = 10
"""Number of groups for the calibration: equal parts of the probabilities from 0 to 1."""


def scores_of(
    classes: Sequence[str], confusion: np.ndarray, window_confusion: np.ndarray
) -> dict[str, Any]:
    """Scores from two confusion matrices, as plain values for JSON.

    Parameters
    ----------
    classes : K names.
    confusion : int64, shape (K, K): the number of recordings by true class (row) and decided class
        (column). A recording's decided class is the one of the highest mean probability over its
        windows.
    window_confusion : int64, shape (K, K): the number of windows by true and decided class. Each
        window is decided by itself.

    Returns
    -------
    accuracy, window_accuracy : shares of recordings, and of windows, decided right.
    per_class : class name -> share of its recordings decided right; None without recordings.
    balanced_accuracy : mean of `per_class`. It is low for a model that always answers the most
        frequent class.
    recordings, windows : the number of recordings, and of windows.
    classes, confusion, window_confusion : the arguments.
    """
    per_class: dict[str, float | None] = {}
    for k, (name, row) in enumerate(zip(classes, confusion, strict=True)):
        per_class[name] = float(row[k] / row.sum()) if row.sum() else None
    shares = [share for share in per_class.values() if share is not None]
    return {
        "accuracy": share_right(confusion),
        "window_accuracy": share_right(window_confusion),
        "balanced_accuracy": float(np.mean(shares)),
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
    """Compare decisions with the true classes. Returns the scores of `scores_of`.

    Parameters
    ----------
    classes : K names.
    labels : the true class of each of R recordings, in [0, K). R is at least 1.
    probabilities : for each recording an array of shape (n, K), with a row for each of its windows.
        n is at least 1.

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
    """The share of decisions in a confusion matrix that are right: on the diagonal."""
    return float(np.trace(confusion) / confusion.sum())


def calibration_of(
    probability: np.ndarray, is_right: np.ndarray
) -> tuple[list[dict[str, Any]], float]:
    """Group decisions by their probability, in `N_BINS` groups.

    Returns a row for each group that is not empty, and the expected calibration error: the mean of
    |probability - accuracy| over the rows, weighted by their numbers of decisions.

    Parameters
    ----------
    probability : float64, shape (N,): each decision's probability of the decided class.
    is_right : bool, shape (N,): whether the decided class is the true class.

    References
    ----------
    Guo, Pleiss, Sun, Weinberger 2017, arXiv:1706.04599, equation 3.

    Examples
    --------
    >>> probability = np.array([0.9, 1.0, 0.75, 0.75])
    >>> bins, error = calibration_of(probability, np.array([True, True, True, False]))
    >>> [(row["decisions"], row["accuracy"]) for row in bins], round(error, 3)
    ([(2, 0.5), (2, 1.0)], 0.15)
    """
    group = np.minimum((probability * N_BINS).astype(np.int64), N_BINS - 1)
    rows = []
    error = 0.0
    for k in np.unique(group):
        in_group = group == k
        mean_probability = float(probability[in_group].mean())
        accuracy = float(is_right[in_group].mean())
        rows.append(
            {
                "decisions": int(in_group.sum()),
                "probability": mean_probability,
                "accuracy": accuracy,
            }
        )
        error += float(in_group.mean()) * abs(mean_probability - accuracy)
    return rows, error
