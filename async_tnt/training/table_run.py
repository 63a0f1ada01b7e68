"""One network of the table: trained, tested, and its result kept in a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.files import write_text
from async_tnt.networks.model import Model
from async_tnt.simulation.moving_mnist import open_set
from async_tnt.training.curves import plot_curves
from async_tnt.training.evaluate import class_probabilities
from async_tnt.training.networks import pipeline_of
from async_tnt.training.pipelines import Pipeline
from async_tnt.training.settings import TrainSettings
from async_tnt.training.table_data import RealData, on_first_saccade, saccade, simulated_windows
from async_tnt.training.table_rows import ROWS, columns_of
from async_tnt.training.train import train
from async_tnt.training.windows import Windows

RESULT = "result.json"


@dataclass(frozen=True)
class Run:
    """Which network: a row, what it is trained on ("all" or "1"), and a seed."""

    row: str
    trained_on: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.row}-{self.trained_on}-seed{self.seed}"


@dataclass
class Tally:
    """Right and all windows, by motion."""

    right: dict[str, int]
    total: dict[str, int]

    def add(self, motion: str, right: np.ndarray) -> None:
        self.right[motion] = self.right.get(motion, 0) + int(right.sum())
        self.total[motion] = self.total.get(motion, 0) + len(right)

    def to_dict(self) -> dict[str, Any]:
        n = sum(self.total.values())
        return {
            "accuracy": sum(self.right.values()) / n,
            "windows": n,
            "per_motion": {motion: self.right[motion] / self.total[motion] for motion in self.total},
        }


def do_run(
    run: Run,
    data: RealData,
    simulated: Path,
    settings: TrainSettings,
    folder: Path,
) -> dict[str, Any]:
    """Train and test one network; a result that is there already, by the same settings, is returned.

    Parameters
    ----------
    simulated : a set of `async-tnt simulate`.
    settings : seed and augmentation are the run's and its row's, whatever these say.
    folder : holds a folder for each run: its checkpoint, its history as JSON and, when done, its model, its result
        as JSON and, with matplotlib, its learning curves.

    Raises
    ------
    ValueError : the folder holds this run with other settings or data.
    """
    row = ROWS[run.row]
    settings = replace(settings, seed=run.seed, augmentation=row.augmentation)
    folder = folder / run.name
    training, held_out = data.training, data.held_out
    if run.trained_on == "1":
        training, held_out = on_first_saccade(training), on_first_saccade(held_out)
    # A finished run is quickly gone through: its checkpoint is compared with what is asked for, and is at its end.
    trained = train(row.config, training, held_out, settings, folder)
    tested_on = {"nmnist": data.description, "simulated": open_set(simulated).parameters}
    finished = folder / RESULT
    if finished.exists():
        result: dict[str, Any] = json.loads(finished.read_text(encoding="utf-8"))
        if result["tested_on"] == tested_on:
            return result
    pipeline = pipeline_of(trained.last)
    at_the_end = trained.history[-1]
    columns: dict[str, Any] = {}
    for column in columns_of(run.trained_on):
        tally = Tally({}, {})
        for motion, windows in _tests(column.split("/")[1], data, simulated):
            tally.add(motion, _right(pipeline, windows))
        columns[column] = tally.to_dict()
    result = {
        "row": run.row,
        "trained_on": run.trained_on,
        "seed": run.seed,
        "columns": columns,
        "tested_on": tested_on,
        "validation": {name: at_the_end[name] for name in ("per_window", "validation_loss") if name in at_the_end},
    }
    plot_curves(trained.history, folder / "curves.png")
    Model(row.config, trained.last.weights, trained.last.classes, result).save(folder / "model.safetensors")
    write_text(finished, json.dumps(result, indent=1))
    return result


def _tests(name: str, data: RealData, simulated: Path) -> Iterator[tuple[str, Windows]]:
    """(motion, windows) of what is tested on: "all", "train" or "sim"."""
    if name == "sim":
        yield from simulated_windows(simulated, data.seen_images)
        return
    windows = data.test if name == "all" else data.training
    for k in range(3):
        yield f"saccade {k + 1}", windows[saccade(windows) == k]


def _right(pipeline: Pipeline, windows: Windows) -> np.ndarray:
    if len(windows) == 0:
        return np.zeros(0, bool)
    right: np.ndarray = class_probabilities(pipeline, windows).argmax(1) == windows.labels
    return right
