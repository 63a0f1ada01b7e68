"""Errors of several ways to flow, on the same events of the same sequences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from examples.optical_flow.network import WINDOW_US
from examples.optical_flow.sequences import KnownSequence, Way, ages_us, endpoint_errors

ZERO = "zero flow"
PLANE = "plane fit"
POOLED = "plane fits, pooled"
NETWORK = "network"
OVERLAPPING = "network, overlapping windows"

AGE_US = 5_000
"""Width of the classes by age of a window, in microseconds."""

Answers = Mapping[str, list[np.ndarray]]
"""Way -> for each sequence its flow at the events that are compared, (n, 2), nan if not found."""


def answers_of(ways: Mapping[str, Way], sequences: Iterable[KnownSequence]) -> Answers:
    """What each way says."""
    answers: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    for sequence in sequences:
        for name, way in ways.items():
            answers[name].append(way(sequence))
    return answers


def mean_error(way: Way, sequences: Iterable[KnownSequence]) -> float:
    """The mean over sequences of the mean error of a sequence's events."""
    errors = [endpoint_errors(way(sequence), sequence.true).mean() for sequence in sequences]
    return float(np.mean(errors))


def by_sequence(answers: Answers, sequences: list[KnownSequence]) -> dict[str, Any]:
    """Way -> mean and standard deviation, over sequences, of the mean error of their events.

    `better` is the number of sequences in which the network with overlapping windows has a smaller
    error.
    """
    means = {
        name: np.array(
            [
                endpoint_errors(flow, sequence.true).mean()
                for flow, sequence in zip(flows, sequences, strict=True)
            ]
        )
        for name, flows in answers.items()
    }
    return {
        name: {
            "mean": float(errors.mean()),
            "sd": float(errors.std(ddof=1)) if len(errors) > 1 else 0.0,
            "better": int((means[OVERLAPPING] < errors).sum()),
        }
        for name, errors in means.items()
    }


def by_age(answers: Answers, sequences: list[KnownSequence]) -> dict[str, Any]:
    """Age of the network's window, as "0-5" ms -> way -> mean error of these events.

    Windows do not overlap here.
    """
    ages = np.concatenate([ages_us(sequence, None) for sequence in sequences])
    errors = {
        name: np.concatenate(
            [
                endpoint_errors(flow, sequence.true)
                for flow, sequence in zip(flows, sequences, strict=True)
            ]
        )
        for name, flows in answers.items()
    }
    report = {}
    for youngest in range(0, WINDOW_US, AGE_US):
        chosen = (ages >= youngest) & (ages < youngest + AGE_US)
        name = f"{youngest // 1_000}-{(youngest + AGE_US) // 1_000}"
        if chosen.any():
            report[name] = {way: float(values[chosen].mean()) for way, values in errors.items()}
    return report


def where_a_plane_is_found(answers: Answers, sequences: list[KnownSequence]) -> dict[str, Any]:
    """The errors at events where the plane fit finds a plane, over all events together.

    Returns
    -------
    dict : `share` of the events; `error` of the plane fit and of the network with overlapping
        windows; and `along`, the part of these errors along the normal flow, which is all that a
        plane tells.
    """
    plane = np.concatenate(answers[PLANE])
    is_found = np.isfinite(plane[:, 0])
    true = np.concatenate([sequence.true for sequence in sequences])[is_found]
    plane = plane[is_found]
    network = np.concatenate(answers[OVERLAPPING])[is_found]
    normal = plane / np.hypot(*plane.T)[:, None]
    report: dict[str, Any] = {"share": float(is_found.mean())}
    flows = {PLANE: plane, OVERLAPPING: network}
    for part in ("error", "along"):
        report[part] = {}
        for name, flow in flows.items():
            off = flow - true
            size = np.hypot(*off.T) if part == "error" else np.abs((off * normal).sum(1))
            report[part][name] = float(size.mean()) if len(size) else None
    return report
