"""What to train where nothing is asked for: a few volumes and networks, each for a short time, compared on the held-out
windows, one question after another. The best are then trained for longer, and compared again: what learns fastest, such
as a coarse grid, is not always what learns most.

    volume    the event volume as it is, TNT about the running centroid, or the count image; signed, split or unsigned
    grid      a fine and a coarse one of the sensor's shape
    network   residual, thesis, conv4
    mirror    windows as they are, or half of them mirrored

What was asked for is not a question. The winner of one question goes into the next one. All is drawn from the seed:
the same data and options give the same choice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from operator import attrgetter
from typing import Any

from async_tnt.config import POLARITIES, TNTConfig
from async_tnt.sources.sensor import Sensor, format_size

STEPS, FINAL_STEPS = 600, 1_800
"""Optimizer steps for each candidate, and for each of the best."""
FINALISTS = 3
SIDES = 60, 34
"""The longer side of a grid, fine and coarse."""
NETWORKS = "residual", "thesis", "conv4"
"""The first one tries the volumes: it learns fastest."""
VOLUMES: dict[str, dict[str, Any]] = {
    "none": {"transform": "none", "landmark": "center"},
    "tnt": {"transform": "tnt", "landmark": "running"},
    "count": {"representation": "count", "bins": 1, "transform": "none", "landmark": "center"},
}


@dataclass(frozen=True)
class Candidate:
    """What a trial trains: a volume, a network, and whether windows are also shown mirrored."""

    config: TNTConfig
    network: str
    mirror: bool = False

    def __str__(self) -> str:
        volume = "raw" if self.config.transform == "none" else f"TNT, {self.config.landmark}"
        if self.config.representation != "volume":
            volume = self.config.representation
        mirrored = ", mirrored" if self.mirror else ""
        return f"{volume}, {self.config.polarity}, {format_size(self.config.grid)}, {self.network}{mirrored}"


@dataclass(frozen=True)
class Trial:
    """How well a candidate did after so many steps: share of held-out windows right at any moment, and the loss."""

    candidate: Candidate
    steps: int
    accuracy: float
    loss: float

    @property
    def merit(self) -> tuple[float, float]:
        """The larger, the better."""
        return self.accuracy, -self.loss

    def to_dict(self) -> dict[str, Any]:
        return {"tried": str(self.candidate), "steps": self.steps, "accuracy": self.accuracy, "loss": self.loss}


@dataclass(frozen=True)
class Questions:
    """What is to be chosen."""

    transform: bool = True
    polarity: bool = True
    grid: bool = True
    network: bool = True
    mirror: bool = True

    def __bool__(self) -> bool:
        return any(asdict(self).values())


def choose(start: Candidate, questions: Questions, try_out: Callable[[Candidate, int], Trial | None]) -> list[Trial]:
    """A trial of each candidate, from the worst to the best; of the `FINALISTS` the longer one.

    Parameters
    ----------
    start : answers what is not a question; its grid is replaced by the fine one, and its network by the first of
        `NETWORKS` that can be trained, if these are.
    try_out : trains a candidate for so many steps; None if it cannot be trained on this data.

    Raises
    ------
    ValueError : no candidate can be trained.
    """
    if questions.grid:
        start = replace(start, config=start.config.replace(grid=next(grids(start.config.sensor))))
    tried: dict[Candidate, Trial | None] = {}

    def ask(candidates: Iterator[Candidate]) -> list[Trial]:
        """All trials so far, with these; of equals, the later one is last."""
        for candidate in candidates:
            if candidate not in tried:
                tried[candidate] = try_out(candidate, STEPS)
        return sorted(filter(None, tried.values()), key=attrgetter("merit"))

    for network in NETWORKS if questions.network else (start.network,):
        trials = ask(_volumes(replace(start, network=network), questions))
        if trials:
            break
    else:
        raise ValueError("none of the volumes and networks can be trained on these windows; see `quick`")
    for question in (_grids, _networks, _mirrors):
        trials = ask(question(trials[-1].candidate, questions))
    if len(trials) > 1:
        again = [try_out(trial.candidate, FINAL_STEPS) for trial in trials[-FINALISTS:]]
        trials[-FINALISTS:] = sorted(filter(None, again), key=attrgetter("merit"))
    return trials


def grids(sensor: Sensor) -> Iterator[Sensor]:
    """A fine grid, and a coarse one, in the shape of the sensor; small sensors have one grid, their own pixels.

    No side is below 8, which the networks need.
    """
    longest = max(sensor)
    if longest <= SIDES[1] + 6:
        yield max(8, sensor[0]), max(8, sensor[1])
        return
    for side in (min(SIDES[0], longest), SIDES[1]):
        yield max(8, round(sensor[0] * side / longest)), max(8, round(sensor[1] * side / longest))


def _volumes(best: Candidate, questions: Questions) -> Iterator[Candidate]:
    changes: list[Mapping[str, Any]] = list(VOLUMES.values()) if questions.transform else [{}]
    for volume in changes:
        for polarity in POLARITIES if questions.polarity else (best.config.polarity,):
            yield replace(best, config=best.config.replace(**volume, polarity=polarity))


def _grids(best: Candidate, questions: Questions) -> Iterator[Candidate]:
    for grid in grids(best.config.sensor) if questions.grid else (best.config.grid,):
        yield replace(best, config=best.config.replace(grid=grid))


def _networks(best: Candidate, questions: Questions) -> Iterator[Candidate]:
    for network in NETWORKS if questions.network else (best.network,):
        yield replace(best, network=network)


def _mirrors(best: Candidate, questions: Questions) -> Iterator[Candidate]:
    for mirror in (False, True) if questions.mirror else (best.mirror,):
        yield replace(best, mirror=mirror)
