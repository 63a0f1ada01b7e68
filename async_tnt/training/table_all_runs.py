"""The table's networks, several at a time, with a bar that counts their iterations."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from async_tnt.archive.executor import run_all
from async_tnt.progress import progress
from async_tnt.training.settings import TrainSettings
from async_tnt.training.table_data import RealFolder
from async_tnt.training.table_run import Run, do_run

POLL_S = 2.0


@dataclass(frozen=True)
class _Task:
    run: Run
    real: RealFolder
    simulated: Path
    settings: TrainSettings
    folder: Path


def do_runs(
    runs: list[Run], real: RealFolder, simulated: Path, settings: TrainSettings, folder: Path, workers: int
) -> list[dict[str, Any]]:
    """`run.do_run` for each of `runs`, in so many processes of one thread each; with one worker, in this process.

    Raises
    ------
    ValueError, OSError : as `do_run`. ChildProcessError : a worker was killed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tasks = [_Task(run, real, simulated, settings, folder) for run in runs]
    results = []
    with _watched(runs, folder, settings), contextlib.closing(run_all(_do, tasks, workers)) as done:
        for result in done:
            results.append(result)
    return results


def _do(task: _Task) -> dict[str, Any]:
    import torch

    torch.set_num_threads(1)  # the cores have a network each
    return do_run(task.run, task.real.read(), task.simulated, task.settings, task.folder)


@contextlib.contextmanager
def _watched(runs: list[Run], folder: Path, settings: TrainSettings) -> Iterator[None]:
    """A progress bar, fed from the histories that the runs write."""
    ended = threading.Event()
    with progress(len(runs) * (settings.iterations or 0), f"{len(runs)} networks") as bar:

        def watch() -> None:
            before = 0
            while not ended.wait(POLL_S):
                now = sum(_iterations(folder / run.name / "history.json") for run in runs)
                bar.update(now - before)
                before = now

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            ended.set()
            watcher.join()


def _iterations(history: Path) -> int:
    try:
        return int(json.loads(history.read_text(encoding="utf-8"))["history"][-1]["iterations"])
    except (OSError, ValueError, LookupError):  # not begun yet
        return 0
