"""Functions for worker processes that need no import of the package's heavy parts."""

import faulthandler
import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path

from async_tnt.evaluation.processes import run_all

SENT_WITHIN_LIMIT = []
"""For each answer of this process: whether the limit of its call was still running."""


def twice(number):
    return 2 * number


def own_process(number):
    return os.getpid()


def note_limits():
    """Note from now on, in this process, whether a call's limit is still running while its answer
    is sent."""
    running = {"limit": False}
    send = Connection.send_bytes
    begin = faulthandler.dump_traceback_later
    end = faulthandler.cancel_dump_traceback_later

    def send_and_note(pipe, answer):
        SENT_WITHIN_LIMIT.append(running["limit"])
        send(pipe, answer)

    def begin_and_note(limit_s, **how):
        begin(limit_s, **how)
        running["limit"] = True

    def end_and_note():
        end()
        running["limit"] = False

    Connection.send_bytes = send_and_note
    faulthandler.dump_traceback_later = begin_and_note
    faulthandler.cancel_dump_traceback_later = end_and_note


def sent_within_limit():
    """What has been noted so far, an answer after the other."""
    return list(SENT_WITHIN_LIMIT)


class OddError(Exception):
    """An error that can be pickled but not unpickled."""

    def __init__(self, have, want):
        super().__init__(f"{have}, not {want}")


def raise_odd(number):
    raise OddError(number, 0)


def answer_with(content):
    """Send these bytes from now on in place of each answer, as a process may that is crashing."""
    Connection.send_bytes = lambda pipe, answer: os.write(pipe.fileno(), content)


def end_itself(number):
    """As if the system had killed this process."""
    os.kill(os.getpid(), signal.SIGKILL)


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
