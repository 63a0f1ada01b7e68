"""The program `async-tnt`: how it starts, and how it ends meanwhile. What it does is in `commands/program.py`."""

from __future__ import annotations

import _signal  # not `signal`: Ctrl-C while that is imported would be a traceback
import io
import os
import sys


def main(argv: list[str] | None = None) -> int:
    """Run the program. Returns its exit code: 0 success, 1 the answer is no, 2 bad usage or bad input.

    Parameters
    ----------
    argv : the words after the program's name. None: those of the command line, and this process is the program: until
        a command begins, a signal ends it at once, and stderr may be closed or full.
    """
    if argv is None:
        _end_at_signals()
        _open_streams()
        argv = sys.argv[1:]
    # imports NumPy and Numba, whose C code may turn the KeyboardInterrupt of a usual handler into any other error
    from async_tnt.cli.program import run

    return run(argv)


def _end_at_signals() -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(_signal, name, None)  # Windows has no SIGHUP
        # a background job ignores Ctrl-C, and nohup SIGHUP: so it stays
        if number is not None and _signal.getsignal(number) != _signal.SIG_IGN:
            _signal.signal(number, _end)


def _end(number: int, frame: object) -> None:
    try:
        os.write(2, b"async-tnt: interrupted\n" if number == _signal.SIGINT else b"async-tnt: terminated\n")
    finally:  # also where stderr is closed or full
        os._exit(128 + number)


def _open_streams() -> None:
    """Open what is closed, as /dev/null: else a file of ours would get its number, and what is written to it."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115 (it stays open)
    if os.name == "posix":  # a console of Windows is no file
        raw = _Stderr(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(raw), sys.stderr.encoding, "backslashreplace", line_buffering=True
        )


class _Stderr(io.FileIO):
    """What cannot be written is lost: whether somebody reads it does not change how a command ends."""

    def write(self, data: bytes) -> int:  # type: ignore[override]
        try:
            return super().write(data)
        except OSError:
            return len(data)
