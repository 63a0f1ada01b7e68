"""The child of a `ChildSource`: `python child_process.py READER FILE PIPE` sends what a reader reads from a file.

A reader is a script beside this one. Its `read(path)` yields the sensor, (width, height) or None, then blocks of
events, int64 of shape (4, n): t, x, y, p. It raises an exception where the file cannot be read on.
"""

from __future__ import annotations

import json
import runpy
import signal
import sys
from contextlib import suppress
from multiprocessing import connection
from pathlib import Path

READ_S = 120  # a block takes milliseconds, but a disk may sleep
MAX_BYTES = 4 << 30  # of addresses; a block takes megabytes, but a damaged file may ask for anything


def main(reader: str, path: str, pipe: int) -> None:
    """Send the messages that `child_source.py` describes."""
    _limit_memory()
    # on Windows, pipes have a class of their own
    sender = getattr(connection, "PipeConnection", connection.Connection)(pipe, readable=False)

    def send(message: bytes) -> None:
        _alarm(0)  # the parent may be slow to read
        sender.send_bytes(message)
        _alarm(READ_S)

    _alarm(READ_S)
    problem = ""
    with suppress(BrokenPipeError):  # the parent has read enough
        try:
            messages = runpy.run_path(str(Path(__file__).parent / reader))["read"](path)
            send(json.dumps(next(messages)).encode())
            for block in messages:
                send(block.tobytes())
        except BrokenPipeError:
            raise
        except BaseException as error:  # a panic in Rust derives from BaseException alone
            problem = " ".join(str(error).split())[:300] or type(error).__name__
        send(b"")
        send(problem.encode())


def _alarm(seconds: int) -> None:
    """Have the system end this process after some seconds (0: never): its library may hang, and its parent be gone."""
    if hasattr(signal, "alarm"):  # Windows has none
        signal.alarm(seconds)


def _limit_memory() -> None:
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
