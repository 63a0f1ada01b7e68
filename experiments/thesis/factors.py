"""Which properties of a motion the gain of the transform depends on.

The simulated sets are a factorial experiment: eight sets and three distances are all combinations
of four factors. The gain is the accuracy of a row minus that of the Baseline. The effect of a
factor is the gain at its high level minus the gain at its low level, as a mean over all other
factors. The levels of the distance are 8 px and 3 px. The effect of two factors together is half of
the difference that one factor makes to the effect of the other.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.motions.kinds import DISTANCES_PX, FROM_CENTRE, motions_of
from experiments.thesis.numbers import Right, holm, interval, shares
from experiments.thesis.rows import SETS


def _level(is_high: bool) -> int:
    return 1 if is_high else -1


FACTORS: dict[str, Callable[[str, bool, int], int]] = {
    "bright on dark, not dark on bright": lambda kind, dark, px: _level(not dark),
    "from the centre, not through it": lambda kind, dark, px: _level(kind.endswith(FROM_CENTRE)),
    "speed of a saccade, not constant": lambda kind, dark, px: _level(kind.startswith("bell")),
    "8 px, not 3 px": lambda kind, dark, px: {3: -1, 5: 0, 8: 1}[px],
}
"""Factor -> function of a set's motions, its darkness and a distance that gives the factor's level.

The level is -1 or 1, or 0 if the distance is not compared."""

GAINS = tuple(itertools.product(("all", "1"), ("thesis-tnt", "thesis-regress")))
"""Gains that are studied: what is trained on, and the row."""

AGAINST = "thesis-baseline"
"""The row whose accuracy is subtracted in a gain."""


def effects(right: Right) -> list[dict[str, Any]]:
    """The mean gain of each of `GAINS`, and the effect of each factor and pair of factors.

    A gain is left out if fewer than two seeds have all of its networks.

    Returns
    -------
    Dictionaries with "trained_on", "row", "against", "effect" (a factor, a pair of factors, or
    "mean"), "seeds", and what `numbers.interval` and `numbers.holm` give.
    """
    sets = [name for name, (kind, _) in SETS.items() if kind != "beyond"]
    cells = list(itertools.product(sets, DISTANCES_PX))
    levels: dict[str, np.ndarray] = {}  # shape (cells,)
    for factor, level_of in FACTORS.items():
        levels[factor] = np.array([level_of(*SETS[name], px) for name, px in cells])
    for first, second in itertools.combinations(FACTORS, 2):
        levels[f"{first} and {second}"] = levels[first] * levels[second]
    results: list[dict[str, Any]] = []
    for trained_on, row in GAINS:
        columns = [(name, f"{trained_on}/{tested}") for name in (row, AGAINST) for tested in sets]
        seeds = set.intersection(*(set(right.get(column, {})) for column in columns))
        if len(seeds) < 2:
            continue
        gains_of_cells = []
        for name, px in cells:
            column = f"{trained_on}/{name}"
            gains_of_cells.append([_gain(right, row, column, px, seed) for seed in sorted(seeds)])
        gains = np.stack(gains_of_cells)  # (cells, seeds, digits)
        names = {"trained_on": trained_on, "row": row, "against": AGAINST, "seeds": len(seeds)}
        results.append({**names, "effect": "mean", **interval(gains.mean(0))})
        for effect, level in levels.items():
            # the mean gain at level 1 minus that at level -1, (seeds, digits)
            contrast = np.tensordot(level / np.sum(level == 1), gains, 1)
            results.append({**names, "effect": effect, **interval(contrast)})
    for result, p in zip(results, holm([result["p"] for result in results]), strict=True):
        result["holm"] = p
    return results


def _gain(right: Right, row: str, column: str, px: int, seed: int) -> np.ndarray:
    """The gain of a row for each digit, over the motions of one distance."""
    # motions have the same order in every set
    motions = [motion.index for motion in motions_of() if motion.distance_px == px]
    share = shares(right[row, column][seed][motions])
    share_against = shares(right[AGAINST, column][seed][motions])
    gain: np.ndarray = share - share_against
    return gain
