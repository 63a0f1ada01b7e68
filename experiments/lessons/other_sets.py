"""Data sets beside N-MNIST of which some classes are left out in turn, and taught."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt.volume.sensor import format_size
from experiments.lessons.place import Place
from experiments.objects import hands


@dataclass(frozen=True)
class OtherSet:
    """A data set, and which of its classes are left out.

    Parameters
    ----------
    title : its name.
    train, test : its folders for training and for tests.
    options : options of `async-tnt train`.
    per_class : numbers of recordings of the new class. Training again learns from the largest one.
    n_left_out : number of classes that are left out in turn, drawn at random; None: all.
    """

    title: str
    train: str
    test: str
    options: tuple[str, ...]
    per_class: tuple[int, ...]
    n_left_out: int | None = None

    def place(self, folder: Path, out: Path) -> Place:
        """Where the data and the models are.

        folder : that of the data set.
        out : folder of the models.
        """
        return Place(folder / self.train, folder / self.test, out, self.options, self.per_class)

    def left_out(self, classes: list[str]) -> list[str]:
        """The classes that are left out in turn."""
        if self.n_left_out is None:
            return classes
        order = np.random.default_rng(0).permutation(len(classes))
        return [classes[i] for i in order[: self.n_left_out]]


OTHER_SETS = {
    "poker": OtherSet("POKER-DVS", "pips_train", "pips_test", ("--sensor", "35x35"), (1, 5, 10)),
    "characters": OtherSet(
        "HOTS' characters", "Train", "Test", ("--sensor", "32x32"), (1,), n_left_out=6
    ),
    "hands": OtherSet(
        "made hands",
        "train",
        "test",
        (
            "--sensor",
            format_size(hands.SENSOR),
            "--window-us",
            str(hands.WINDOW_US),
            "--epochs",
            "25",
        ),
        (1, 5, 10),
        n_left_out=3,
    ),
}
"""Name -> data set. HOTS' characters have one recording of each class to train on."""

HANDS = {"train": 160, "test": 40}
"""Folder of the set `hands` -> number of recordings of each class, in all directions."""


def write_hands(folder: Path, counts: dict[str, int] = HANDS) -> None:
    """Make the set `hands`.

    counts : see `HANDS`.
    """
    for seed, (part, n) in enumerate(counts.items()):
        hands.write(folder / part, n, hands.DIRECTIONS, seed, hands.SESSIONS[0])
