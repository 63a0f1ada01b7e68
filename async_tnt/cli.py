"""The program `async-tnt`."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from typing import NoReturn

from . import __version__
from .commands.files import complain

COMMANDS = {  # name: (module with DESCRIPTION, add_arguments(parser) and main(args), one line of help)
    "run": ("async_tnt.commands.run", "stream recordings through a model and print its decisions"),
    "export": ("async_tnt.commands.export", "write a model's networks to ONNX files, checked (extra: onnx)"),
    "check": ("async_tnt.commands.check", "prove on recordings that the stream equals the batch reference"),
    "send": ("async_tnt.commands.send", "send recordings over the network at their own pace, as UDP datagrams"),
    "bench": ("async_tnt.bench", "measure time per event and time to decision, beside the batch way"),
    "train": ("async_tnt.training.command", "train a model on recordings (extra: train)"),
    "evaluate": ("async_tnt.commands.evaluate", "say how well a model classifies a folder of held-out recordings"),
    "table": ("async_tnt.table.command", "train and test the thesis' results table (extra: train)"),
    "simulate": ("async_tnt.simulation.command", "make N-MOVING-MNIST: every digit of MNIST under 30 motions"),
    "mask": ("async_tnt.commands.mask", "find the hot pixels of recordings, for PixelFilter to leave out"),
    "view": ("async_tnt.commands.view", "show a stream in the Rerun viewer while it is classified (extra: view)"),
    "plot": ("async_tnt.figures.command", "draw events, volumes and decisions of a recording (extra: plot)"),
}


def build_parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """The parser; only the command that `argv` names is imported."""
    parser = _Parser(
        prog="async-tnt",
        description="Classify what an event camera sees, event by event.",
        epilog="async-tnt COMMAND --help explains a command. Exit codes: 0 success, 1 the answer is no, "
        "2 bad usage or bad input, 130 Ctrl-C, 143 terminated.",
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program. Returns its exit code: 0 success, 1 the answer is no, 2 bad usage or bad input."""
    argv = sys.argv[1:] if argv is None else list(argv)
    try:
        args = build_parser(argv).parse_args(argv)
        with warnings.catch_warnings(), _termination_as_ctrl_c() as terminated:
            warnings.showwarning = _say_warning  # type: ignore[assignment]
            code = args.main(args)
        return 143 if terminated and code == 130 else code
    except (OSError, ValueError, ImportError) as error:
        if isinstance(error, BrokenPipeError):  # `| head`: whoever read us has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        complain(error)
        return 2
    except KeyboardInterrupt as error:
        complain(str(error) or "interrupted")
        return 143 if str(error) else 130


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as everything else here does; `--help` has the rest."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} ({self.prog} --help)\n")


@contextlib.contextmanager
def _termination_as_ctrl_c() -> Iterator[list[int]]:
    """SIGTERM, as of systemd, docker and timeout, ends a command in order, as Ctrl-C does.

    Gives a list that holds something once it came.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # only there may handlers be set
        yield came
        return

    def interrupt(number: int, frame: object) -> None:
        came.append(number)
        raise KeyboardInterrupt("terminated")

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield came
    finally:
        signal.signal(signal.SIGTERM, before)


def _say_warning(message: Warning | str, *where: object) -> None:
    """A warning, such as that of a damaged recording, in one line and without the place in our code."""
    complain(f"warning: {message}")


if __name__ == "__main__":
    sys.exit(main())
