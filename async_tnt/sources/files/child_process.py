"""The child of a `ChildSource`: `python child_process.py PIPE` reads files as the commands in its standard input say.

A reader is a script beside this one. Its `read(path)` yields the sensor, (width, height) or None, then blocks of
events, each as four columns of numbers: t, x, y, p. It raises an exception where the file cannot be read on.
"""

from __future__ import annotations

import json
import runpy
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import connection
from pathlib import Path

import numpy as np

READ_S = 120  # a block takes milliseconds, but a disk may sleep
MAX_BYTES = 4 << 30  # of addresses; a block takes megabytes, but a damaged file may ask for anything


def main(pipe: int) -> None:
    """Answer commands by the messages that `child_source.py` describes, until there are no more."""
    _limit_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends this process
    # on Windows, pipes have a class of their own
    sender = getattr(connection, "PipeConnection", connection.Connection)(pipe, readable=False)

    def send(message: bytes) -> None:
        _alarm(0)  # the parent may be slow to read
        sender.send_bytes(message)
        _alarm(READ_S)

    for line in sys.stdin.buffer:
        _alarm(READ_S)
        try:
            problem = _answer(send, *json.loads(line))
        except BrokenPipeError:  # the parent has read enough
            return
        except BaseException as error:  # a panic in Rust derives from BaseException alone
            problem = " ".join(str(error).split())[:300] or type(error).__name__
        send(b"")
        send(problem.encode())
        _alarm(0)


def _answer(send: Callable[[bytes], None], what: str, reader: str, path: str) -> str:
    """Send a file's sensor, or its events; returns why it cannot be read on, or ""."""
    read = runpy.run_path(str(Path(__file__).parent / reader))["read"](path)
    sensor = next(read)
    if what == "sensor":
        send(json.dumps(sensor).encode())
        return ""
    for columns in read:
        block, problem = whole_numbers(columns)
        if block.size:  # an empty message would be the end
            send(block.tobytes())
        if problem:
            return problem
    return ""


def whole_numbers(columns: Sequence[np.ndarray]) -> tuple[np.ndarray, str]:
    """The events before the first number that is not whole, and what that is ("": all are whole).

    Returns
    -------
    int64 of shape (4, n). What does not fit becomes negative, and so an invalid event.
    """
    n, problem = len(columns[0]), ""
    block = np.empty((len(columns), n), np.int64)
    for row, name, column in zip(block, "txyp", columns, strict=True):
        if column.dtype.kind == "f":
            odd = column[:n] != np.floor(column[:n])  # nan, too
            if odd.any():
                n = int(np.argmax(odd))
                problem = f"{name} must be whole numbers, got {column[n]}"
            column = np.where(np.abs(column) < 2.0**62, column, -(2.0**62))
        row[:] = column
    return block[:, :n], problem


def _alarm(seconds: int) -> None:
    """Have the system end this process after some seconds (0: never): its library may hang, and its parent be gone."""
    if hasattr(signal, "alarm"):  # Windows has none
        signal.alarm(seconds)


def _limit_memory() -> None:
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))


if __name__ == "__main__":
    main(int(sys.argv[1]))
