"""Run a function over many tasks, in several processes of this machine or of a Dask cluster."""

from __future__ import annotations

import contextlib
import itertools
import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from multiprocessing import connection
from typing import Any, TypeVar

from async_tnt.base.extras import needs_extra
from async_tnt.base.messages import one_line
from async_tnt.base.progress import Bar
from async_tnt.base.worker import Worker, WorkerEnded

Task = TypeVar("Task")
Result = TypeVar("Result")

CONNECT_S = 10.0
"""Seconds within which Dask's scheduler must answer."""
WORKERS_S = 15.0
"""Seconds within which the scheduler's first worker must appear."""
IN_FLIGHT = 1000
"""Number of tasks that the cluster has at a time. A task counts until its result is fetched."""


def run_all(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    lost: Callable[[Task], Result] | None = None,
) -> Generator[Result]:
    """Yield `function(task)` of each task as soon as it is done.

    If a task raises an error, the generator raises it. An error, Ctrl-C, and closing the generator
    end all workers, even in the middle of their tasks.

    Parameters
    ----------
    function, tasks : what is run; both must be picklable if there are several workers.
    workers : number of processes; with 1 the tasks run in this process.
    lost : makes the result of a task whose worker ended without an answer. The worker is replaced.
        None: raise WorkerEnded instead.
    """
    if workers == 1:
        yield from map(function, tasks)
        return
    waiting_tasks = list(reversed(tasks))  # `pop` takes the last one
    team: dict[Any, tuple[Worker, Task]] = {}  # the workers and their tasks, by pipe

    def submit(worker: Worker) -> None:
        task = waiting_tasks.pop()
        team[worker.pipe] = (worker, task)
        worker.submit(function, task)

    try:
        while waiting_tasks or team:
            while waiting_tasks and len(team) < workers:
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
                # a worker that has ended leaves the team, and the loop above starts a new one
                if waiting_tasks and worker.is_running:
                    submit(worker)
                else:
                    worker.end()
                    del team[pipe]
                yield result
    finally:
        for worker, _ in team.values():
            worker.end()


def run_counted(
    function: Callable[[Task], int], tasks: Sequence[Task], workers: int, bar: Bar
) -> None:
    """Run a function over many tasks as `run_all` does, and show a progress bar.

    The function returns by how much the bar advances.
    """
    with bar, contextlib.closing(run_all(function, tasks, workers)) as amounts:
        for n in amounts:
            bar.update(n)


def run_on_dask(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    address: str,
    lost: Callable[[Task], Result],
) -> Generator[Result]:
    """Yield `function(task)` of each task as soon as it is done on the workers of a Dask cluster.

    Dask replaces a worker that ends, and repeats its tasks. It gives up a task that has ended
    `distributed.scheduler.allowed-failures` + 1 workers (4 by default), or that was waiting on
    workers that ended. The tasks that were given up are repeated at the end, one at a time. `lost`
    makes the result of a task that is then given up again.

    Parameters
    ----------
    function, tasks : what is run; both must be picklable.
    address : address of the cluster's scheduler.
    lost : makes the result of a task that no worker could finish.

    Raises
    ------
    ImportError : Dask is not installed.
    OSError : no scheduler answers at this address, the scheduler is gone, or it has no workers.
    """
    if not tasks:
        return
    with _connected(address) as client:
        from distributed import KilledWorker, as_completed

        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise ConnectionError(
                f"the Dask cluster at {address} has no workers: start some, with one thread each: "
                f"dask worker {address}"
            ) from None
        waiting_tasks = iter(tasks)
        task_of: dict[str, Task] = {}

        def submit(n: int) -> list[Any]:
            futures = []
            for task in itertools.islice(waiting_tasks, n):
                # without `pure=False`, equal tasks would share a key
                future = client.submit(function, task, pure=False)
                task_of[future.key] = task
                futures.append(future)
            return futures

        given_up_tasks = []
        finished_futures = as_completed(submit(IN_FLIGHT), loop=client.loop)
        for future in finished_futures:
            task = task_of.pop(future.key)
            try:
                yield _result(future, address)
            except KilledWorker:
                given_up_tasks.append(task)
            finished_futures.update(submit(1))
        for task in given_up_tasks:
            try:
                yield _result(client.submit(function, task, pure=False), address)
            except KilledWorker:
                yield lost(task)


def _result(future: Any, address: str) -> Any:
    """The result of a future. If the scheduler at `address` is gone, this raises an OSError."""
    try:
        return future.result()
    except CancelledError:
        raise ConnectionError(
            f"the Dask scheduler at {address} is gone, or has cancelled the work"
        ) from None


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Yield a client of the cluster. It is closed after the block."""
    with needs_extra("cluster", "a cluster needs Dask"):
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
    # Errors become a message of one line. Dask would log them, too, with their tracebacks.
    logging.disable()
    try:
        try:
            # Checks the address first. A client that cannot read the address would complain a
            # second time when Python ends.
            get_address_host_port(address)
            client = Client(address, timeout=CONNECT_S, set_as_default=False, name="async-tnt")
        # The type of the error depends on what is wrong with the address.
        except Exception as error:
            raise ConnectionError(
                f"no Dask scheduler answers at {address!r}; expected the address that "
                f"`dask scheduler` prints, such as tcp://10.0.0.1:8786 ({one_line(error)})"
            ) from None
        with contextlib.closing(client):
            yield client
    finally:
        logging.disable(logging.NOTSET)
