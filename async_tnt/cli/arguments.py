"""What the commands share: the FILE arguments, and how mistakes are told."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

from async_tnt.config import TNTConfig
from async_tnt.files import check_writable
from async_tnt.networks.model import Model, bundled_models, load_model
from async_tnt.sources.files.fitting import check_events, check_sensor, open_for
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.recording import Recording, sample_recordings
from async_tnt.sources.opening import is_live

SAMPLES = Path("samples")


class HasConfig(Protocol):
    """A Model, or an engine that runs one."""

    @property
    def config(self) -> TNTConfig: ...


def add_files(parser: argparse.ArgumentParser, *, onnx: bool = False, streams: bool = False) -> None:
    """FILE and --model; `onnx`: which may also be an .onnx file; `streams`: FILE may also be udp://... or a camera."""
    sources = "`camera`, udp://HOST:PORT, or " if streams else ""
    kinds = ", a .safetensors file, or an .onnx file of `async-tnt export`" if onnx else " or a .safetensors file"
    parser.add_argument(
        "files",
        nargs="*",
        metavar="FILE",
        type=_file_or_stream if streams else Path,
        help=f"{sources}recordings ({', '.join(sorted(READERS))}); the ten bundled `samples` by default",
    )
    parser.add_argument(
        "--model",
        default="digits",
        metavar="NAME|FILE",
        help=f"a bundled model ({', '.join(bundled_models())}){kinds} (default: %(default)s)",
    )


def _file_or_stream(text: str) -> Path | str:
    return text if is_live(text) else Path(text)


def add_start(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--start-us",
        type=int,
        metavar="US",
        help="start of the first window, in microseconds (default: the first event)",
    )


def paths_of(args: argparse.Namespace) -> list[Any]:
    """What was given as FILE; the bundled samples for nothing, and for `samples` where there is no such file."""
    bundled = list(sample_recordings().values())
    if not args.files:
        return bundled
    return [f for file in args.files for f in (bundled if file == SAMPLES and not SAMPLES.exists() else [file])]


def open_all(paths: list[Path], model: HasConfig) -> Iterator[Recording]:
    """Open recordings one after the other, complaining about those that do not fit the model."""
    for path in paths:
        recording = open_for(path, model.config.sensor)
        check_sensor(path, recording.sensor, model.config.sensor)
        if recording.sensor is None:
            check_events(recording, model.config.sensor, path)
        yield recording


def model_of(args: argparse.Namespace) -> Model:
    if Path(args.model).suffix.lower() == ".onnx":
        raise ValueError(
            f"{args.model}: an .onnx file can only be run (async-tnt run --model); here a bundled model "
            f"({', '.join(bundled_models())}) or a .safetensors file is needed"
        )
    return load_model(args.model)


def complain(error: BaseException | str) -> None:
    """One line on stderr."""
    if isinstance(error, OSError) and error.filename is not None:
        error = f"{error.filename}: {error.strerror}"
    print(f"async-tnt: {one_line(str(error))}", file=sys.stderr, flush=True)


def one_line(text: str) -> str:
    """The text, with what cannot be printed as Python writes it: a file's name may hold a line break.

    Examples
    --------
    >>> print(one_line("a\\nb: no events"))
    a\\nb: no events
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def writable_file(text: str) -> Path:
    """An argparse type: a file that can be written, or one that can be replaced."""
    try:
        check_writable(Path(text))
    except (OSError, ValueError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(text)


def positive_int(text: str) -> int:
    """An argparse type: a whole number of at least 1."""
    try:
        value = int(text.replace("_", ""))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number, got {text!r}") from None
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {value}")
    return value


def positive_number(text: str) -> float:
    """An argparse type: a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text!r}")
    return value
