"""Functions for worker processes that need no import of the package's heavy parts."""

import os
import time
from pathlib import Path
from types import SimpleNamespace

from async_tnt.base import worker
from async_tnt.evaluation.processes import run_all


def twice(number):
    return 2 * number


TIMERS = []
"""What `note_timers` has noted in this process."""


def note_timers():
    """From now on, only note when a worker sets its time limit (its seconds), and lifts it."""
    worker.faulthandler = SimpleNamespace(
        dump_traceback_later=lambda limit_s, exit: TIMERS.append(limit_s),
        cancel_dump_traceback_later=lambda: TIMERS.append("lifted"),
    )


def noted_timers():
    return list(TIMERS)


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
