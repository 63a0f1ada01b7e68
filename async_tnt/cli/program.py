"""The commands of the program `async-tnt`, the errors they report, and how they end."""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Mapping, Sequence

from async_tnt.base.checks import ParameterError
from async_tnt.base.package import __version__
from async_tnt.cli.output import EXPECTED_ERRORS, complain
from async_tnt.cli.parser import Parser, find_mistyped, refuse_dashes, refuse_removed
from async_tnt.cli.signals import Signals, handled_by

# Name of a command -> its line of help. The module `cli/NAME.py` of a command has DESCRIPTION,
# add_arguments(parser) and main(args). It may also have REMOVED: option of the previous version ->
# what to write instead.
COMMANDS = {
    "run": "stream recordings through a model and print its decisions",
    "record": "record a camera or a network stream into class folders",
    "info": "describe recordings, folders of recordings, and models",
    "export": "write a model's network to an ONNX or NIR file (extras: onnx, nir)",
    "check": "prove that the stream equals the batch reference (extra: reference)",
    "bench": "measure what an event and a decision cost on this machine",
    "train": "train a model on recordings (extra: train)",
    "teach": "teach a model one more class, from a few recordings",
    "evaluate": "report how well a model classifies a folder of held-out recordings",
    "mask": "find the hot pixels of recordings, which PixelFilter leaves out",
    "view": "show a stream in the Rerun viewer while it is classified (extra: view)",
    "plot": "draw events, volumes and decisions of a recording (extra: plot)",
}
EPILOG = (
    "async-tnt COMMAND --help explains a command. Exit codes: 0 success, 1 the answer is no, "
    "2 bad usage or bad input, 130 Ctrl-C, 143 terminated, 129 hung up."
)


# -- the command line ------------------------------------------------------------------------------


def build_parser(argv: Sequence[str]) -> Parser:
    """The parser of the program. Only the module of the command that `argv` names is imported."""
    parser = Parser(
        prog="async-tnt",
        description="Classify what an event camera sees, event by event.",
        epilog=EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"async-tnt {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, help_line in COMMANDS.items():
        parser.commands[name] = subparsers.add_parser(
            name, help=help_line, formatter_class=argparse.RawDescriptionHelpFormatter
        )

    command = next((word for word in argv if word in COMMANDS), None)
    if command is None:
        refuse_dashes(parser, argv)
    else:
        refuse_dashes(parser.commands[command], argv)
        _add_command(parser.commands[command], command, argv)
    parser.correction = find_mistyped(argv, parser.options, list(COMMANDS))
    return parser


def _add_command(parser: Parser, name: str, argv: Sequence[str]) -> None:
    """Add the description and the options of a command to its parser.

    Removed options in `argv` are refused here, and a mistyped option is noted.
    """
    module = importlib.import_module(f"async_tnt.cli.{name}")
    parser.description = module.DESCRIPTION
    module.add_arguments(parser)
    parser.set_defaults(main=module.main, option_names=parser.option_names)

    words = argv[argv.index(name) + 1 :]
    refuse_removed(parser, words, getattr(module, "REMOVED", {}))
    parser.correction = find_mistyped(words, parser.options)


# -- running a command -----------------------------------------------------------------------------


def run(argv: Sequence[str]) -> int:
    """Run the program with these arguments. Returns the exit code, see `cli.main`."""
    try:
        code = _run(argv)
    except SystemExit as stopped:  # argparse ends the program: --help, --version, bad usage
        raise SystemExit(_flush(int(stopped.code or 0))) from None
    return _flush(code)


def _run(argv: Sequence[str]) -> int:
    """Run the command, and report its error or the signal that ended it. Returns the exit code."""
    signals = Signals()
    code = 0
    message = ""
    option_names: Mapping[str, str] = {}
    sys.unraisablehook = signals.handle_dropped
    try:
        args = _arguments(argv)
        option_names = args.option_names
        code = _run_command(args, signals)
    except BrokenPipeError:
        # the reader of stdout, such as `head`, wants no more lines, which is no error
        pass
    except (*EXPECTED_ERRORS, ParameterError) as error:
        complain(error, option_names)
        code = 2
    except KeyboardInterrupt as error:
        message = str(error)
        # The first number in `signals.numbers` decides the exit code. If `signals.interrupt` raised
        # this error, it has noted its signal there, and the number that is added here changes
        # nothing. Otherwise the error counts as SIGINT.
        signals.numbers.append(signal.SIGINT)
    except Exception:
        # If a signal came, C code has turned our KeyboardInterrupt into this error.
        if not signals.numbers:
            raise
    finally:
        sys.unraisablehook = signals.previous_hook

    if signals.numbers:
        return _code_after_signal(signals.numbers[0], code, message)
    return code


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    """The parsed command line, with two more fields.

    `main` is the function of the command. `option_names` maps the name of a parameter to the option
    that gives it, for errors.
    """
    parser = build_parser(argv)
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        parser.commands[args.command].error(f"unrecognized arguments: {' '.join(unknown)}")
    return args


def _run_command(args: argparse.Namespace, signals: Signals) -> int:
    """Call the function of the command. Returns the exit code.

    Meanwhile warnings are printed, and signals that end the command raise KeyboardInterrupt.
    """
    with warnings.catch_warnings(), handled_by(signals.interrupt) as signals.previous_handlers:
        # A warning, such as about a damaged recording, is printed in one line, without its place in
        # the code.
        warnings.showwarning = lambda message, *place: complain(
            message, args.option_names, prefix="warning: "
        )
        gc.enable()
        return int(args.main(args))


def _code_after_signal(number: int, code: int, message: str) -> int:
    """Report the signal that ended a command. Returns the exit code.

    If the command has failed, its error was reported already, and the signal is not reported.

    Parameters
    ----------
    number : number of the signal.
    code : the exit code of the command.
    message : the command's own message about its interruption; "" if it has none.
    """
    if code < 2:
        default_message = "interrupted" if number == signal.SIGINT else "terminated"
        complain(message or default_message)
    return 128 + number


def _flush(code: int) -> int:
    """Flush stdout. Returns the exit code: `code`, or 2 if stdout cannot be written.

    A closed pipe is no error. Python would also flush stdout when it ends, but if that failed, the
    exit code would be 120.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        if code < 2 and not isinstance(error, BrokenPipeError):
            complain(error)
            code = 2
        # Python flushes the rest of the buffer when it ends. The rest then goes to /dev/null, so
        # that there is no second error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code
