"""The networks of the table: trained and tested, several at a time, each with its result in a file."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from async_tnt.evaluation.processes import run_all
from async_tnt.files import write_text
from async_tnt.progress import progress
from async_tnt.training.evaluation import class_probabilities
from async_tnt.training.loop import train
from async_tnt.training.moved_windows import Motions
from async_tnt.training.pipeline import Pipeline, pipeline_of
from async_tnt.training.resynthesis import resynthesize
from async_tnt.training.run_folder import plot_curves
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows
from experiments.digits_data import CLASSES, saccade
from experiments.moving_mnist_set import open_set
from experiments.table_data import (
    RealData,
    RealFolder,
    simulated_windows,
    some_recordings,
    trained_on,
)
from experiments.table_rows import COLUMNS, ROWS, Run

RESULT = "result.json"
VALIDATION = ("per_window", "validation_loss", "motions_per_window", "motions_validation_loss")


def run_networks(
    runs: list[Run],
    real: RealFolder,
    simulated: dict[str, Path],
    settings: TrainSettings,
    folder: Path,
    workers: int,
) -> list[dict[str, Any]]:
    """`run_network` for each of `runs`, in `workers` processes of one thread each; with one worker, in this process.

    Raises
    ------
    ValueError, OSError : as `run_network`. ChildProcessError : a worker was killed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for row, on in dict.fromkeys((run.row, run.trained_on) for run in runs):  # by all workers together
        motions_of(row, on, real.read(), settings_of(Run(row, on, 0), settings), folder, workers)
    task = partial(_run_task, real=real, simulated=simulated, settings=settings, folder=folder)
    done = []
    with progress(len(runs), "training networks") as bar, contextlib.closing(run_all(task, runs, workers)) as results:
        for result in results:
            done.append(result)
            bar.update()
    return done


def _run_task(
    run: Run, *, real: RealFolder, simulated: dict[str, Path], settings: TrainSettings, folder: Path
) -> dict[str, Any]:
    torch.set_num_threads(1)  # the cores have a network each
    return run_network(run, real.read(), simulated, settings, folder)


def run_network(
    run: Run, data: RealData, simulated: dict[str, Path], settings: TrainSettings, folder: Path
) -> dict[str, Any]:
    """Train and test one network, or return the result that is there already, if its settings are the same.

    A network that was tested on other sets is tested again, and not trained again.

    Parameters
    ----------
    simulated : name -> a set of `python -m experiments.moving_mnist`.
    settings : without seed and augmentation, which are the run's and its row's; without iterations: its row's.
    folder : holds a folder for each run: its checkpoint, its history as JSON and, when done, its model, its result
        as JSON and, with matplotlib, its learning curves.

    Raises
    ------
    ValueError : the folder holds this run with other settings or data.
    """
    row = ROWS[run.row]
    settings = settings_of(run, settings)
    training, held_out = (trained_on(windows, run.trained_on) for windows in (data.training, data.held_out))
    if row.recordings is not None:
        training = some_recordings(training, row.recordings)
    motions = motions_of(run.row, run.trained_on, data, settings, folder)
    folder = folder / run.name
    # quick for a finished run: its checkpoint, if it has these settings, is at the end
    trained = train(row.config, training, held_out, settings, folder, classes=CLASSES, motions=motions)
    tests = {name: data.description for name in ("all", "others", "train")}
    tests |= {name: open_set(path).parameters for name, path in simulated.items()}
    tested_on = {
        f"{run.trained_on}/{test}": what
        for test, what in tests.items()
        if (f"{run.trained_on}/{test}" in COLUMNS or test in simulated)
        and not (test == "train" and row.recordings is not None)  # not those that were left out
    }
    finished = folder / RESULT
    before = json.loads(finished.read_text(encoding="utf-8")) if finished.exists() else {"tested_on": {}}
    if before["tested_on"] == tested_on:
        return dict(before)
    pipeline = pipeline_of(trained.model)
    last_epoch = trained.history[-1]
    columns: dict[str, Any] = {}
    for column, what in tested_on.items():
        if before["tested_on"].get(column) == what:
            columns[column] = before["columns"][column]
            continue
        right: dict[str, list[np.ndarray]] = {}
        for motion, windows in _tests(column.split("/")[1], data, simulated):  # a motion may come in several parts
            right.setdefault(motion, []).append(_right(pipeline, windows))
        of_motion = {motion: np.concatenate(parts) for motion, parts in right.items()}
        columns[column] = {
            "accuracy": float(np.concatenate(list(of_motion.values())).mean()),
            "windows": sum(map(len, of_motion.values())),
            "per_motion": {motion: float(of_one.mean()) for motion, of_one in of_motion.items()},
        }
    result = {
        "row": run.row,
        "trained_on": run.trained_on,
        "seed": run.seed,
        "columns": columns,
        "tested_on": tested_on,
        "validation": {name: last_epoch[name] for name in VALIDATION if name in last_epoch},
        "motions": None if motions is None else motions.record,
    }
    plot_curves(trained.history, folder / "curves.png")
    replace(trained.model, record=result).save(folder / "model.safetensors")
    write_text(finished, json.dumps(result, indent=1))
    return result


def settings_of(run: Run, settings: TrainSettings) -> TrainSettings:
    """How a network is trained, in full."""
    row = ROWS[run.row]
    iterations = settings.iterations or row.iterations
    return replace(settings, seed=run.seed, augmentation=row.augmentation, iterations=iterations)


def motions_of(
    row: str, on: str, data: RealData, settings: TrainSettings, folder: Path, workers: int = 1
) -> Motions | None:
    """Other motions of a row's training windows; rows and seeds with the same settings share them."""
    config, motions = ROWS[row].config, ROWS[row].motions
    if motions is None:
        return None
    training, held_out = (trained_on(windows, on) for windows in (data.training, data.held_out))
    motions = motions.for_epochs(settings.n_epochs(len(training)))
    return resynthesize(
        training, held_out, config, motions, folder / f"motions-{on}", workers=workers, progress=progress
    )


def _tests(name: str, data: RealData, simulated: dict[str, Path]) -> Iterator[tuple[str, Windows]]:
    """(motion, windows) of the test data "all", "others" (saccades 2 and 3), "train", or of a simulated set."""
    if name in simulated:
        yield from simulated_windows(simulated[name], data.seen_images)
        return
    windows = data.training if name == "train" else data.test
    for k in (1, 2) if name == "others" else (0, 1, 2):
        yield f"saccade {k + 1}", windows[saccade(windows) == k]


def _right(pipeline: Pipeline, windows: Windows) -> np.ndarray:
    if len(windows) == 0:
        return np.zeros(0, bool)
    right: np.ndarray = class_probabilities(pipeline, windows).argmax(1) == windows.labels
    return right
