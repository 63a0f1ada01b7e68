"""The entry point of the program `async-tnt`. The commands are in `program.py`.

This module imports almost nothing, so that signals are handled as early as possible.
"""

from __future__ import annotations

import _signal  # importing `signal` takes longer, and Ctrl-C meanwhile would show a traceback
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
    argv : the arguments. If None, they are those of the command line, and the program controls the
        process: before and after a command, a signal ends the process at once, and a closed or full
        stderr does no harm.
    """
    owns_process = argv is None
    if owns_process:
        _set_handlers(_end)
        _open_streams()
    # Garbage is collected only when the command begins. Imports leave no garbage, and the search
    # for it takes a tenth of the start-up time.
    gc.disable()
    try:
        # Imported only now, with the handlers set. This imports NumPy and Numba, whose C code may
        # turn a KeyboardInterrupt into another error.
        from async_tnt.cli.program import run

        return run(sys.argv[1:] if argv is None else argv)
    finally:
        gc.enable()
        if owns_process:
            # While Python shuts down, it receives signals but calls no handler. So the system's
            # default action must end the process.
            _set_handlers(_signal.SIG_DFL)


def _set_handlers(handler: Callable[[int, object], None] | int) -> None:
    """Set the handler of the signals that end the program.

    A signal that is ignored stays ignored, such as Ctrl-C in a background job or SIGHUP under
    nohup.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(_signal, name, None)  # Windows has no SIGHUP
        if number is not None and _signal.getsignal(number) != _signal.SIG_IGN:
            _signal.signal(number, handler)


def _end(number: int, frame: object) -> None:
    """Print that a signal came, and end the process. This is a signal handler."""
    outcome = b"interrupted" if number == _signal.SIGINT else b"terminated"
    try:
        os.write(2, b"async-tnt: " + outcome + b"\n")
    finally:  # also if stderr is closed or full
        os._exit(128 + number)


def _open_streams() -> None:
    """Replace or adapt the standard streams, so that they cannot change how a command ends.

    A closed stream becomes /dev/null. Otherwise a file that is opened later would get the stream's
    number, and with it the stream's output. stdout prints characters that its encoding lacks as
    escapes. stderr drops what it cannot write.
    """
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 (it stays open)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # on Windows, the encoding of a file lacks many characters
        sys.stdout.reconfigure(errors="backslashreplace")
    if os.name == "posix":  # the Windows console is not a file
        raw = _Stderr(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(raw), sys.stderr.encoding, "backslashreplace", line_buffering=True
        )


class _Stderr(io.FileIO):
    """A file that drops what it cannot write.

    A closed or full stderr must not change how a command ends.
    """

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Write the bytes. Returns their number, even if they were dropped."""
        try:
            return super().write(data)
        except OSError:
            return len(data)
