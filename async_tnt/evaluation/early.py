"""How early in a window decisions are right: against time, and for levels of confidence.

A decision is made after every fiftieth of a window, and at its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from async_tnt.evaluation.scores import calibration_of
from async_tnt.streaming.decision import Decision
from async_tnt.volume.config import TNTConfig

N_MOMENTS = 10
"""Number of moments in a window for which a table says how many decisions are right."""
PER_MOMENT = 5
"""Number of decisions from one of the `N_MOMENTS` moments to the next."""
LEVELS = 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99
"""Levels of confidence. A table says when a decision first reaches each of these probabilities."""
FIELDS = ("decided_at", "probability_at", "confident", "confident_us")
"""The keys of what `early_fields` returns. In a record, each is a list with one entry a window."""

NO_DECISION = -1
"""The value in a record that stands for no decision."""


def every_us(config: TNTConfig) -> int | None:
    """Microseconds from one decision to the next: a fiftieth of a window.

    None for windows of a number of events, which have no duration of their own.
    """
    if config.window_events is not None or config.last_events is not None:
        return None
    return max(1, config.window_us // (N_MOMENTS * PER_MOMENT))


def moments(config: TNTConfig) -> list[int]:
    """The ends of the ten tenths of a window, in microseconds since the window's start.

    The last one is the window's end. The list is empty for windows of a number of events.

    Examples
    --------
    >>> moments(TNTConfig())[:3], moments(TNTConfig())[-1]
    ([10500, 21000, 31500], 105000)
    """
    step_us = every_us(config)
    if step_us is None:
        return []
    # a step is at least a microsecond, so ten tenths may be longer than a very short window
    inner_ends = [min(PER_MOMENT * step_us * k, config.window_us) for k in range(1, N_MOMENTS)]
    return [*inner_ends, config.window_us]


def early_fields(start_us: int, window: Sequence[Decision], config: TNTConfig) -> dict[str, Any]:
    """What `early_report` needs to know about the decisions of a window.

    -1 stands for no decision.

    Parameters
    ----------
    start_us : the window's start.
    window : all decisions of the window, in order.

    Returns
    -------
    decided_at, probability_at : for each of `moments`, the decided class and its probability.
    confident, confident_us : for each of `LEVELS`, the class of the first decision that reaches the
        level, and when this decision was due, see `due_us`.
    """
    decisions_at_moments = [decision_at(window, start_us + moment) for moment in moments(config)]
    confident_decisions = [_first_at(window, level) for level in LEVELS]
    return {
        "decided_at": [
            NO_DECISION if decision is None else decision.index for decision in decisions_at_moments
        ],
        "probability_at": [
            float(NO_DECISION) if decision is None else float(decision.probability)
            for decision in decisions_at_moments
        ],
        "confident": [
            NO_DECISION if decision is None else decision.index for decision in confident_decisions
        ],
        "confident_us": [
            NO_DECISION if decision is None else due_us(decision, start_us, config)
            for decision in confident_decisions
        ],
    }


def _first_at(window: Sequence[Decision], level: float) -> Decision | None:
    """The first decision with at least this probability; None if there is none."""
    for decision in window:
        if decision.probability >= level:
            return decision
    return None


def due_us(decision: Decision, start_us: int, config: TNTConfig) -> int:
    """When a decision was due, in microseconds since its window's start.

    A decision is due at the first fiftieth of the window after the decision's newest event, or at
    the window's end. In windows of a number of events, it is due at its newest event.

    start_us : the window's start.
    """
    since_us = decision.time_us - start_us
    step_us = every_us(config)
    if step_us is None:
        return since_us
    if decision.trigger == "every_us":
        return (since_us // step_us + 1) * step_us
    return config.window_us


def decision_at(window: Sequence[Decision], moment_us: int) -> Decision | None:
    """The newest decision that was made only of events before a moment; None if there is none.

    If no event came since the previous moment, there is no new decision. Then the previous decision
    still holds.

    Parameters
    ----------
    moment_us : the moment, in microseconds.
    """
    for decision in reversed(window):
        if decision.time_us < moment_us:
            return decision
    return None


def early_report(
    records: Sequence[Mapping[str, Any]], labels: Sequence[int], config: TNTConfig
) -> dict[str, Any]:
    """Make tables about early decisions, over all windows of all records.

    For windows of a number of events, the tables are empty.

    Parameters
    ----------
    records : records with the fields of `early_fields`.
    labels : the true class of each record.

    Returns
    -------
    accuracy_against_time : a row for each of `moments`. `accuracy` is the share of windows that are
        right then, `decided` the share of windows that have a decision then.
    confidence : a row for each of `LEVELS`. `decided` is the share of windows that reach the level,
        `accuracy` the share of these that are right. `median_ms` and `p90_ms` are the median and
        the 90th percentile of the time from the window's start to the level. `window_accuracy` is
        the share of all windows that are right, if the windows that do not reach the level are
        decided at their ends.
    calibration : the decisions of all moments, in groups of similar probability. A row for each
        group: the number of decisions, their mean probability, and the share that is right.
    calibration_error : the mean difference between the probability and the share that is right,
        weighted by the number of decisions. It is 0 if 0.9 of the decisions with probability 0.9
        are right, and likewise for all other probabilities.
    """
    after_us = moments(config)
    if not after_us:
        return {
            "accuracy_against_time": [],
            "confidence": [],
            "calibration": [],
            "calibration_error": None,
        }
    truth = np.repeat(labels, [len(record["decided_at"]) for record in records])
    columns = {
        name: np.concatenate([np.array(record[name]) for record in records]) for name in FIELDS
    }

    against_time = [
        {
            "time_us": time_us,
            "accuracy": _share(classes == truth),
            "decided": _share(classes != NO_DECISION),
        }
        for time_us, classes in zip(after_us, columns["decided_at"].T, strict=True)
    ]

    # the last moment is the window's end
    end_classes = columns["decided_at"][:, -1]
    levels = zip(LEVELS, columns["confident"].T, columns["confident_us"].T, strict=True)
    confidence = [
        _confidence_row(level, classes, time_us, end_classes, truth)
        for level, classes, time_us in levels
    ]

    has_decision = columns["decided_at"] != NO_DECISION
    is_right = columns["decided_at"] == truth[:, np.newaxis]
    calibration, calibration_error = calibration_of(
        columns["probability_at"][has_decision], is_right[has_decision]
    )
    return {
        "accuracy_against_time": against_time,
        "confidence": confidence,
        "calibration": calibration,
        "calibration_error": calibration_error,
    }


def _confidence_row(
    level: float,
    classes: np.ndarray,
    times_us: np.ndarray,
    end_classes: np.ndarray,
    truth: np.ndarray,
) -> dict[str, Any]:
    """The row of one level in the table `confidence` of `early_report`.

    Parameters
    ----------
    classes, times_us : for each window, the class of the first decision that reaches the level, or
        `NO_DECISION`, and when this decision was due.
    end_classes : for each window, the class that is decided at its end.
    truth : for each window, the true class.
    """
    has_reached = classes != NO_DECISION
    final_classes = np.where(has_reached, classes, end_classes)
    row: dict[str, Any] = {
        "level": level,
        "decided": _share(has_reached),
        "accuracy": None,
        "median_ms": None,
        "p90_ms": None,
        "window_accuracy": _share(final_classes == truth),
    }
    if has_reached.any():
        after_ms = times_us[has_reached] / 1e3
        row["accuracy"] = _share((classes == truth)[has_reached])
        row["median_ms"] = float(np.quantile(after_ms, 0.5))
        row["p90_ms"] = float(np.quantile(after_ms, 0.9))
    return row


def _share(holds: np.ndarray) -> float:
    """The share of values that are True."""
    return float(holds.mean())
