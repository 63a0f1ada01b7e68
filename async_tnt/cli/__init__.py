"""The entry of the program `async-tnt`, whose commands are in `program.py`.

It imports fast, and handles signals from its first line.
"""

from __future__ import annotations

import _signal  # not `signal`: Ctrl-C during that import would show a traceback
import gc
import io
import os
import sys
from collections.abc import Callable


def main(argv: list[str] | None = None) -> int:
    """Run the program.

    Returns its exit code: 0 success, 1 the answer is no, 2 bad usage or bad input.

    Parameters
    ----------
    argv : the arguments. None: those of the command line, and the process belongs to the program.
        Before and after a command, a signal then ends the process at once; stderr may be closed or
        full.
    """
    owns_process = argv is None
    if owns_process:
        _at_signals(_end)
        _open_streams()
    # until the command begins: imports make no garbage, and to look for it takes a tenth of a start
    gc.disable()
    try:
        # imports NumPy and Numba, whose C code may turn a KeyboardInterrupt into any other error
        from async_tnt.cli.program import run

        return run(sys.argv[1:] if argv is None else argv)
    finally:
        gc.enable()
        if owns_process:
            # an interpreter that ends takes a signal and calls no handler
            _at_signals(_signal.SIG_DFL)


def _at_signals(handler: Callable[[int, object], None] | int) -> None:
    """Set the handler of the signals that end the program.

    Signals that are ignored stay ignored: Ctrl-C in a background job, SIGHUP under nohup.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(_signal, name, None)  # Windows has no SIGHUP
        if number is not None and _signal.getsignal(number) != _signal.SIG_IGN:
            _signal.signal(number, handler)


def _end(number: int, frame: object) -> None:
    """Say that a signal came, and end the process. A signal handler."""
    what = b"interrupted" if number == _signal.SIGINT else b"terminated"
    try:
        os.write(2, b"async-tnt: " + what + b"\n")
    finally:  # also if stderr is closed or full
        os._exit(128 + number)


def _open_streams() -> None:
    """Make the standard streams such that they do not change how a command ends.

    Closed ones become /dev/null: else a file opened later would get their number and their output.
    """
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 (it stays open)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # the encoding of a file on Windows lacks characters
        sys.stdout.reconfigure(errors="backslashreplace")
    if os.name == "posix":  # the Windows console is not a file
        raw = _Stderr(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(raw), sys.stderr.encoding, "backslashreplace", line_buffering=True
        )


class _Stderr(io.FileIO):
    """Drops what cannot be written.

    A closed or full stderr must not change how a command ends.
    """

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Write the bytes; returns how many they are, even if they were dropped."""
        try:
            return super().write(data)
        except OSError:
            return len(data)
