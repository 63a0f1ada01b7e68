"""What about a motion the gain of the transform depends on: the simulated sets as a factorial
experiment.

Eight sets and three distances are all combinations of four factors. The effect of one is the
difference between its two levels (between 8 and 3 px) in what a row gains over the Baseline, in the
mean over all other factors. Of two together: half of the difference that one makes to the effect of
the other.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.motions.kinds import DISTANCES_PX, motions_of
from experiments.thesis.numbers import Right, holm, interval, shares
from experiments.thesis.rows import SETS

FACTORS: dict[str, Callable[[str, bool, int], int]] = {
    "bright on dark, not dark on bright": lambda kind, dark, px: -1 if dark else 1,
    "from the centre, not through it": lambda kind, dark, px: (
        1 if kind.endswith("from-centre") else -1
    ),
    "speed of a saccade, not constant": lambda kind, dark, px: 1 if kind.startswith("bell") else -1,
    "8 px, not 3 px": lambda kind, dark, px: {3: -1, 5: 0, 8: 1}[px],
}
"""Factor -> its level, -1 or 1, in a set and at a distance; 0: not compared."""
GAINS = tuple(itertools.product(("all", "1"), ("thesis-tnt", "thesis-regress")))
AGAINST = "thesis-baseline"


def effects(right: Right) -> list[dict[str, Any]]:
    """Of each of `GAINS`, where its networks are there: the gain in the mean, and the effect of
    each factor and pair.

    Returns
    -------
    Of each: "trained_on", "row", "against", "effect" (factors, or "mean"), and as in
    `numbers.differences`.
    """
    sets = {name: (kind, dark) for name, (kind, dark) in SETS.items() if kind != "beyond"}
    cells = list(itertools.product(sets, DISTANCES_PX))
    levels = {
        name: np.array([level(*sets[s], px) for s, px in cells]) for name, level in FACTORS.items()
    }
    pairs = {
        " and ".join(pair): levels[pair[0]] * levels[pair[1]]
        for pair in itertools.combinations(levels, 2)
    }
    found: list[dict[str, Any]] = []
    for on, row in GAINS:
        columns = [(name, f"{on}/{s}") for name in (row, AGAINST) for s in sets]
        seeds = set.intersection(*(set(right.get(column, {})) for column in columns))
        if len(seeds) < 2:
            continue
        gains = np.stack(
            [
                [_gain(right, row, f"{on}/{s}", px, seed) for seed in sorted(seeds)]
                for s, px in cells
            ]
        )
        names = {"trained_on": on, "row": row, "against": AGAINST, "seeds": len(seeds)}
        found.append({**names, "effect": "mean", **interval(gains.mean(0))})
        for effect, level in (levels | pairs).items():
            contrast = level / np.sum(level == 1)  # of two together, half of the difference
            found.append({**names, "effect": effect, **interval(np.tensordot(contrast, gains, 1))})
    for effect, p in zip(found, holm([effect["p"] for effect in found]), strict=True):
        effect["holm"] = p
    return found


def _gain(right: Right, row: str, column: str, px: int, seed: int) -> np.ndarray:
    """Of each digit, over the motions of one distance."""
    # of the same order in every set
    motions = [m.index for m in motions_of() if m.distance_px == px]
    return shares(right[row, column][seed][motions]) - shares(right[AGAINST, column][seed][motions])
