"""Tasks on small files, and functions of them that use no model; worker processes import them."""

import os
import signal
import time
from pathlib import Path

from async_tnt.archive.executor import run_all
from async_tnt.archive.job import Job, task_of
from async_tnt.archive.records import evaluate_recording, failed

JOB = Job("run", "digits", "compiled", {"every_us": 5000}, model_sha256="a" * 64)


def make_tasks(folder, names, job=JOB):
    """A task of each name; the files hold their names."""
    folder.mkdir(exist_ok=True)
    for name in names:
        if not (folder / name).exists():
            (folder / name).write_text(name)
    return [task_of(name, folder / name, job) for name in names]


def record_of(task):
    """A complete record, which depends only on the file's content, apart from the seconds."""
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
    """`record_of`, but the file `poison` kills its worker every time, and `once` the first time.

    `begun` in its folder has a line of every recording that was begun.
    """
    begun = task.path.with_name("begun")
    with begun.open("a") as file:
        file.write(f"{task.recording}\n")
    if task.recording == "poison" or (task.recording == "once" and begun.read_text().split().count("once") == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return record_of(task)


def slow(task):
    """`record_of` after a while; `pids` in its folder has a line of its process and recording."""
    with task.path.with_name("pids").open("a") as file:
        file.write(f"{os.getpid()} {task.recording}\n")
    time.sleep(0.02)
    return record_of(task)


def broken(task):
    raise ImportError("no reader of that")


def twice(number):
    return 2 * number


def unpicklable(number):
    return lambda: number


class OddError(Exception):
    """It can be pickled but not unpickled."""

    def __init__(self, have, want):
        super().__init__(f"{have}, not {want}")


def raise_odd(number):
    raise OddError(number, 0)


def sleep_in(folder):
    """Longer than any test; the folder then has a file named by the process."""
    (folder / f"{os.getpid()}.pid").touch()
    time.sleep(3600)


def sleep_or_end(folder_and_end):
    """Sleep; or wait for two that sleep, and return or raise."""
    folder, end = folder_and_end
    if end == "sleep":
        sleep_in(folder)
    while len(list(folder.glob("*.pid"))) < 2:
        time.sleep(0.01)
    if end == "raise":
        raise ZeroDivisionError


def run_sleepers(folder):
    """Two workers in the middle of a task, for a program that is killed."""
    list(run_all(sleep_in, [Path(folder)] * 2, 2))


def run_quick():
    """Workers that answer all the time, for a program that is killed."""
    for _ in run_all(twice, range(10**7), 2):
        print(end=".", flush=True)


def evaluate_or_sleep(task):
    if task.recording.endswith("zz.bin"):
        time.sleep(3600)
    return evaluate_recording(task)
