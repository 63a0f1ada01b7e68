"""The commands of the program `async-tnt`, the errors they report, and how they end."""

from __future__ import annotations

import argparse
import difflib
import gc
import importlib
import itertools
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

from async_tnt.base.checks import printable
from async_tnt.base.package import __version__
from async_tnt.cli.output import OPTIONS, complain

# Ctrl-C, SIGTERM (systemd, docker, timeout), SIGHUP (the terminal closes), which Windows does not
# have
ENDING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
REPEATED_S = 1.0
"""Seconds within which a second signal is the same request to end."""
# Name of a module beside this one: its line of help. The module has DESCRIPTION, add_arguments(parser)
# and main(args). It may have REMOVED: options of the version before, each with what to write instead.
COMMANDS = {
    "run": "stream recordings through a model and print its decisions",
    "record": "record a camera or a network stream into class folders",
    "info": "describe recordings, folders of recordings, and models",
    "export": "write a model's classifier to an ONNX file, checked (extra: onnx)",
    "check": "prove that the stream equals the batch reference (extra: reference)",
    "bench": "measure what an event and a decision cost on this machine",
    "train": "train a model on recordings (extra: train)",
    "evaluate": "report how well a model classifies a folder of held-out recordings",
    "mask": "find the hot pixels of recordings, which PixelFilter leaves out",
    "view": "show a stream in the Rerun viewer while it is classified (extra: view)",
    "plot": "draw events, volumes and decisions of a recording (extra: plot)",
}


def build_parser(argv: Sequence[str]) -> _Parser:
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
    _refuse_dashes(f"async-tnt {wanted or ''}".strip(), argv)
    for name, help_line in COMMANDS.items():
        subparser = subparsers.add_parser(
            name, help=help_line, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        parser.commands[name] = subparser
        if name == wanted:
            module = importlib.import_module(f"async_tnt.cli.{name}")
            subparser.description = module.DESCRIPTION
            module.add_arguments(subparser)
            subparser.set_defaults(main=module.main)
            _refuse_removed(subparser, argv, getattr(module, "REMOVED", {}))
            subparser.mistyped = mistyped(argv[argv.index(name) + 1 :], subparser.options)
    parser.mistyped = mistyped(argv, parser.options, list(COMMANDS))
    return parser


def _refuse_dashes(prog: str, argv: Sequence[str]) -> None:
    """Refuse --option=--, for which argparse gives a command an empty list instead of text."""
    for word in itertools.takewhile(lambda word: word != "--", argv):
        if word.startswith("-") and word.endswith("=--"):
            _Parser(prog=prog).error(
                f"argument {word.removesuffix('=--')}: expected a value, got '--'"
            )


def _refuse_removed(parser: _Parser, argv: Sequence[str], removed: Mapping[str, str]) -> None:
    """Refuse an option that the version before had, in one line that says what to write instead.

    Parameters
    ----------
    removed : option -> what to write instead, such as {"--bins": "write --volume bins=N"}.
    """
    for word in itertools.takewhile(lambda word: word != "--", argv):
        name = word.partition("=")[0]
        if name in removed:
            parser.error(f"{name} is no longer an option: {removed[name]}")


def mistyped(
    words: Sequence[str], options: Sequence[str], commands: Sequence[str] = ()
) -> tuple[str, str] | None:
    """The first word that is no option, or no command where there are some, and what it was
    probably meant to be.

    Parameters
    ----------
    words : as they were typed; of those before a command and the command, if `commands` are given.

    Examples
    --------
    >>> mistyped(["a.npz", "--modle", "x"], ["--model", "--out"])
    ('--modle', '--model')
    >>> mistyped(["a.npz", "--mod", "x"], ["--model", "--out"]) is None  # argparse takes the beginning of an option
    True
    """
    for word in words:
        if word == "--":  # files follow
            return None
        name = word.partition("=")[0]
        if word.startswith("-") and len(word) > 1 and not word[1].isdigit():
            known, alike = options, 0.7  # all begin alike
            is_known = any(option.startswith(name) for option in options)
        else:
            known, alike = commands, 0.6
            is_known = word in commands
        meant = (
            [] if is_known else difflib.get_close_matches(name.lower(), known, n=1, cutoff=alike)
        )
        if meant:
            return name, meant[0]
        if known is commands and commands:
            return None  # what follows belongs to the command
    return None


def run(argv: Sequence[str]) -> int:
    """Run the program with these arguments. Returns its exit code, as `cli.main`."""
    try:
        code = _run(argv)
    except SystemExit as stopped:  # of argparse: --help, --version, bad usage
        raise SystemExit(_flushed(int(stopped.code or 0))) from None
    return _flushed(code)


class _Signals:
    """What a command does at the signals that end it, and which of them came."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self.before: dict[int, Any] = {}
        self.hook = sys.unraisablehook
        self._accepted_s = 0.0

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """SIGTERM and SIGHUP raise KeyboardInterrupt like Ctrl-C, so that a command can clean up.

        A signal that follows at once does nothing: a terminal that is closed sends two, and the
        second would end the cleaning up. A later one is obeyed, in case that takes forever.
        """
        now_s = time.monotonic()
        if self.received and now_s < self._accepted_s + REPEATED_S:
            return
        self._accepted_s = now_s
        self.received.append(number)
        if callable(self.before.get(number)) and _in_import_or_compilation(frame):
            self.before[number](number, frame)  # ends the process at once
        raise KeyboardInterrupt

    def report(self, dropped: sys.UnraisableHookArgs) -> None:
        """Python drops what is raised in a `__del__` or in a callback of C code: a signal there
        ends the process."""
        if not self.received or not isinstance(dropped.exc_value, KeyboardInterrupt):
            self.hook(dropped)
        elif callable(self.before[self.received[-1]]):
            self.before[self.received[-1]](self.received[-1], None)


def _run(argv: Sequence[str]) -> int:
    signals = _Signals()
    received = signals.received
    code, told = 0, ""
    sys.unraisablehook = signals.report
    try:
        parser = build_parser(argv)
        args, unknown = parser.parse_known_args(argv)
        if unknown:
            parser.commands[args.command].error(f"unrecognized arguments: {' '.join(unknown)}")
        OPTIONS.clear()
        OPTIONS.update(vars(args))
        with warnings.catch_warnings(), handled_by(signals.interrupt) as signals.before:
            # such as of a damaged recording: in one line, without its place in the code
            warnings.showwarning = lambda message, *where: complain(f"warning: {message}")
            gc.enable()
            code = args.main(args)
    except BrokenPipeError:  # `| head`: the reader has seen enough
        pass
    except (OSError, ValueError, ImportError, MemoryError) as error:
        complain(error)
        code = 2
    except KeyboardInterrupt as error:
        told = str(error)
        received.append(signal.SIGINT)  # unless it came of another signal, which is the first
    except Exception:
        if not received:  # C code turned the KeyboardInterrupt into another error
            raise
    finally:
        sys.unraisablehook = signals.hook
    return _code_after_signal(received[0], code, told) if received else code


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[dict[int, Any]]:
    """Call `handler` for these signals within the block; yields the previous handlers.

    Ignored signals stay ignored: Ctrl-C in a background job, SIGHUP under nohup. Outside the main
    thread nothing changes, as Python can set handlers only there.
    """
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in ENDING}
        before = {
            number: known for number, known in before.items() if known not in (signal.SIG_IGN, None)
        }
    for number in before:
        signal.signal(number, handler)
    try:
        yield before
    finally:
        for number, known in before.items():
            signal.signal(number, known)


def _code_after_signal(number: int, code: int, told: str) -> int:
    """The exit code where a signal came, which is told unless the command has failed and said so
    itself."""
    if code < 2:
        complain(told or ("interrupted" if number == signal.SIGINT else "terminated"))
    return 128 + number


def _flushed(code: int) -> int:
    """Flush stdout and return the exit code; if the interpreter's own flush failed, it would be
    120."""
    try:
        sys.stdout.flush()
    except OSError as error:
        if code < 2 and not isinstance(error, BrokenPipeError):
            complain(error)
            code = 2
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the rest of the buffer
    return code


class _Parser(argparse.ArgumentParser):
    """Reports a mistake in one line, as all commands do; `--help` has the rest.

    Attributes
    ----------
    mistyped : a word of the command line, and what it was probably meant to be, for the error.
    commands : name -> the parser of its options.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.mistyped: tuple[str, str] | None = None
        self.commands: dict[str, _Parser] = {}

    @property
    def options(self) -> list[str]:
        """All options, such as "--out"."""
        return [option for action in self._actions for option in action.option_strings]

    def error(self, message: str) -> NoReturn:
        if self.mistyped is not None:
            word, meant = self.mistyped
            message += (
                f"; did you mean {meant}?"
                if word in message
                else f"; {word}: did you mean {meant}?"
            )
        self.exit(2, f"{self.prog}: {printable(message)} ({self.prog} --help)\n")


def _in_import_or_compilation(frame: FrameType | None) -> bool:
    """Whether an import or a compilation is running.

    Their C code prints a KeyboardInterrupt and continues, turns it into another error, or crashes:
    LLVM calls back for each kernel that it loads from the cache.
    """
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith(
            ("importlib._bootstrap", "llvmlite.", "numba.")
        ):
            return True
        frame = frame.f_back
    return False
