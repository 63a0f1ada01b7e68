"""What `teach` and `run --teach` share: which models are taught, and what is said of a lesson."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from async_tnt.networks.models.model import Model
from async_tnt.networks.teaching.closed_form import LEAST_RECORDINGS

LIVE_S = 10.0
"""Seconds that are read of a camera or a network stream."""

FEW = 10
"""With fewer recordings the command says that more would help."""

SHOWN = 3
"""The most other classes whose share is told in words."""


def check_teachable(model: Model, name: str) -> None:
    """Refuse a model without statistics of its classes. Others are refused when they are taught."""
    is_of_windows = bool(model.classes) and not model.is_spiking and model.places is None
    if is_of_windows and model.statistics is None:
        raise ValueError(
            f"{name} has no statistics of its classes: train it again, or give recordings of them "
            "to async-tnt teach as --statistics DATASET"
        )


def lesson_lines(name: str, entry: dict[str, Any]) -> Iterator[str]:
    """Yield lines that say what a class was taught from, and how it is confused with others.

    It "takes" the windows of another class that are classified as the taught class.

    Parameters
    ----------
    name : the taught class.
    entry : the record of its lesson, from `record["taught"]` of a model.
    """
    n = entry["recordings"]
    recordings = "1 recording" if n == 1 else f"{n} recordings"
    yield f"{name}: taught from {recordings}, {entry['windows']} windows"
    if n < LEAST_RECORDINGS:
        yield (
            f"  how many are right and how sure it is cannot be told from {n}: give "
            f"{LEAST_RECORDINGS} or more; {FEW} are good"
        )
    else:
        more = f"; {FEW} recordings are good" if n < FEW else ""
        yield f"  {entry['left_out_right']:.0%} right of what was left out in turn{more}"

    shares = sorted(entry["taken"].items(), key=lambda item: -item[1])
    most = ", ".join(f"{share:.1%} of {other}" for other, share in shares[:SHOWN])
    rest = " and less of others" if shares[SHOWN:] else ""
    yield f"  takes, by the statistics, {most}{rest}"
    if "taken_of_nothing" in entry:
        yield f"  and {entry['taken_of_nothing']:.1%} of windows that show none of the classes"
