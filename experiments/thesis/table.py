"""The table of the thesis' experiment, from the results of its networks.

Each network has a file in `experiments/results/thesis`, with the run that made it. So networks that
were trained on other days and machines stay apart, and the table, the differences of rows and the
effects of factors are computed from all of them whenever a page is written.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from experiments.records.files import RESULTS, read_numbers
from experiments.thesis.factors import effects
from experiments.thesis.numbers import aggregate, differences
from experiments.thesis.right import unpacked

FOLDER = RESULTS / "thesis"
"""Folder of the recorded networks."""


def table_of(networks: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The numbers of all tables, from those of the networks (`runs.run_network`).

    Returns
    -------
    A dict with "table" (see `numbers.aggregate`), "differences" (see `numbers.differences`) and
    "effects" (see `factors.effects`).
    """
    networks = list(networks)
    right: dict[tuple[str, str], dict[int, np.ndarray]] = {}
    for network in networks:
        for column, part in network["columns"].items():
            by_seed = right.setdefault((network["row"], column), {})
            by_seed[network["seed"]] = unpacked(part["right"])
    return {
        "table": aggregate(networks),
        "differences": differences(right),
        "effects": effects(right),
    }


@functools.cache
def recorded_networks(folder: Path = FOLDER) -> tuple[dict[str, Any], ...]:
    """The numbers of the recorded networks."""
    return tuple(read_numbers(path) for path in sorted(folder.glob("*.json")))


@functools.cache
def recorded_table() -> dict[str, Any]:
    """`table_of` all recorded networks."""
    return table_of(recorded_networks())
