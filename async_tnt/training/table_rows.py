"""What the table compares: rows (how events become a network's input) and columns (trained on / tested on).

The thesis' rows are Baseline, TNT and TNT+regress. The others are the streaming landmarks. All rows share the
network, the optimizer and the augmentation, which thins events at random and moves nothing: a network that is
trained on one motion must see no other. Random translations are given to TNT+regress alone, as in the thesis.

`t_max` is the same in all rows: of 2, 3, 4 and 8 the one with the lowest loss on held-out digits of the training motion
(docs/results.md has the numbers); the thesis has B - 1 = 8.

References
----------
Wang 2019, arXiv:1911.12801, the table of N-MNIST and N-MOVING-MNIST: the numbers in `Row.thesis`. "1/train" we read as:
trained on the first motion, tested on all three motions of the training digits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from async_tnt.config import TNTConfig
from async_tnt.training.augment import Augmentation

T_MAX = 2.0
AUGMENTATION = Augmentation(start_ms=0, shift_px=0, rotation_deg=0, scale=0, shear=0, drop=0.3, partial=0)

COLUMNS = {
    "all/all": "trained on all three saccades, tested on all three",
    "1/all": "trained on the first saccade, tested on all three",
    "1/train": "trained on the first saccade, tested on all three of the training digits",
    "all/sim": "trained on all three saccades, tested on 30 simulated motions",
    "1/sim": "trained on the first saccade, tested on 30 simulated motions",
}


@dataclass(frozen=True)
class Row:
    """One way from events to a network's input.

    Parameters
    ----------
    name : for the command line and for files.
    title : for the table.
    config : how events become volumes.
    thesis : the thesis' accuracies in the order of `COLUMNS`; empty where the row is ours.
    augmentation : of the training windows.
    """

    name: str
    title: str
    config: TNTConfig
    thesis: tuple[float, ...] = ()
    augmentation: Augmentation = AUGMENTATION


ROWS = {
    row.name: row
    for row in (
        Row(
            "baseline",
            "Baseline",
            TNTConfig(transform="none", landmark="center"),
            (0.991, 0.437, 0.442, 0.396, 0.207),
        ),
        Row(
            "tnt",
            "TNT (image centre)",
            TNTConfig(landmark="center", t_max=T_MAX),
            (0.981, 0.468, 0.464, 0.592, 0.318),
        ),
        Row(
            "regress",
            "TNT+regress",
            TNTConfig(landmark="regressor", t_max=T_MAX),
            (0.981, 0.485, 0.481, 0.566, 0.324),
            replace(AUGMENTATION, translate_px=4),
        ),
        Row("running", "`running`", TNTConfig(landmark="running", t_max=T_MAX)),
        Row(
            "line",
            "`line`, flow removed, unsigned",
            TNTConfig(landmark="line", remove_flow=True, polarity="unsigned", t_max=T_MAX),
        ),
    )
}
TRAINED_ON = ("all", "1")


def columns_of(trained_on: str) -> tuple[str, ...]:
    """Which columns a network that was trained on `all` or on `1` belongs to."""
    return tuple(column for column in COLUMNS if column.split("/")[0] == trained_on)
