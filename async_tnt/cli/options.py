"""Options that several commands share, types for argparse, and the command as text."""

from __future__ import annotations

import argparse
import contextlib
import shlex
from collections.abc import Callable, Collection
from dataclasses import fields
from pathlib import Path
from typing import Any

from async_tnt.base.files import user_path
from async_tnt.base.messages import short
from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import READERS, sample_recordings
from async_tnt.sources.opening import is_live
from async_tnt.streaming.triggers import TriggerSettings, once_in_its_length
from async_tnt.volume.config import (
    LANDMARKS,
    MAX_SIDE,
    POLARITIES,
    REPRESENTATIONS,
    TRANSFORMS,
    TNTConfig,
)

SAMPLES = Path("samples")
"""The word that means all bundled recordings, unless a file or folder has this name."""
SUFFIXES_TEXT = ", ".join(sorted(READERS))
"""The suffixes of recordings, for help."""
MODELS_TEXT = f"a bundled model ({', '.join(bundled_models())}) or a .safetensors file"
"""The models that every command takes, for help."""
MOST_DIGITS = 4300
"""Number of digits of the longest whole number that Python reads."""


# -- files and models ------------------------------------------------------------------------------


def add_files(parser: argparse.ArgumentParser, *, live: bool = False, single: bool = False) -> None:
    """Add FILE and --model.

    Parameters
    ----------
    live : whether FILE may also be a camera or udp://..., and the model may be an .onnx file. If
        so, --config is added, too.
    single : whether at most one FILE may be given.
    """
    bundled = "a bundled one by default" if single else "the ten bundled `samples` by default"
    sources = "`camera`, udp://HOST:PORT, or " if live else ""
    onnx = ", or an .onnx file of `async-tnt export`" if live else ""
    parser.add_argument(
        "files",
        nargs="?" if single else "*",
        metavar="FILE",
        type=_live_or_path if live else user_path,
        help=f"{sources}recordings ({SUFFIXES_TEXT}), or digits of bundled ones, such as 3; "
        f"{bundled}",
    )
    parser.add_argument(
        "--model",
        default="digits",
        metavar="NAME|FILE",
        help=f"{MODELS_TEXT}{onnx} (default: %(default)s)",
    )
    if live:
        parser.add_argument(
            "--config",
            type=user_path,
            metavar="FILE",
            help="how events become the volumes of another program's .onnx network: a JSON file "
            "with `config` and `classes`, as async-tnt info MODEL --json prints them",
        )


def paths_of(args: argparse.Namespace) -> list[Any]:
    """The paths of the given FILEs. The names of cameras and network streams stay text.

    Without a FILE, these are the paths of all bundled recordings. The word `samples` means the
    same, if no file has this name. A digit means one bundled recording, see `sample_or_path`.
    """
    bundled = list(sample_recordings().values())
    if not args.files:
        return bundled
    files = args.files if isinstance(args.files, list) else [args.files]
    paths: list[Any] = []
    for file in files:
        if isinstance(file, str):  # a camera or the network
            paths.append(file)
        elif file == SAMPLES and not SAMPLES.exists():
            paths += bundled
        else:
            paths.append(sample_or_path(file))
    return paths


def sample_or_path(name: str | Path) -> Path:
    """The path of a recording. A digit, such as "3", means the bundled recording of this digit.

    If there is a file of this name, the file is meant.
    """
    path = Path(name)
    if path.exists():
        return path
    samples = {str(digit): file for digit, file in sample_recordings().items()}
    return samples.get(str(path), path)


def refuse_graph(name: str) -> None:
    """Refuse a .nir graph as a model.

    Raises
    ------
    ValueError : `name` is the path of one. The message says how it becomes a model.
    """
    if Path(name).suffix.lower() == ".nir":
        raise ValueError(
            f"{name}: a NIR graph leaves open how neurons are reset: `async-tnt export {name} "
            "--reset subtract --out FILE.safetensors` makes a model of it (without --reset, if it "
            "is of a network of ReLUs)"
        )


def model_of(name: str) -> Model:
    """Load the model of this name or path.

    Raises
    ------
    ValueError : it is an .onnx file, or a .nir graph, which leaves open how neurons are reset.
    """
    refuse_graph(name)
    if Path(name).suffix.lower() == ".onnx":
        raise ValueError(
            f"{name}: an .onnx file is for run and view (--model) alone; here {MODELS_TEXT} is "
            "needed"
        )
    return load_model(name)


def _live_or_path(text: str) -> str | Path:
    """Read the name of a camera or a network stream as text, and anything else as a path.

    This is an argparse type.
    """
    return text if is_live(text) else user_path(text)


# -- how recordings are read -----------------------------------------------------------------------


def add_reading(parser: argparse.ArgumentParser, *, single: bool = True) -> None:
    """Add the options that say how recordings are read; `reading_of` reads them.

    Parameters
    ----------
    single : whether the command takes single recordings, not a data set. If so, --between-us and
        --strict are added, too.
    """
    group = parser.add_argument_group("how recordings are read")
    group.add_argument(
        "--columns",
        metavar="ORDER",
        help="the order of four columns, such as xypt, in text and NumPy files that do not name "
        "them",
    )
    group.add_argument(
        "--topic",
        metavar="NAME",
        help="the topic of events, of a ROS bag with several",
    )
    if single:
        group.add_argument(
            "--between-us",
            type=_times,
            metavar="START,END",
            help="only the events with START <= t < END, in microseconds of the recording",
        )
        group.add_argument(
            "--strict",
            action="store_true",
            help="refuse a damaged recording, instead of reading it up to the damage",
        )


def reading_of(args: argparse.Namespace) -> dict[str, Any]:
    """The options of `add_reading` that were given, as keyword arguments of `open_recording`."""
    reading = {}
    for name in ("columns", "topic", "between_us", "strict"):
        value = getattr(args, name, None)
        if value:
            reading[name] = value
    return reading


def check_reading(args: argparse.Namespace) -> None:
    """Refuse the options of `add_reading` if a source is a camera or a network stream."""
    options = [args.option_names[name] for name in reading_of(args)]
    live_sources = [path for path in paths_of(args) if isinstance(path, str)]
    if options and live_sources:
        raise ValueError(f"{', '.join(options)} must come with recordings, got {live_sources[0]}")


def _times(text: str) -> tuple[int, int]:
    """Read `1000,2000` as two times, the first before the second. This is an argparse type."""
    start, _, end = text.partition(",")
    # `int` would refuse thousands of digits with an error of its own
    are_numbers = start.isdecimal() and end.isdecimal() and len(text) < 40
    if not are_numbers or int(start) >= int(end):
        raise argparse.ArgumentTypeError(
            f"must be START,END in whole microseconds, START before END, such as 0,500000, got "
            f"{short(text)}"
        )
    return int(start), int(end)


# -- when decisions are due ------------------------------------------------------------------------


def add_start(parser: argparse.ArgumentParser) -> None:
    """Add --start-us."""
    parser.add_argument(
        "--start-us",
        type=int,
        metavar="US",
        help="start of the first window, in microseconds (default: the first event)",
    )


def add_triggers(parser: argparse.ArgumentParser) -> None:
    """Add the options that make a decision due before the end of a window.

    `triggers_of` reads them.
    """
    parser.add_argument(
        "--every-us", type=positive_int, metavar="US", help="decide also every US microseconds"
    )
    parser.add_argument(
        "--every-events", type=positive_int, metavar="N", help="decide also every N events"
    )
    parser.add_argument(
        "--confidence",
        type=_probability,
        metavar="P",
        help="decide and close the window early once the likeliest class has probability P; "
        "checked at the decisions of the other triggers, or else after every event; in a window "
        "that slides, decide when it is another class than before",
    )


def triggers_of(args: argparse.Namespace, config: TNTConfig) -> dict[str, Any]:
    """The options of `add_triggers` as keyword arguments of `Processor`.

    A window that slides has no end at which to decide. Without an option, its decisions are as far
    apart as it is long.
    """
    triggers = {field.name: getattr(args, field.name) for field in fields(TriggerSettings)}
    if all(value is None for value in triggers.values()):
        triggers |= once_in_its_length(config)
    return triggers


# -- numbers and sizes: argparse types ------------------------------------------------------------


def positive_int(text: str) -> int:
    """Read a whole number of at least 1."""
    return whole_number(text, 1)


def whole_number(text: str, least: int = 0) -> int:
    """Read a whole number of at least `least`."""
    if not text.isdecimal() or len(text) > MOST_DIGITS or int(text) < least:
        raise argparse.ArgumentTypeError(
            f"must be a whole number of at least {least}, got {short(text)}"
        )
    return int(text)


def number(text: str, is_allowed: Callable[[float], bool], rule: str) -> float:
    """Read a number that keeps a rule.

    Parameters
    ----------
    is_allowed : whether a number keeps the rule.
    rule : the rule in words, for the error.
    """
    with contextlib.suppress(ValueError):  # a text that is not a number keeps no rule
        value = float(text)
        if is_allowed(value):
            return value
    raise argparse.ArgumentTypeError(f"must be {rule}, got {short(text)}")


def positive_number(text: str) -> float:
    """Read a number above 0."""
    return number(text, lambda value: value > 0, "a positive number")


def _probability(text: str) -> float:
    """Read a probability above 0."""
    return number(text, lambda value: 0 < value <= 1, "a probability in (0, 1]")


def size_of(text: str) -> tuple[int, int]:
    """Read `346x260` as two numbers."""
    width, _, height = text.lower().partition("x")
    # `int` would refuse thousands of digits with an error of its own
    if not (width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise argparse.ArgumentTypeError(
            f"must be WIDTHxHEIGHT in pixels, such as 346x260, got {short(text)}"
        )
    size = int(width), int(height)
    if not all(1 <= side <= MAX_SIDE for side in size):
        raise argparse.ArgumentTypeError(
            f"must be WIDTHxHEIGHT with sides in [1, {MAX_SIDE}] pixels, got {text!r}"
        )
    return size


# -- the volume ------------------------------------------------------------------------------------


def _yes_or_no(text: str) -> bool:
    """Read "yes" as True and "no" as False. Any other text is a ValueError."""
    if text not in ("yes", "no"):
        raise ValueError
    return text == "yes"


FIELDS: dict[str, tuple[Callable[[str], Any], str]] = {
    "representation": (str, "a name"),
    "transform": (str, "a name"),
    "landmark": (str, "a name"),
    "polarity": (str, "a name"),
    "bins": (int, "a whole number"),
    "t_max": (float, "a number"),
    "remove_flow": (_yes_or_no, "yes or no"),
}
"""Field of `TNTConfig` that --volume may give -> the function that reads its value, and what the
value must be, in words."""


def add_volume(parser: argparse._ActionsContainer, default: str) -> None:
    """Add --volume, which gives the fields of `TNTConfig` that have no option of their own.

    `volume_of` reads the option.

    Parameters
    ----------
    default : what the volume is without the option, in words, for the help.
    """
    parser.add_argument(
        "--volume",
        type=_volume_text,
        metavar="NAME=VALUE,...",
        help=f"representation ({', '.join(REPRESENTATIONS)}), transform "
        f"({', '.join(TRANSFORMS)}), landmark ({', '.join(LANDMARKS)}), polarity "
        f"({', '.join(POLARITIES)}), bins, t_max, remove_flow=yes; landmark and t_max need "
        f"transform=tnt (default: {default})",
    )


def volume_of(text: str | None) -> dict[str, Any]:
    """Read `bins=5,polarity=split` as fields of `TNTConfig`.

    Without the option, `text` is None and there are no fields.
    """
    volume: dict[str, Any] = {}
    parts = [] if text is None else text.split(",")
    for part in parts:
        name, _, value = part.partition("=")
        if name not in FIELDS or name in volume:
            raise argparse.ArgumentTypeError(
                f"must be NAME=VALUE,... with each of {', '.join(FIELDS)} at most once, got "
                f"{short(part)}"
            )
        convert, rule = FIELDS[name]
        try:
            volume[name] = convert(value)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{name} must be {rule}, got {short(value)}") from None
    return volume


def _volume_text(text: str) -> str:
    """Check the value of --volume, and return it as it is. This is an argparse type."""
    volume_of(text)
    return text


# -- the command as words --------------------------------------------------------------------------


def command_words(
    program: str,
    args: argparse.Namespace,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    *,
    leave_out: Collection[str] = (),
) -> str:
    """The command as text, to repeat it elsewhere.

    Options that have their default value are left out. So are paths, because they differ from
    machine to machine.

    Parameters
    ----------
    program : the words before the options, such as "async-tnt train".
    args, add_arguments : the parsed options, and the function that adds them to a parser.
    leave_out : options that do not change the result, by their names in `args`.
    """
    parser = argparse.ArgumentParser(add_help=False)
    add_arguments(parser)
    words = [program]
    for action in parser._actions:
        value = getattr(args, action.dest)
        is_path = action.type in (Path, user_path)
        if is_path or value == action.default or action.dest in leave_out:
            continue
        option = action.option_strings[0]
        if isinstance(value, bool):
            words.append(option)
        else:
            words.append(f"{option} {_value_words(action.dest, value)}")
    return " ".join(words)


def _value_words(name: str, value: Any) -> str:
    """The value of an option, as a user types it. A file is given by its name, without folders."""
    if isinstance(value, tuple):
        # a region is X,Y,W,H, a range of sizes is MIN-MAX, and any other tuple is WxH
        separator = {"roi": ",", "size": "-", "scales": "-"}.get(name, "x")
        value = separator.join(f"{part:g}" for part in value)
    values = value if isinstance(value, list) else [value]
    if name in ("network", "teacher"):
        values = [Path(value).name for value in values]
    return shlex.join(map(str, values))
