"""Where recordings of digits are, and the networks that are trained on some of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.scripts.processes import command

PER_CLASS = (1, 5, 10, 50)
"""Numbers of recordings of the new digit."""

N_DRAWS = 5
"""Draws of the recordings."""

HELD_OUT = 0.2
"""The share of each class that `async-tnt train` holds out: its last recordings by number."""


@dataclass(frozen=True)
class Place:
    """Where the data are, and where models go.

    Parameters
    ----------
    train, test : folders of class folders.
    out : folder of the models.
    options : options of `async-tnt train`.
    per_class : numbers of recordings of the new class.
    """

    train: Path
    test: Path
    out: Path
    options: tuple[str, ...]
    per_class: tuple[int, ...] = PER_CLASS

    @property
    def classes(self) -> list[str]:
        """The names of all classes."""
        return sorted(folder.name for folder in self.train.iterdir() if folder.is_dir())

    def learned(self, name: str) -> list[Path]:
        """The recordings of a class that training learns from: all but the last by number.

        The only recording of a class is learned from.
        """
        files = files_of(self.train / name)
        if len(files) == 1:
            return files
        return files[: len(files) - max(1, round(HELD_OUT * len(files)))]

    def held_out(self, name: str) -> list[Path]:
        """The other recordings of the training part."""
        return files_of(self.train / name)[len(self.learned(name)) :]

    def drawn(self, name: str, k: int, draw: int) -> list[Path]:
        """k recordings of a class, those of a draw."""
        files = self.learned(name)
        chosen = np.random.default_rng((draw, k)).choice(len(files), min(k, len(files)), False)
        return [files[i] for i in sorted(chosen.tolist())]


def files_of(folder: Path) -> list[Path]:
    """The recordings in a folder, by their numbers."""
    files = [path for path in folder.iterdir() if path.suffix in (".bin", ".npy", ".npz")]
    return sorted(files, key=lambda path: (path.stem.zfill(9), path.name))


def train(place: Place, name: str, extra: Mapping[str, Sequence[Path]]) -> Path:
    """The model that `async-tnt train` makes of the classes without `name`, and of `extra`.

    extra : class -> recordings that are learned from, too.
    """
    label = f"without{name}" + "".join(f"-{len(files)}" for files in extra.values())
    folder = place.out / label
    for other in place.classes:
        if other != name:
            link(folder / other, place.train / other)
    for new, files in extra.items():
        for file in files:
            link(folder / new / file.name, file)
    model = place.out / f"{label}.safetensors"
    command("train", folder, *place.options, "--out", model, "--json")
    return model


def link(name: Path, target: Path) -> None:
    """Make a link to a file or a folder, if it is not there yet."""
    name.parent.mkdir(parents=True, exist_ok=True)
    if not name.exists():
        name.symlink_to(target.resolve())
