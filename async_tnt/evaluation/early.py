"""What is decided early in a window: against time, and at a level of confidence.

Decisions are made at every fiftieth of a window, and at its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from async_tnt.evaluation.scores import calibration_of
from async_tnt.streaming.decision import Decision
from async_tnt.volume.config import TNTConfig

N_MOMENTS = 10
"""Moments of a window at which the tables say how many decisions are right."""
PER_MOMENT = 5
"""Decisions from one of these moments to the next."""
LEVELS = 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99
"""Probabilities at which a table says when they are first reached."""
FIELDS = ("decided_at", "probability_at", "confident", "confident_us")
"""The names of what `early_fields` returns. A record has a list of each, one entry a window."""

NO_DECISION = -1
"""Stands in a record where there is no decision."""


def every_us(config: TNTConfig) -> int | None:
    """How often to decide, in microseconds.

    None for windows of a number of events, which have no duration of their own.
    """
    if config.window_events is not None:
        return None
    return max(1, config.window_us // (N_MOMENTS * PER_MOMENT))


def moments(config: TNTConfig) -> list[int]:
    """The tenths of a window, in microseconds since its start; the last one is its end.

    The list is empty for windows of a number of events.

    Examples
    --------
    >>> moments(TNTConfig())[:3], moments(TNTConfig())[-1]
    ([10500, 21000, 31500], 105000)
    """
    step_us = every_us(config)
    if step_us is None:
        return []
    inside = [PER_MOMENT * step_us * k for k in range(1, N_MOMENTS)]
    return [*inside, config.window_us]


def early_fields(window: Sequence[Decision], config: TNTConfig) -> dict[str, Any]:
    """What the tables below need of a window's decisions; -1 stands for no decision.

    Returns
    -------
    decided_at, probability_at : class and its probability at each of `moments`.
    confident, confident_us : for each of `LEVELS`, the class of the first decision that reaches it,
        and when that was due since the window's start.
    """
    at = [decision_at(window, moment) for moment in moments(config)]
    first = [_first_at(window, level) for level in LEVELS]
    return {
        "decided_at": [NO_DECISION if d is None else d.index for d in at],
        "probability_at": [float(NO_DECISION) if d is None else float(d.probability) for d in at],
        "confident": [NO_DECISION if d is None else d.index for d in first],
        "confident_us": [NO_DECISION if d is None else due_us(d, config) for d in first],
    }


def _first_at(window: Sequence[Decision], level: float) -> Decision | None:
    """The first decision with at least this probability."""
    for decision in window:
        if decision.probability >= level:
            return decision
    return None


def due_us(decision: Decision, config: TNTConfig) -> int:
    """When a decision was due, in microseconds since its window's start.

    It was due at the next fiftieth of the window after its newest event, or at the window's end. In
    windows of a number of events it was due at its newest event.
    """
    since_us = decision.time_us - decision.window_start_us
    step_us = every_us(config)
    if step_us is None:
        return since_us
    if decision.trigger == "every_us":
        return (since_us // step_us + 1) * step_us
    return config.window_us


def decision_at(window: Sequence[Decision], moment_us: int) -> Decision | None:
    """The newest decision that rests on events before a moment alone.

    If a moment has no decision of its own, no events have come since the previous one, whose
    decision still holds.
    """
    for decision in reversed(window):
        if decision.time_us - decision.window_start_us < moment_us:
            return decision
    return None


def early_report(
    records: Sequence[Mapping[str, Any]], labels: Sequence[int], config: TNTConfig
) -> dict[str, Any]:
    """Tables over all windows of records with the fields of `early_fields`.

    The lists are empty for windows of a number of events.

    Parameters
    ----------
    labels : the class of each record.

    Returns
    -------
    accuracy_against_time : share of windows right, and share decided at all, at each of `moments`.
    confidence : for each of `LEVELS`, how many windows reach it, how many of these are right, and
        when: median and 90th percentile, in milliseconds since the window's start. And how many of
        all windows are right, if those that do not reach the level are decided at their ends.
    calibration : decisions at all moments together, grouped by their probability: how many, their
        mean probability, the share right.
    calibration_error : the mean difference of the last two, weighted by the number of decisions: 0
        if .9 of the decisions with probability .9 are right, and so on.
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
        {"time_us": us, "accuracy": _share(decided == truth), "decided": _share(decided >= 0)}
        for us, decided in zip(after_us, columns["decided_at"].T, strict=True)
    ]

    at_the_end = columns["decided_at"][:, -1]
    levels = zip(LEVELS, columns["confident"].T, columns["confident_us"].T, strict=True)
    confidence = [
        _confidence_row(level, classes, us, at_the_end, truth) for level, classes, us in levels
    ]

    decided = columns["decided_at"] >= 0
    is_right = columns["decided_at"] == truth[:, np.newaxis]
    bins, error = calibration_of(columns["probability_at"][decided], is_right[decided])
    return {
        "accuracy_against_time": against_time,
        "confidence": confidence,
        "calibration": bins,
        "calibration_error": error,
    }


def _confidence_row(
    level: float, classes: np.ndarray, us: np.ndarray, at_the_end: np.ndarray, truth: np.ndarray
) -> dict[str, Any]:
    """The row of one level of `early_report`.

    Parameters
    ----------
    classes, us : each window's first class at this level, or -1, and when it was due.
    at_the_end : the class that is decided at each window's end.
    truth : each window's class.
    """
    reached = classes >= 0
    row: dict[str, Any] = {
        "level": level,
        "decided": _share(reached),
        "accuracy": None,
        "median_ms": None,
        "p90_ms": None,
        "window_accuracy": _share(np.where(reached, classes, at_the_end) == truth),
    }
    if reached.any():
        after_ms = us[reached] / 1e3
        row["accuracy"] = _share((classes == truth)[reached])
        row["median_ms"] = float(np.quantile(after_ms, 0.5))
        row["p90_ms"] = float(np.quantile(after_ms, 0.9))
    return row


def _share(holds: np.ndarray) -> float:
    """The share of True."""
    return float(holds.mean())
