"""What a compiled network computes, read from its program.

The program's layout is that of `async_tnt.kernels.network.program`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from async_tnt import CompiledClassifier
from async_tnt.kernels.network import program as P
from async_tnt.kernels.target import LANES


class StepWork(NamedTuple):
    """What a step computes, at most."""

    layer: str
    places: int
    products: int
    """Multiplications at each place; none of a plain sum or mean."""


def work_of(network: CompiledClassifier) -> list[tuple[StepWork, int]]:
    """The network's steps, and how many places of each the last call computed."""
    program = network.network.program
    weights = network.network.weights
    found = []
    for k, layer in enumerate(network.steps):
        record = program[P.FIRST_STEP + k * P.STEP_SIZE :][: P.STEP_SIZE].tolist()
        places = record[P.ROWS] * record[P.COLUMNS]
        found.append((StepWork(layer, places, _products(record, weights)), record[P.N_COMPUTED]))
    return found


def _products(record: list[int], weights: np.ndarray) -> int:
    """Multiplications at each place of a step."""
    channels = record[P.OUT_CHANNELS]
    n_runs = record[P.N_RUNS]
    if record[P.KIND] == P.MIX:
        return n_runs * record[P.RUN_LENGTH] * channels * record[P.GROUPS]
    if record[P.KIND] != P.SUM:
        return 0
    size = -(-channels // LANES) * LANES
    taps = weights[record[P.WEIGHTS] :][: n_runs * size].reshape(n_runs, size)[:, :channels]
    is_plain = record[P.PLACE_WEIGHTS] == 0 and bool((taps == taps[0, 0]).all())
    return 0 if is_plain else n_runs * channels
