"""Options that several commands share, argparse types, and the command as words."""

from __future__ import annotations

import argparse
import contextlib
import shlex
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from async_tnt.base.checks import short
from async_tnt.base.files import user_path
from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import READERS, sample_recordings
from async_tnt.sources.opening import is_live
from async_tnt.volume.config import LANDMARKS, MAX_SIDE, POLARITIES, REPRESENTATIONS, TRANSFORMS

FIELDS: dict[str, Callable[[str], Any]] = {
    "representation": str,
    "transform": str,
    "landmark": str,
    "polarity": str,
    "bins": int,
    "t_max": float,
    "remove_flow": {"yes": True, "no": False}.__getitem__,
}
"""What --volume may give: fields of `TNTConfig`, and how their values are read."""
SAMPLES = Path("samples")
READABLE = ", ".join(sorted(READERS))
MODELS = f"a bundled model ({', '.join(bundled_models())}) or a .safetensors file"


def add_files(parser: argparse.ArgumentParser, *, live: bool = False, one: bool = False) -> None:
    """FILEs, or `one`, and --model; with `live` also udp://... or a camera, a model in an .onnx
    file, and --config."""
    bundled = "a bundled one by default" if one else "the ten bundled `samples` by default"
    sources = "`camera`, udp://HOST:PORT, or " if live else ""
    onnx = ", or an .onnx file of `async-tnt export`" if live else ""
    parser.add_argument(
        "files",
        nargs="?" if one else "*",
        metavar="FILE",
        type=(lambda text: text if is_live(text) else user_path(text)) if live else user_path,
        help=f"{sources}recordings ({READABLE}), or digits of bundled ones, such as 3; {bundled}",
    )
    parser.add_argument(
        "--model",
        default="digits",
        metavar="NAME|FILE",
        help=f"{MODELS}{onnx} (default: %(default)s)",
    )
    if live:
        parser.add_argument(
            "--config",
            type=user_path,
            metavar="FILE",
            help="how events become the volumes of another program's .onnx network: a JSON file with `config` and "
            "`classes`, as async-tnt info MODEL --json prints them",
        )


def add_reading(parser: argparse.ArgumentParser, *, single: bool = True) -> None:
    """How recordings are read; read it with `reading_of`.

    Parameters
    ----------
    single : also --between-us and --strict, which are for commands that take recordings one by one,
        not data sets.
    """
    group = parser.add_argument_group("how recordings are read")
    group.add_argument(
        "--columns",
        metavar="ORDER",
        help="the order of four columns, such as xypt, in text and NumPy files that do not name them",
    )
    group.add_argument(
        "--topic",
        metavar="NAME",
        help="the topic to read, of a ROS bag with several topics of events",
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
    """Keyword arguments of `open_recording`, of the options of `add_reading` that were given."""
    names = ("columns", "topic", "between_us", "strict")
    return {name: value for name in names if (value := getattr(args, name, None))}


def check_reading(args: argparse.Namespace) -> None:
    """Refuse the options of `add_reading` for a camera or the network."""
    given = [f"--{name.replace('_', '-')}" for name in reading_of(args)]
    if given and (live := [path for path in paths_of(args) if isinstance(path, str)]):
        raise ValueError(f"{', '.join(given)} must come with recordings, got {live[0]}")


def add_start(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--start-us",
        type=int,
        metavar="US",
        help="start of the first window, in microseconds (default: the first event)",
    )


def add_triggers(parser: argparse.ArgumentParser) -> None:
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
        help="decide and close the window early once the likeliest class has probability P; checked at the "
        "decisions of the other triggers, or else after every event",
    )


def triggers_of(args: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `Processor`."""
    return {name: getattr(args, name) for name in ("every_us", "every_events", "confidence")}


def paths_of(args: argparse.Namespace) -> list[Any]:
    """The given FILEs; the bundled samples if there are none, or for `samples` if no such file
    exists.

    A digit names its bundled recording, see `sample_or_path`.
    """
    bundled = list(sample_recordings().values())
    if not args.files:
        return bundled
    given = args.files if isinstance(args.files, list) else [args.files]
    paths: list[Any] = []
    for file in given:
        if file == SAMPLES and not SAMPLES.exists():
            paths += bundled
        else:
            paths.append(sample_or_path(file) if isinstance(file, Path) else file)
    return paths


def sample_or_path(name: str | Path) -> Path:
    """The bundled recording of a digit, such as "3", unless a file has this name; else the path
    itself."""
    path = Path(name)
    if path.exists() or str(path) not in (
        samples := {str(digit): file for digit, file in sample_recordings().items()}
    ):
        return path
    return samples[str(path)]


def of_windows(model: Model, name: str | Path) -> Model:
    """The model, if it has one answer for a window; a ValueError for a map model, whose answers are
    objects."""
    if model.places is not None:
        raise ValueError(
            f"{name} finds objects, not the class of a window; run, view, plot, evaluate, check, "
            "bench, export take it"
        )
    return model


def model_of(name: str) -> Model:
    if Path(name).suffix.lower() == ".onnx":
        raise ValueError(
            f"{name}: an .onnx file is for run and view (--model) alone; here {MODELS} is needed"
        )
    return load_model(name)


def _times(text: str) -> tuple[int, int]:
    """An argparse type: `1000,2000` as two times, the first before the second."""
    start, _, end = text.partition(",")
    if not (start.isdecimal() and end.isdecimal() and len(text) < 40 and int(start) < int(end)):
        raise argparse.ArgumentTypeError(
            f"must be START,END in whole microseconds, START before END, such as 0,500000, got "
            f"{short(text)}"
        )
    return int(start), int(end)


def positive_int(text: str) -> int:
    """An argparse type: a whole number of at least 1."""
    return whole_number(text, 1)


def whole_number(text: str, least: int = 0) -> int:
    """An argparse type: a whole number of at least `least`."""
    # Python does not read longer ones
    if not text.isdecimal() or len(text) > 4300 or int(text) < least:
        raise argparse.ArgumentTypeError(
            f"must be a whole number of at least {least}, got {short(text)}"
        )
    return int(text)


def number(text: str, holds: Callable[[float], bool], rule: str) -> float:
    """For an argparse type: the number, which must fulfil the rule."""
    with contextlib.suppress(ValueError):
        if holds(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"must be {rule}, got {short(text)}")


def positive_number(text: str) -> float:
    """An argparse type: a number above 0."""
    return number(text, lambda value: value > 0, "a positive number")


def _probability(text: str) -> float:
    return number(text, lambda value: 0 < value <= 1, "a probability in (0, 1]")


def size_of(text: str) -> tuple[int, int]:
    """An argparse type: `346x260` as two numbers."""
    width, _, height = text.lower().partition("x")
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


def add_volume(parser: argparse._ActionsContainer, default: str) -> None:
    """--volume, the fields of `TNTConfig` that no other option gives; read it with `volume_of`."""
    parser.add_argument(
        "--volume",
        type=_volume_text,
        metavar="NAME=VALUE,...",
        help=f"representation ({', '.join(REPRESENTATIONS)}), transform ({', '.join(TRANSFORMS)}), landmark "
        f"({', '.join(LANDMARKS)}), polarity ({', '.join(POLARITIES)}), bins, t_max, "
        "remove_flow=yes; landmark and "
        f"t_max need transform=tnt (default: {default})",
    )


def volume_of(text: str | None) -> dict[str, Any]:
    """`bins=5,polarity=split` as fields of `TNTConfig`; none where the option is not given."""
    volume = {}
    for part in () if text is None else text.split(","):
        name, _, value = part.partition("=")
        if name not in FIELDS or name in volume:
            raise argparse.ArgumentTypeError(
                f"must be NAME=VALUE,... with each of {', '.join(FIELDS)} at most once, got "
                f"{short(part)}"
            )
        try:
            volume[name] = FIELDS[name](value)
        except (ValueError, KeyError):
            kind = {"bins": "a whole number", "t_max": "a number"}.get(name, "yes or no")
            raise argparse.ArgumentTypeError(f"{name} must be {kind}, got {short(value)}") from None
    return volume


def _volume_text(text: str) -> str:
    """The fields as text, checked, so that a command keeps them as they were given."""
    volume_of(text)
    return text


def command_words(
    program: str,
    args: argparse.Namespace,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    *,
    leave_out: Collection[str] = (),
) -> str:
    """The command that repeats this, without paths, which differ from machine to machine.

    Parameters
    ----------
    program : such as "async-tnt train".
    args, add_arguments : the parsed options, and the function that adds them to a parser.
    leave_out : options that do not change the result, by their name in `args`.
    """
    parser = argparse.ArgumentParser(add_help=False)
    add_arguments(parser)
    words = [program]
    for action in parser._actions:
        value = getattr(args, action.dest)
        if action.type in (Path, user_path) or value == action.default or action.dest in leave_out:
            continue
        if isinstance(value, tuple):  # a region, a range, or a size
            separator = {"roi": ",", "size": "-"}.get(action.dest, "x")
            value = separator.join(f"{number:g}" for number in value)
        values = value if isinstance(value, list) else [value]
        if action.dest in ("network", "teacher"):
            values = [Path(one).name for one in values]
        text = shlex.join(map(str, values))
        name = action.option_strings[0]
        words.append(name if isinstance(value, bool) else f"{name} {text}")
    return " ".join(words)
