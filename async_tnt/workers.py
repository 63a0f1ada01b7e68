"""Run a function over many tasks on several cores, in processes that end when their parent does.

Processes are spawned, not forked: Numba's and the caller's threads do not survive a fork.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


def available_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_all(function: Callable[[Task], Result], tasks: Sequence[Task], workers: int) -> Generator[Result]:
    """Results of `function(task)`, in the order they are done.

    With one worker the calling process does the work itself. With more, `function` must be importable and
    tasks and results be picklable. An error in a task, Ctrl-C, or closing the iterator stops the workers at
    once, in the middle of their tasks; so does the end of the calling process, kill -9 included.

    Raises
    ------
    ChildProcessError : a worker ended without an answer.
    """
    workers = min(workers, len(tasks))
    if workers <= 1:
        yield from map(function, tasks)
        return
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)
    try:
        with _interrupt_ignored():
            futures = [executor.submit(function, task) for task in tasks]
        for future in as_completed(futures):
            yield future.result()
    except BaseException as error:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        if isinstance(error, BrokenProcessPool):
            raise ChildProcessError(
                "a worker process ended without an answer: killed, out of memory, or started from a script without "
                'the line `if __name__ == "__main__":`'
            ) from error
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """In a worker: leave Ctrl-C to the parent, and end when the parent does, whatever ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    # Without this, workers of a killed parent would wait for ever: each holds both ends of the queue of tasks.
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def _interrupt_ignored() -> Iterator[None]:
    """Processes spawned meanwhile ignore Ctrl-C from their first instruction on, before `_begin` is reached."""
    if threading.current_thread() is not threading.main_thread():  # only there may handlers be set
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
