"""The commands of the program `async-tnt`: their words, their errors and their ends."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import NoReturn

from async_tnt import __version__
from async_tnt.cli.output import complain, one_line
from async_tnt.signals import handled_by

COMMANDS = {  # name: (module with DESCRIPTION, add_arguments(parser) and main(args), one line of help)
    "run": ("async_tnt.cli.run", "stream recordings through a model and print its decisions"),
    "export": ("async_tnt.cli.export", "write a model's networks to ONNX files, checked (extra: onnx)"),
    "check": ("async_tnt.cli.check", "prove on recordings that the stream equals the batch reference"),
    "send": ("async_tnt.cli.send", "send recordings over the network at their own pace, as UDP datagrams"),
    "bench": ("async_tnt.cli.bench", "measure time per event and time to decision, beside the batch way"),
    "train": ("async_tnt.cli.train", "train a model on recordings (extra: train)"),
    "evaluate": ("async_tnt.cli.evaluate", "say how well a model classifies a folder of held-out recordings"),
    "table": ("async_tnt.cli.table", "train and test the thesis' results table (extra: train)"),
    "simulate": ("async_tnt.cli.simulate", "make N-MOVING-MNIST: every digit of MNIST under 30 motions"),
    "mask": ("async_tnt.cli.mask", "find the hot pixels of recordings, for PixelFilter to leave out"),
    "view": ("async_tnt.cli.view", "show a stream in the Rerun viewer while it is classified (extra: view)"),
    "plot": ("async_tnt.cli.plot", "draw events, volumes and decisions of a recording (extra: plot)"),
}


def build_parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """The parser; only the command that `argv` names is imported."""
    parser = _Parser(
        prog="async-tnt",
        description="Classify what an event camera sees, event by event.",
        epilog="async-tnt COMMAND --help explains a command. Exit codes: 0 success, 1 the answer is no, "
        "2 bad usage or bad input, 130 Ctrl-C, 143 terminated, 129 hung up.",
    )
    parser.add_argument("--version", action="version", version=f"async-tnt {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    wanted = next((word for word in argv if word in COMMANDS), None)
    for name, (module_name, help_line) in COMMANDS.items():
        if name != wanted:
            subparsers.add_parser(name, help=help_line)
            continue
        module = importlib.import_module(module_name)
        subparser = subparsers.add_parser(
            name,
            help=help_line,
            description=getattr(module, "DESCRIPTION", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(subparser)
        subparser.set_defaults(main=module.main)
    return parser


def run(argv: Sequence[str]) -> int:
    """Run the program with these words. Returns its exit code, as `cli.main`."""
    try:
        code = _run(argv)
    except SystemExit as stopped:  # of argparse: --help, --version, bad usage
        raise SystemExit(_flushed(int(stopped.code or 0))) from None
    return _flushed(code)


def _run(argv: Sequence[str]) -> int:
    came: list[int] = []
    try:
        args = build_parser(argv).parse_args(argv)
        with warnings.catch_warnings(), _signals_as_ctrl_c(came):
            warnings.showwarning = _say_warning  # type: ignore[assignment]
            code = args.main(args)
    except BrokenPipeError:  # `| head`: whoever read us has seen enough
        return 0
    except (OSError, ValueError, ImportError) as error:
        complain(error)
        code = 2
    except KeyboardInterrupt as error:
        complain(str(error) or "interrupted")
        code = 130
    except Exception:
        if not came:
            raise
        complain("interrupted")  # what C code has made of a KeyboardInterrupt
        code = 130
    return 128 + came[0] if came and code else code


def _flushed(code: int) -> int:
    """The exit code, once all is written that was printed: the interpreter's own flush would make it 120."""
    try:
        sys.stdout.flush()
    except OSError as error:
        if code < 2 and not isinstance(error, BrokenPipeError):
            complain(error)
            code = 2
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is still in the buffer
    return code


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as everything else here does; `--help` has the rest."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {one_line(message)} ({self.prog} --help)\n")


@contextlib.contextmanager
def _signals_as_ctrl_c(came: list[int]) -> Iterator[None]:
    """SIGTERM and SIGHUP, too, end a command in order, by a KeyboardInterrupt; `came` gets the number of each."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if callable(before[number]) and _bears_no_error(frame):
            before[number](number, frame)  # ends the program at once, as a kill would
        raise KeyboardInterrupt("" if number == signal.SIGINT else "terminated")

    with handled_by(interrupt) as before:
        yield


def _bears_no_error(frame: FrameType | None) -> bool:
    """Whether an import or a compilation is under way.

    C code in them prints a KeyboardInterrupt and goes on, turns it into another error, or crashes: LLVM calls back for
    each kernel that it takes from the cache.
    """
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith(("importlib._bootstrap", "llvmlite.", "numba.")):
            return True
        frame = frame.f_back
    return False


def _say_warning(message: Warning | str, *where: object) -> None:
    """A warning, such as that of a damaged recording, in one line and without the place in our code."""
    complain(f"warning: {message}")
