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
PER_MOMENT = 5
LEVELS = 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99
FIELDS = ("decided_at", "probability_at", "confident", "confident_us")
"""Of `early_fields`; a record has a list of each."""


def every_us(config: TNTConfig) -> int | None:
    """How often to decide; None where windows have a number of events, and no duration of their
    own."""
    return (
        None
        if config.window_events is not None
        else max(1, config.window_us // (N_MOMENTS * PER_MOMENT))
    )


def moments(config: TNTConfig) -> list[int]:
    """The tenths of a window, in microseconds since its start; at the last one it ends. [] for
    windows of events.

    Examples
    --------
    >>> moments(TNTConfig())[:3], moments(TNTConfig())[-1]
    ([10500, 21000, 31500], 105000)
    """
    step_us = every_us(config)
    return (
        []
        if step_us is None
        else [*(PER_MOMENT * step_us * k for k in range(1, N_MOMENTS)), config.window_us]
    )


def early_fields(window: Sequence[Decision], config: TNTConfig) -> dict[str, Any]:
    """Of a window's decisions, what the tables below need; -1 stands for no decision.

    Returns
    -------
    decided_at, probability_at : class and its probability at each of `moments`.
    confident, confident_us : for each of `LEVELS`, the class of the first decision that reaches it,
        and when that was due since the window's start.
    """
    at = [decision_at(window, moment) for moment in moments(config)]
    first = [next((d for d in window if d.probability >= level), None) for level in LEVELS]
    return {
        "decided_at": [-1 if d is None else d.index for d in at],
        "probability_at": [-1.0 if d is None else float(d.probability) for d in at],
        "confident": [-1 if d is None else d.index for d in first],
        "confident_us": [-1 if d is None else due_us(d, config) for d in first],
    }


def due_us(decision: Decision, config: TNTConfig) -> int:
    """When a decision was due, since its window's start: the next fiftieth after its newest event,
    or the window's end. Of windows of events: its newest event's time."""
    since_us = decision.time_us - decision.window_start_us
    step_us = every_us(config)
    if step_us is None:
        return since_us
    return (
        (since_us // step_us + 1) * step_us if decision.trigger == "every_us" else config.window_us
    )


def decision_at(window: Sequence[Decision], moment_us: int) -> Decision | None:
    """The newest decision on events before a moment alone.

    If a moment has no decision of its own, no events have come since the previous one, whose
    decision still holds.
    """
    return next((d for d in reversed(window) if d.time_us - d.window_start_us < moment_us), None)


def early_report(
    records: Sequence[Mapping[str, Any]], labels: Sequence[int], config: TNTConfig
) -> dict[str, Any]:
    """Tables over all windows of records with the fields of `early_fields`; empty lists for windows
    of events.

    Parameters
    ----------
    labels : the class of each record.

    Returns
    -------
    accuracy_against_time : share of windows right, and decided at all, at each of `moments`.
    confidence : for each of `LEVELS`, how many windows reach it, how many of these are right, and
        when: median and 90th percentile, in milliseconds since the window's start; and how many of
        all windows are right, where those that do not reach it are decided at their ends.
    calibration : at all moments together, decisions by their probability: how many, their mean, the
        share right.
    calibration_error : the mean difference of the last two, weighted by how many: 0 where .9 means
        .9.
    """
    truth = np.repeat(labels, [len(record["decided_at"]) for record in records])
    columns = {
        name: np.concatenate([np.array(record[name]) for record in records]) for name in FIELDS
    }

    def accuracy(decided: np.ndarray) -> float:
        return float((decided == truth).mean())

    after_us = moments(config)
    if not after_us:
        return {
            "accuracy_against_time": [],
            "confidence": [],
            "calibration": [],
            "calibration_error": None,
        }
    against_time = [
        {"time_us": us, "accuracy": accuracy(decided), "decided": float((decided >= 0).mean())}
        for us, decided in zip(after_us, columns["decided_at"].T, strict=True)
    ]
    confidence = []
    for level, classes, us in zip(
        LEVELS, columns["confident"].T, columns["confident_us"].T, strict=True
    ):
        sure = classes >= 0
        row = {
            "level": level,
            "decided": float(sure.mean()),
            "accuracy": None,
            "median_ms": None,
            "p90_ms": None,
        }
        row["window_accuracy"] = accuracy(np.where(sure, classes, columns["decided_at"][:, -1]))
        if sure.any():
            row["accuracy"] = float((classes == truth)[sure].mean())
            row["median_ms"], row["p90_ms"] = (
                float(np.quantile(us[sure] / 1e3, share)) for share in (0.5, 0.9)
            )
        confidence.append(row)
    made = columns["decided_at"] >= 0
    probability, right = (
        columns["probability_at"][made],
        (columns["decided_at"] == truth[:, np.newaxis])[made],
    )
    bins, error = calibration_of(probability, right)
    return {
        "accuracy_against_time": against_time,
        "confidence": confidence,
        "calibration": bins,
        "calibration_error": error,
    }
