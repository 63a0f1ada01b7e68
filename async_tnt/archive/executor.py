"""Executors: run a function over many tasks, in this process or in several. `DaskExecutor` is a third one."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple, Protocol, TypeVar

from async_tnt.process import handled_by

Task = TypeVar("Task")
Result = TypeVar("Result")

Lost = Callable[[Task], Result] | None
"""Makes the result of a task that ended two workers; None: such a task is an error."""

POLL_S = 1.0
"""Between two looks at whether a pool has failed without a word."""
STOP_S = 10.0
"""For a killed worker, and the thread that waits for it, to end."""
ENDED = (
    "a worker process ended without an answer: killed, out of memory, or started from a script without the line "
    '`if __name__ == "__main__":`'
)


class Executor(Protocol):
    """Runs a function over many tasks."""

    def run(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], lost: Lost[Task, Result] = None
    ) -> Generator[Result]:
        """Yield `function(task)` of each task, once each, in the order they are done.

        `function` must be importable, and tasks and results must be picklable. An error in a task, Ctrl-C or closing
        the generator stops the workers at once. If a worker ends without an answer (killed, out of memory, crashed),
        its tasks are repeated; `lost` makes the result of a task that ended two workers.
        """
        ...


def executor_of(workers: int = 1) -> Executor:
    """An executor with this many processes; 1 is the calling process."""
    return SerialExecutor() if workers == 1 else ProcessExecutor(workers)


def run_all(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int, lost: Lost[Task, Result] = None
) -> Generator[Result]:
    """Yield `function(task)` of each task from at most this many processes; see `Executor.run`."""
    return executor_of(min(workers, max(1, len(tasks)))).run(function, tasks, lost)


class SerialExecutor:
    """The calling process: a task that crashes ends the program."""

    def run(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], lost: Lost[Task, Result] = None
    ) -> Generator[Result]:
        yield from map(function, tasks)


class ProcessExecutor:
    """Processes of this machine. They end with the calling process, even if it is ended by `kill -9`."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], lost: Lost[Task, Result] = None
    ) -> Generator[Result]:
        """See `Executor.run`.

        Raises
        ------
        ChildProcessError : a task ended two workers and there is no `lost`, or a worker could not start.
        RuntimeError : in place of a task's error that cannot be pickled.
        """
        waiting = deque((task, 0) for task in tasks)
        team = [_Worker(function) for _ in range(min(self.workers, len(tasks)))]
        try:
            while waiting or any(worker.calls for worker in team):
                queued = 1 if len(waiting) <= 2 * len(team) else 2  # the second, so that no worker waits for us
                for n in range(queued):
                    for worker in team:
                        if waiting and len(worker.calls) == n:
                            worker.submit(*waiting.popleft())
                wait([worker.calls[0].future for worker in team if worker.calls], POLL_S, FIRST_COMPLETED)
                for worker in team:
                    while worker.calls and worker.has_answered():
                        call = worker.calls.popleft()
                        try:
                            result = call.future.result()
                        except BrokenProcessPool:
                            if not worker.has_started():
                                raise ChildProcessError(ENDED) from None
                            waiting.extendleft((other.task, other.n_lost) for other in reversed(worker.calls))
                            worker.stop()
                            if not call.n_lost:
                                waiting.appendleft((call.task, 1))
                                continue
                            if lost is None:
                                raise ChildProcessError(ENDED) from None
                            result = lost(call.task)
                        yield result
        finally:
            for worker in team:
                worker.kill()
            for worker in team:
                worker.stop()


class _Call(NamedTuple):
    future: Future[Any]
    task: Any
    n_lost: int
    """Workers that the task has ended."""


class _Worker:
    """A pool of one process: when it breaks, the task that broke it is known, and the other workers continue."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function
        self._pool: ProcessPoolExecutor | None = None
        self.calls: deque[_Call] = deque()
        """The process works on the first of them."""

    def submit(self, task: Any, n_lost: int) -> None:
        pool = self._pool or self._start()
        try:
            future = pool.submit(_call, self._function, task)
        except BrokenProcessPool as error:  # the process has just ended
            future = Future()
            future.set_exception(error)
        self.calls.append(_Call(future, task, n_lost))

    def _start(self) -> ProcessPoolExecutor:
        with _deferred_signals():
            # spawned: threads of Numba and of the caller do not survive a fork
            self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _initialize_worker)
            self._pid = self._pool.submit(os.getpid)
            self._manager: Any = self._pool._executor_manager_thread  # a thread that ends with the process
            # Only the worker writes results. If we also kept the pipe open, the pool would wait forever for the
            # second half of a result whose worker was killed.
            self._pool._result_queue._writer.close()  # type: ignore[attr-defined]
        return self._pool

    def has_started(self) -> bool:
        return self._pid.done() and self._pid.exception() is None

    def has_answered(self) -> bool:
        """Whether the first call has returned or failed."""
        is_over = not self._manager.is_alive()
        future = self.calls[0].future
        if is_over and not future.done():
            # Before Python 3.12.1 a pool that notices the end of its process does not lock out `submit`: a call
            # submitted at that moment is never answered.
            future.set_exception(BrokenProcessPool())
        return future.done()

    def kill(self) -> None:
        """Stop it in the middle of its task."""
        if self._pool is not None:
            for process in list(self._pool._processes.values()):  # `kill_workers` of Python 3.14
                process.kill()

    def stop(self) -> None:
        """End the process, in the middle of its task if it has one. `submit` starts another."""
        if self._pool is not None:
            self.kill()
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._manager.join(STOP_S)  # `shutdown` would wait without an end
            self._pool = None
        self.calls.clear()


def _initialize_worker() -> None:
    """In a worker: leave Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _call(function: Callable[[Task], Result], task: Task) -> Result:
    """In a worker: an error that cannot be pickled would look like the worker's end."""
    try:
        return function(task)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            raise RuntimeError(f"{type(error).__name__}: {error}") from error
        raise


@contextlib.contextmanager
def _deferred_signals() -> Iterator[None]:
    """Handle signals only after the block, in which a process is spawned that ignores Ctrl-C from its start.

    A process whose spawning is interrupted prints a traceback, because its task was never written to its pipe.
    """
    received: list[int] = []
    with handled_by(lambda number, frame: received.append(number)):
        # a spawned process inherits the mask before it can run our code
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if os.name == "posix" else []
        try:
            yield
        finally:
            if os.name == "posix":
                signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
    for number in received:
        signal.raise_signal(number)
