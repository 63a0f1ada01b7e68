"""Train and test the networks of the table.

Several networks are trained at a time. The result of each network is in two files, `RESULT` and
`RIGHT`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from async_tnt.base.progress import progress
from async_tnt.evaluation.processes import run_all
from async_tnt.training.evaluation import class_probabilities
from async_tnt.training.loop import train
from async_tnt.training.moved_windows import Motions
from async_tnt.training.pipeline import Pipeline, pipeline_of
from async_tnt.training.resynthesis import resynthesize
from async_tnt.training.run_folder import plot_curves
from async_tnt.training.settings import TrainSettings
from async_tnt.training.training_data import TrainingData
from async_tnt.training.windows import Windows
from experiments.digit_data.recordings import CLASSES, SACCADE_US, saccade
from experiments.moving_set.manifest import MovingMnist
from experiments.records.files import read_json, result_of, write_result
from experiments.speed.timing import machine
from experiments.thesis.data import RealData, RealFolder, scaled, simulated_windows, trained_on
from experiments.thesis.right import packed
from experiments.thesis.rows import COLUMNS, ROWS, Run
from experiments.thesis.versions import with_versions

RESULT = "result.json"
"""File with the result, in the folder of a network."""

VALIDATION = ("per_window", "validation_loss", "motions_per_window", "motions_validation_loss")
"""Entries of the last epoch that the result keeps."""

HISTORY = ("iterations", "loss", "per_window", "validation_loss")
"""Entries of each epoch that the result keeps."""

MOMENTS_MS = (10, 20, 30, 50, 75)
"""Times since the start of a window at which networks are tested, besides the window's end."""

EARLY = ("1/others", "1/sim", "all/sim")
"""Columns of unseen motions that are tested at `MOMENTS_MS`."""


def run_networks(
    runs: list[Run],
    real: RealFolder,
    simulated: dict[str, MovingMnist],
    settings: TrainSettings,
    folder: Path,
    workers: int,
    command: str,
    into: Path | None = None,
) -> list[dict[str, Any]]:
    """The results of `run_network` for each of `runs`, in `workers` processes of one thread each.

    With one worker, the networks are trained in this process.

    Parameters
    ----------
    command : command that makes these results.
    into : folder for a copy of each result, as soon as it is there.

    Raises
    ------
    ValueError, OSError : `run_network` raises them.
    ChildProcessError : a worker was killed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The motions are made before the networks are trained, so that all workers make the motions of
    # one row together. `run_network` then finds their files. Motions do not depend on the seed, so
    # the first run of a row stands for all its seeds.
    first_runs: dict[tuple[str, str], Run] = {}
    for run in runs:
        first_runs.setdefault((run.row, run.trained_on), run)
    for run in first_runs.values():
        make_motions(run, real.read(), settings_of(run, settings), folder, workers)
    task = partial(
        _run_task,
        real=real,
        simulated=simulated,
        settings=settings,
        folder=folder,
        command=command,
    )
    finished_results = []
    with (
        progress(len(runs), "training networks") as bar,
        contextlib.closing(run_all(task, runs, workers)) as results,
    ):
        for result in results:
            finished_results.append(result)
            if into is not None:
                write_result(into / f"{run_of(result).name}.json", result)
            bar.update()
    return finished_results


def _run_task(
    run: Run,
    *,
    real: RealFolder,
    simulated: dict[str, MovingMnist],
    settings: TrainSettings,
    folder: Path,
    command: str,
) -> dict[str, Any]:
    # one thread is enough, because each core trains a network
    torch.set_num_threads(1)
    return run_network(run, real.read(), simulated, settings, folder, command)


def run_of(result: dict[str, Any]) -> Run:
    """The network that a result belongs to."""
    numbers = result["numbers"]
    return Run(numbers["row"], numbers["trained_on"], numbers["seed"])


def run_network(
    run: Run,
    data: RealData,
    simulated: Mapping[str, MovingMnist],
    settings: TrainSettings,
    folder: Path,
    command: str,
) -> dict[str, Any]:
    """Train and test one network, or return an earlier result that was made with its settings.

    The result is one of `records.files`: its numbers, and the run that made them.

    Parameters
    ----------
    simulated : the simulated sets of `rows.SETS`, by name.
    settings : settings of the training. The seed is that of the run, and the augmentation that of
        its row. If the settings have no number of iterations, that is of the row, too.
    folder : holds a folder for each run. A run's folder has its checkpoint and its history as JSON.
        When the run is done, it also has its model, its result as JSON and, with matplotlib, its
        learning curves.
    command : command that makes the result.

    Raises
    ------
    ValueError : the folder holds this run with other settings or data.
    """
    row = ROWS[run.row]
    settings = settings_of(run, settings)
    training = trained_on(data.training, run.trained_on)
    held_out = trained_on(data.held_out, run.trained_on)
    if row.is_scaled:
        training = scaled(training)
        held_out = scaled(held_out)
    if row.versions:
        training = with_versions(training, row.versions, row.config.sensor, SACCADE_US)
    motions = make_motions(run, data, settings, folder)
    folder = folder / run.name
    # For a finished run with these settings this is quick, because its checkpoint is that of the
    # last epoch.
    training_data = TrainingData(row.config, CLASSES, training, held_out)
    trained = train(training_data, settings, folder, motions=motions)

    tested_on = _tests_of(run, data, simulated) if row.is_tested else {}
    columns: dict[str, Any] = {}
    result_path = folder / RESULT
    if result_path.exists():
        earlier_result = read_json(result_path)
        earlier_tests = earlier_result["numbers"]["tested_on"]
        if earlier_tests == tested_on:
            return earlier_result
        # other test data have come: what was tested already is not tested again
        columns = {
            column: part
            for column, part in earlier_result["numbers"]["columns"].items()
            if earlier_tests[column] == tested_on.get(column)
        }

    pipeline = pipeline_of(trained.model)
    for column in tested_on:
        if column not in columns:
            moments = MOMENTS_MS if column in EARLY and not row.is_scaled else ()
            test = column.split("/")[1]
            columns[column] = _tested(pipeline, test, data, simulated, row.is_scaled, moments)

    last_epoch = trained.history[-1]
    numbers = {
        "row": run.row,
        "trained_on": run.trained_on,
        "seed": run.seed,
        "columns": columns,
        "data": data.description,
        "tested_on": tested_on,
        "validation": {name: last_epoch[name] for name in VALIDATION if name in last_epoch},
        "history": [
            {name: round(epoch[name], 6) for name in HISTORY if name in epoch}
            for epoch in trained.history
        ],
        "motions": None if motions is None else motions.record,
        "settings": {name: value for name, value in asdict(settings).items() if name != "seed"},
        "config": row.config.to_dict(),
        "versions": row.versions,
        "is_scaled": row.is_scaled,
        "machine": machine("torch"),
    }
    plot_curves(trained.history, folder / "curves.png")
    result = result_of(numbers, command)
    replace(trained.model, record=result["numbers"]).save(folder / "model.safetensors")
    # this file is written last, because it says that the run is finished
    write_result(result_path, result)
    return result


def _tests_of(run: Run, data: RealData, simulated: Mapping[str, MovingMnist]) -> dict[str, str]:
    """The columns in which a network is tested, with a digest of the test data of each."""
    tests = {
        column: _digest(data.description)
        for column in COLUMNS
        if column.split("/")[0] == run.trained_on
    }
    for name, simulated_set in simulated.items():
        tests[f"{run.trained_on}/{name}"] = _digest(simulated_set.parameters)
    return tests


def _digest(description: dict[str, Any]) -> str:
    """A short digest of a description of test data, which tells data apart."""
    return hashlib.sha256(json.dumps(description, sort_keys=True).encode()).hexdigest()[:16]


def settings_of(run: Run, settings: TrainSettings) -> TrainSettings:
    """The full settings of a network's training: `settings` with the run's seed and row."""
    row = ROWS[run.row]
    iterations = settings.iterations or row.iterations
    return replace(settings, seed=run.seed, augmentation=row.augmentation, iterations=iterations)


def make_motions(
    run: Run, data: RealData, settings: TrainSettings, folder: Path, workers: int = 1
) -> Motions | None:
    """Re-synthesize the motions of a run's windows. Files that exist are not made again.

    Rows and seeds with the same settings share the files. The result is None for a row without
    re-synthesis.
    """
    row = ROWS[run.row]
    if row.motions is None:
        return None
    training = trained_on(data.training, run.trained_on)
    held_out = trained_on(data.held_out, run.trained_on)
    motion_settings = row.motions.for_epochs(settings.n_epochs(len(training)))
    return resynthesize(
        training,
        held_out,
        row.config,
        motion_settings,
        folder / f"motions-{run.trained_on}",
        workers=workers,
        progress=progress,
    )


def _tested(
    pipeline: Pipeline,
    test: str,
    data: RealData,
    simulated: Mapping[str, MovingMnist],
    is_scaled: bool,
    moments_ms: tuple[int, ...],
) -> dict[str, Any]:
    """The result of one test: accuracies over all windows, by motion and by time, and "right".

    "right" says which windows are right, (motions, recordings or images), see `right.packed`.
    """
    parts = []
    early_counts = {ms: [0, 0] for ms in moments_ms}
    for motion, windows in _windows(test, data, simulated):
        names = [windows.recordings.names[index] for index in windows.recording]
        tested = scaled(windows) if is_scaled else windows
        parts.append((motion, names, _right(pipeline, tested)))
        for ms, counts in early_counts.items():
            is_right_early = _right(pipeline, tested, until_us=1_000 * ms)
            counts[0] += int(is_right_early.sum())
            counts[1] += len(is_right_early)
    # a motion may come in several parts
    motions = list(dict.fromkeys(motion for motion, *_ in parts))
    all_names = sorted({name for _, names, _ in parts for name in names})
    columns = {name: i for i, name in enumerate(all_names)}
    right = np.full((len(motions), len(all_names)), -1, np.int8)
    for motion, names, is_right in parts:
        right[motions.index(motion), [columns[name] for name in names]] = is_right
    return {
        "accuracy": float(right[right >= 0].mean()),
        "windows": int((right >= 0).sum()),
        "per_motion": {
            motion: round(float(motion_right[motion_right >= 0].mean()), 5)
            for motion, motion_right in zip(motions, right, strict=True)
        },
        "against_time_ms": {str(ms): n_right / n for ms, (n_right, n) in early_counts.items()},
        "right": packed(right),
    }


def _windows(
    test: str, data: RealData, simulated: Mapping[str, MovingMnist]
) -> Iterator[tuple[str, Windows]]:
    """Pairs (motion, windows) of test data.

    The data are "all", "others" (saccades 2 and 3), "train", or a simulated set.
    """
    if test in simulated:
        yield from simulated_windows(simulated[test])
        return
    windows = data.training if test == "train" else data.test
    for k in (1, 2) if test == "others" else (0, 1, 2):
        yield f"saccade {k + 1}", windows[saccade(windows) == k]


def _right(pipeline: Pipeline, windows: Windows, until_us: int | None = None) -> np.ndarray:
    """Whether each window is right. With `until_us`, only its events until then are used."""
    probabilities = class_probabilities(pipeline, windows, until_us=until_us)
    right: np.ndarray = probabilities.argmax(1) == windows.labels
    return right
