"""Run a function over many tasks, in worker processes of this machine."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from multiprocessing import connection
from typing import Any, TypeVar

from async_tnt.worker import Worker, WorkerEnded

Task = TypeVar("Task")
Result = TypeVar("Result")


def run_all(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    lost: Callable[[Task], Result] | None = None,
) -> Generator[Result]:
    """Yield `function(task)` of each task as it is done, from this many processes; 1: from this one.

    A worker that ends without an answer is replaced, and `lost` makes the result of its task (None: WorkerEnded). An
    error of a task is raised. That, Ctrl-C and closing the generator end all workers in the middle of their tasks.
    """
    if workers == 1:
        yield from map(function, tasks)
        return
    waiting = list(reversed(tasks))
    team: dict[Any, tuple[Worker, Task]] = {}  # by pipe

    def submit(worker: Worker) -> None:
        team[worker.pipe] = worker, waiting.pop()
        worker.submit(function, team[worker.pipe][1])

    try:
        while waiting or team:
            while waiting and len(team) < workers:
                submit(Worker())
            for pipe in connection.wait(list(team)):
                worker, task = team[pipe]
                try:
                    result = worker.result()
                except WorkerEnded:
                    worker.end()
                    if lost is None:
                        raise
                    result = lost(task)
                if waiting and worker.is_running:
                    submit(worker)
                else:
                    worker.end()
                    del team[pipe]
                yield result
    finally:
        for worker, _ in team.values():
            worker.end()
