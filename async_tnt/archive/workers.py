"""Run a function over many tasks on several cores, in processes that end when their parent does.

Processes are spawned, not forked: Numba's and the caller's threads do not survive a fork. Each has a pipe of its own
and its tasks in order, so that when one is lost it is known which task it was at.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic, TypeVar

from async_tnt.signals import handled_by

Task = TypeVar("Task")
Result = TypeVar("Result")

TRIES = 2  # of a task whose worker was lost
QUICK_S, AHEAD = 0.05, 3  # a worker whose tasks take less has so many more at hand


def available_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_all(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    *,
    lost: Callable[[Task], Result] | None = None,
) -> Generator[Result]:
    """Results of `function(task)`, in the order they are done.

    With one worker the calling process does the work itself. With more, `function` must be importable and
    tasks and results be picklable. An error in a task, Ctrl-C, or closing the iterator stops the workers at
    once, in the middle of their tasks; so does the end of the calling process, kill -9 included.

    A worker that ends without an answer (killed, out of memory, crashed) is replaced, and its task done again, once.

    Parameters
    ----------
    lost : gives the result of a task that ended two workers; without it, such a task is an error. It has no
        meaning with one worker: what ends the calling process ends it.

    Raises
    ------
    ChildProcessError : a task ended two workers and there is no `lost`, or a worker ended before its first task.
    TypeError : a result cannot be pickled, or not be unpickled. RuntimeError : so it is with an error of a task; this
        one names its type.
    """
    workers = min(workers, len(tasks))
    if workers <= 1:
        yield from map(function, tasks)
        return
    waiting = deque((task, 1) for task in tasks)
    team: list[_Worker[Task, Result]] = []
    try:
        with _signals_wait():
            team += [_Worker(function) for _ in range(workers)]
        while waiting or any(worker.tasks for worker in team):
            for ready in wait([worker.pipe for worker in team]):
                worker = next(worker for worker in team if worker.pipe is ready)
                try:
                    data = worker.pipe.recv_bytes()
                except (EOFError, OSError):
                    team.remove(worker)
                    ended = worker.stop()
                    if not worker.has_begun:
                        raise ChildProcessError(_told(ended)) from None
                    if worker.tasks:
                        task, n_tries = worker.tasks.popleft()  # the one it was at; the others had not begun
                        waiting.extendleft(reversed(worker.tasks))
                        if n_tries < TRIES:
                            waiting.appendleft((task, n_tries + 1))
                        elif lost is None:
                            raise ChildProcessError(_told(ended)) from None
                        else:
                            yield lost(task)
                    if waiting:
                        with _signals_wait():
                            team.append(_Worker(function))
                    continue
                kind, answer = _unpickled(data)
                if kind == "error":
                    raise answer
                worker.has_begun = True
                if kind == "result":
                    worker.answered()
                worker.take_from(waiting, len(team))
                if kind == "result":
                    yield answer
            for worker in team:  # that had nothing to do when a task came back
                if worker.has_begun and not worker.tasks:
                    worker.take_from(waiting, len(team))
    finally:
        for worker in team:
            worker.process.terminate()
        for worker in team:
            worker.stop()


class _Worker(Generic[Task, Result]):
    """A process, the pipe to it, and the tasks in it, each with the number of tries; it is at the first of them."""

    def __init__(self, function: Callable[[Task], Result]) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, function), daemon=True)
        self.tasks: deque[tuple[Task, int]] = deque()
        self.has_begun = False
        self.is_quick = False
        self._since = 0.0
        self.process.start()
        theirs.close()  # else its end would not be seen as the end of the pipe

    def take_from(self, waiting: deque[tuple[Task, int]], n_workers: int) -> None:
        """Give it a task, and where tasks are short and many some more, so that it need not wait for us in between."""
        wanted = 1 + AHEAD if self.is_quick and len(waiting) > AHEAD * n_workers else 1
        while waiting and len(self.tasks) < wanted:
            if not self.tasks:
                self._since = time.monotonic()
            self.tasks.append(waiting.popleft())
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it has just ended: `recv` will tell
                self.pipe.send(self.tasks[-1][0])

    def answered(self) -> None:
        """It is done with the first task."""
        self.tasks.popleft()
        now = time.monotonic()
        self.is_quick = now - self._since < QUICK_S
        self._since = now

    def stop(self) -> int | None:
        self.process.join()
        self.pipe.close()
        return self.process.exitcode


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """In a worker: leave Ctrl-C to the parent, and answer tasks until the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    tasks: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(pipe, tasks), daemon=True).start()
    answer: tuple[str, Any] = ("ready", None)
    while _sent(pipe, answer):
        kind, task = tasks.get()
        if kind == "end":
            return
        answer = kind, task
        if kind == "task":
            try:
                answer = "result", function(task)
            except Exception as error:
                error.add_note(f"in a worker process:\n{traceback.format_exc()}")
                answer = "error", error


def _sent(pipe: Connection, answer: tuple[str, Any]) -> bool:
    """Send an answer, or an error that says why it cannot be; False where the parent is gone."""
    kind, what = answer
    if kind == "error":
        answer = kind, _sendable(what)
    try:
        data = ForkingPickler.dumps(answer)
    except Exception as error:
        told = TypeError(f"a worker's answer cannot be sent: {error}; it was {what!r:.200}")
        data = ForkingPickler.dumps(("error", told))
    try:
        pipe.send_bytes(data)
    except OSError:  # silently: a traceback would be all that is seen of a program that was killed
        return False
    return True


def _sendable(error: Exception) -> Exception:
    """The error, or where its type cannot be made again from its message alone, another that says the same."""
    try:
        again = ForkingPickler.loads(ForkingPickler.dumps(error))
        if type(again) is type(error):
            return error
    except Exception:
        pass
    other = RuntimeError(f"{type(error).__name__}: {error}")
    for note in getattr(error, "__notes__", ()):
        other.add_note(note)
    return other


def _unpickled(data: bytes) -> tuple[str, Any]:
    """An answer. Apart from its arrival: EOFError and OSError of a result are no end of the worker."""
    try:
        return ForkingPickler.loads(data)
    except Exception as error:
        raise TypeError(f"a worker's answer cannot be read: {type(error).__name__}: {error}") from error


def _receive(pipe: Connection, tasks: queue.SimpleQueue[tuple[str, Any]]) -> None:
    """Take tasks off the pipe at once: were both sides to wait until the other reads, they would for ever."""
    while True:
        try:
            data = pipe.recv_bytes()
        except (EOFError, OSError):
            tasks.put(("end", None))
            return
        try:
            tasks.put(("task", ForkingPickler.loads(data)))
        except Exception as error:  # its type is not known here
            tasks.put(("error", error))


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()  # a worker in the middle of a task would not see the end of its pipe
    os._exit(1)


def _told(exitcode: int | None) -> str:
    how = "" if exitcode is None else f" (exit code {exitcode})" if exitcode >= 0 else f" (signal {-exitcode})"
    return (
        f"a worker process ended without an answer{how}: killed, out of memory, or started from a script without "
        'the line `if __name__ == "__main__":`'
    )


@contextlib.contextmanager
def _signals_wait() -> Iterator[None]:
    """Signals that come while processes are spawned are handled afterwards; the processes ignore Ctrl-C.

    A process that was left halfway would complain that what it has to do was never written into its pipe.
    """
    came: list[int] = []
    with handled_by(lambda number, frame: came.append(number)):
        # What is blocked here is blocked there, too, from the first instruction on, before `_work` is reached.
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if os.name == "posix" else []
        try:
            yield
        finally:
            if os.name == "posix":
                signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
    for number in came:
        signal.raise_signal(number)
