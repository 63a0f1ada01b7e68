"""Interleaved timing of backends: call by call, and in blocks.

In a block, one backend makes many decisions in a row. Call by call, the backends take turns.

Networks of half a megabyte evict one another from the processor's caches. If calls alternate, each
network finds its weights in a slower cache than in a loop of its own. In blocks, each network has
the caches to itself, but a real program does other work between decisions. So both ways are
measured. Compare only numbers of the same way.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from experiments.speed.moments import Moment
from experiments.speed.timing import latency, no_collector, spread

LOGIT_TOLERANCE = 1e-4
"""Largest allowed difference between logits of the same moment. If the largest logit is above 1,
the difference is divided by it."""

N_WARM = 20
"""Number of decisions at the beginning whose logits are compared and whose times are dropped."""


class WorkDiffers(Exception):
    """Two backends computed different results, so comparing their times would be meaningless."""


class Backend(Protocol):
    """An engine whose decisions are timed. It decides at moments in order of time."""

    def prepare(self, moment: Moment) -> None:
        """Prepare the decision at a moment. This is not timed.

        If `moment` has new events, the previous call was for the moment of the previous decision or
        for `moment.before`.
        """

    def decide(self) -> np.ndarray | None:
        """The logits at the prepared moment; None if they cannot be compared. This is timed."""


@dataclass
class Timed:
    """Microseconds of each decision, block by block, and the largest difference of logits."""

    us: dict[str, np.ndarray]
    """Backend -> float64, shape (blocks, decisions of a block)."""
    call_by_call: bool
    largest_difference: float = 0.0

    def report(self) -> dict[str, Any]:
        """The times of each backend, and their ratios to those of the first backend.

        "us" has the `latency` of each backend. "ratio" has the `spread` of its time divided by that
        of the first backend. Ratios are taken for each decision or, if backends ran in blocks, for
        the median of each block.
        """
        first = next(iter(self.us))
        parts = {
            name: us.ravel() if self.call_by_call else np.median(us, axis=1)
            for name, us in self.us.items()
        }
        return {
            "us": {name: latency(us.ravel()) for name, us in self.us.items()},
            "ratio": {
                name: spread(part / parts[first]) for name, part in parts.items() if name != first
            },
            "largest_difference": self.largest_difference,
        }


def compare(
    make: Callable[[bool], Mapping[str, Backend]],
    blocks: Callable[[int, int], Iterable[list[Moment]]],
    n_blocks: int,
    size: int,
) -> dict[str, Any]:
    """Times of backends in both ways, after they were warmed up and compared.

    Parameters
    ----------
    make : makes new backends. It is called with True for call by call, with False for blocks.
        Ratios are to the time of the first backend.
    blocks : see `Moments.blocks`.
    n_blocks, size : number of blocks, and of decisions in each block.

    Returns
    -------
    dict : `call_by_call` and `in_blocks` -> `Timed.report`.

    Raises
    ------
    WorkDiffers : logits of one moment differ by more than LOGIT_TOLERANCE.
    """
    timed(make(True), blocks(1, N_WARM), True)
    return {
        "call_by_call": timed(make(True), blocks(n_blocks, size), True).report(),
        "in_blocks": timed(make(False), blocks(n_blocks, size), False).report(),
    }


def timed(
    backends: Mapping[str, Backend], blocks: Iterable[list[Moment]], call_by_call: bool
) -> Timed:
    """The times of backends that take turns at the moments, in blocks or call by call.

    In blocks, every backend decides at all moments of a block before the next backend does, in
    an order that alternates. Call by call, every backend decides at a moment, then at the next
    moment. The order of the backends is random, with a fixed seed, and new at each moment.
    """
    us: dict[str, list[list[float]]] = {name: [] for name in backends}
    largest_difference = 0.0
    rng = np.random.default_rng(0)
    names = list(backends)
    with no_collector():
        for block in blocks:
            # each turn: number of a moment in the block, and backends that decide at this moment
            if call_by_call:
                turns = [(k, rng.permutation(names).tolist()) for k in range(len(block))]
            else:
                turns = [(k, [name]) for name in names for k in range(len(block))]
                names.reverse()
            for blocks_us in us.values():
                blocks_us.append([])
            logits_at: list[dict[str, np.ndarray]] = [{} for _ in block]
            for k, deciding in turns:
                for name in deciding:
                    _catch_up(backends[name], block[k])
                for name in deciding:
                    taken_us, logits = _time(backends[name], block[k])
                    us[name][-1].append(taken_us)
                    if logits is not None:
                        logits_at[k][name] = logits
            for k, moment in enumerate(block):
                in_order = {name: logits_at[k][name] for name in backends if name in logits_at[k]}
                where = f"event {len(moment.events)} of the window at {moment.start_us} us"
                largest_difference = max(largest_difference, check_logits(in_order, where))
    return Timed(
        {name: np.array(blocks_us) for name, blocks_us in us.items()},
        call_by_call,
        largest_difference,
    )


def _catch_up(backend: Backend, moment: Moment) -> None:
    """Make the decision before this moment's new events, unless the previous call has made it."""
    if not moment.follows:
        backend.prepare(moment.before)
        backend.decide()


def _time(backend: Backend, moment: Moment) -> tuple[float, np.ndarray | None]:
    """Microseconds of a decision, and its logits."""
    backend.prepare(moment)
    started = time.perf_counter()
    logits = backend.decide()
    taken_us = 1e6 * (time.perf_counter() - started)
    return taken_us, None if logits is None else logits.copy()


def check_logits(logits_by_backend: Mapping[str, np.ndarray], where: str) -> float:
    """The largest difference between logits of one moment.

    If the largest logit is above 1, the difference is divided by it.

    where : the moment, for the error.

    Raises
    ------
    WorkDiffers : the difference is more than LOGIT_TOLERANCE.
    """
    if len(logits_by_backend) < 2:
        return 0.0
    (first, expected), *other_logits = logits_by_backend.items()
    scale = max(1.0, float(np.abs(expected).max()))
    differences = {
        name: float(np.abs(logits - expected).max()) / scale for name, logits in other_logits
    }
    name, largest_difference = max(differences.items(), key=lambda item: item[1])
    # `not <=` is also true for nan
    if not largest_difference <= LOGIT_TOLERANCE:
        raise WorkDiffers(
            f"all must give the same logits within {LOGIT_TOLERANCE}, "
            f"got {first} and {name} {largest_difference:.1e} apart at {where}"
        )
    return largest_difference
