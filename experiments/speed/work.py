"""What a compiled network computes, read from its program.

The program's layout is that of `async_tnt.kernels.network.program`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from async_tnt import CompiledClassifier, CompiledNetwork
from async_tnt.kernels.network import program as P
from async_tnt.kernels.target import LANES


class StepWork(NamedTuple):
    """What a step computes if all of it is out of date."""

    layer: str
    places: int
    products: int
    """Number of multiplications at each place. A plain sum or mean has none."""


def work_of(network: CompiledClassifier | CompiledNetwork) -> list[tuple[StepWork, int]]:
    """The steps of a network, each with the number of places that the last call computed."""
    program = network.network.program
    weights = network.network.weights
    steps_and_places = []
    for k, layer in enumerate(network.steps):
        record = program[P.FIRST_STEP + k * P.STEP_SIZE :][: P.STEP_SIZE].tolist()
        places = record[P.ROWS] * record[P.COLUMNS]
        steps_and_places.append(
            (StepWork(layer, places, _products(record, weights)), record[P.N_COMPUTED])
        )
    return steps_and_places


def _products(record: list[int], weights: np.ndarray) -> int:
    """The number of multiplications at each place of a step."""
    channels = record[P.OUT_CHANNELS]
    n_runs = record[P.N_RUNS]
    if record[P.KIND] == P.MIX:
        return n_runs * record[P.RUN_LENGTH] * channels * record[P.GROUPS]
    if record[P.KIND] == P.PRODUCT:
        return channels
    if record[P.KIND] != P.SUM:
        return 0
    size = -(-channels // LANES) * LANES  # channels are stored in whole vectors
    taps = weights[record[P.WEIGHTS] :][: n_runs * size].reshape(n_runs, size)[:, :channels]
    # in a plain sum or mean, all weights are equal, and all places share them
    is_plain = record[P.PLACE_WEIGHTS] == 0 and bool((taps == taps[0, 0]).all())
    return 0 if is_plain else n_runs * channels
