"""Made tasks, and functions of them that take no model: importable by worker processes."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from async_tnt.archive.job import Job, task_of
from async_tnt.archive.records import failed

JOB = Job("run", "digits", "compiled", {"every_us": 5000}, model_sha256="a" * 64)


def make_tasks(folder: Path, names, job: Job = JOB):
    """A task of each name; the files hold their names."""
    folder.mkdir(exist_ok=True)
    for name in names:
        if not (folder / name).exists():
            (folder / name).write_text(name)
    return [task_of(name, folder / name, job) for name in names]


def record_of(task):
    """A whole record, by the file's content alone, but for the seconds."""
    text = task.path.read_text()
    decision = {
        "time_us": len(text),
        "window_start_us": 0,
        "label": text,
        "probability": 0.5,
        "probabilities": [0.5, 0.5],
        "events": len(text),
        "complete": True,
        "trigger": "window",
    }
    return {
        **failed(task, ""),
        "label": text,
        "probability": 0.25,
        "probabilities": [0.1 + 0.2, 0.75],
        "windows": 1,
        "events": len(text),
        "late": 0,
        "decisions": [decision] * (1 + len(text) % 3),
        "error": None,
        "seconds": time.monotonic(),
    }


def deadly(task):
    """`record_of`, but a file that says `poison` kills its worker, and `once` does so the first time."""
    text = task.path.read_text()
    if text == "once":
        task.path.with_name("seen").touch()  # before: so that a third try would be seen
        mark = task.path.with_name("mark")
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if text == "poison":
        with task.path.with_name("tries").open("a") as file:
            file.write(".")
        os.kill(os.getpid(), signal.SIGKILL)
    return record_of(task)


def slow(task):
    """`record_of` after a while, with its process' number where the tests read it."""
    with task.path.with_name("pids").open("a") as file:
        file.write(f"{os.getpid()} {task.recording}\n")
    time.sleep(0.02)
    return record_of(task)


def long(task):
    """`record_of`, longer than a chunk is to take."""
    time.sleep(0.3)
    return record_of(task)


def double(number):
    return 2 * number


def ends(number):
    """Numbers below 0 end the worker."""
    if number < 0:
        os._exit(3)
    return 2 * number


def unsendable(number):
    return lambda: number


class Odd(Exception):
    """It can be pickled, and not be made again: it wants two arguments."""

    def __init__(self, have, want):
        super().__init__(f"{have}, not {want}")


def odd(number):
    raise Odd(number, 0)


class Unreadable:
    """It can be sent; reading it looks like the end of a pipe."""

    def __init__(self, error):
        self.error = error

    def __reduce__(self):
        return _raise, (self.error,)


def _raise(error):
    raise error


def unreadable(error):
    return Unreadable(error)


def long_in(folder):
    """Longer than any test; its process' number is then in the folder."""
    (folder / f"{os.getpid()}.pid").touch()
    time.sleep(600)


def longs(folder):
    """Two workers that are long in a task, for a program that is killed."""
    from async_tnt.archive.workers import run_all

    list(run_all(long_in, [Path(folder)] * 2, 2))


def shorts():
    """Workers that answer all the time, for a program that is killed."""
    from async_tnt.archive.workers import run_all

    for _ in run_all(double, range(10**6), 2):
        print(end=".", flush=True)


class OnlyHere:
    """It can be sent, and not received."""

    def __reduce__(self):
        return _refuse, ()


def _refuse():
    raise ValueError("only here")
