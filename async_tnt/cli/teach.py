"""async-tnt teach: one more class for a finished model, from a few recordings, in a second."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.files import check_writable, user_path
from async_tnt.base.progress import Bar, progress
from async_tnt.cli.lessons import LIVE_S, check_teachable, lesson_lines
from async_tnt.cli.options import MODELS_TEXT, add_reading, model_of, positive_number, reading_of
from async_tnt.cli.output import EXPECTED_ERRORS, message_of, note, say
from async_tnt.cli.pixel_options import add_pixels, model_pixels_of, pixels_of
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.labelled_recordings import (
    LabelledRecording,
    find_recordings,
    recordings_under,
)
from async_tnt.sources.files.source_error import SourceError
from async_tnt.sources.opening import is_live, open_source
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.training.class_statistics import with_nothing
from async_tnt.training.dataset import fingerprint
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import windows_of
from async_tnt.volume.events import EVENT_DTYPE, as_events

USAGE = "async-tnt teach MODEL --class NAME RECORDING... [--class ...] [--forget NAME] --out FILE"
MOST_KEPT = 50
"""Windows that show none of the classes are made from at most so many recordings of each class."""

DESCRIPTION = """\
Teach a model a class that it has not seen, from a few recordings, in a second.

  async-tnt teach gestures.safetensors --class point point/*.npz --out more.safetensors
  async-tnt teach gestures.safetensors --class point camera --seconds 10 --out more.safetensors
  async-tnt teach more.safetensors --forget point --out fewer.safetensors
  async-tnt run --model more.safetensors camera

RECORDING is a file, a folder of files, a camera or udp://HOST:PORT. Ten recordings are
good; one or two are too few. No recording of the other classes is needed: the model's
file has statistics of them, which `async-tnt train` stores. The network stays as it is,
and so do the logits of the classes it was trained on.

It says how many windows of a recording are right while this recording is left out, and
which share of each other class the new one takes, by the statistics. `async-tnt
evaluate` tells both for recordings that you keep for it.

A model without statistics needs recordings of its classes, once:

  async-tnt teach old.safetensors --statistics gestures --out new.safetensors

--out may be MODEL itself: the file is replaced when the new one is complete. Exit code 0,
or 2 for bad usage or bad input; nothing is written then.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.usage = USAGE
    parser.add_argument("model", metavar="MODEL", help=MODELS_TEXT)
    parser.add_argument(
        "--class",
        dest="lessons",
        nargs="+",
        action="append",
        default=[],
        metavar=("NAME", "RECORDING"),
        help="a class, and recordings of it; repeat it for several classes",
    )
    parser.add_argument(
        "--forget",
        action="append",
        default=[],
        metavar="NAME",
        help="a class to leave out; this is done first, so its name may be taught again",
    )
    parser.add_argument(
        "--out",
        required=True,
        type=user_path,
        metavar="FILE",
        help="the new model, .safetensors; replaced if it exists",
    )
    parser.add_argument(
        "--statistics",
        type=user_path,
        metavar="DATASET",
        help="<class name>/<recordings> of all classes of a model that has no statistics",
    )
    parser.add_argument(
        "--seconds",
        type=positive_number,
        default=LIVE_S,
        metavar="S",
        help="how long a camera or a network stream is read (default: 10)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")
    add_pixels(parser)
    add_reading(parser)


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt teach`. Returns the exit code."""
    check_writable(args.out, (".safetensors",))
    lessons = _lessons(args)
    model = model_of(args.model)
    reader = _Reader(model_pixels_of(pixels_of(args), model), reading_of(args), args.seconds)
    if args.statistics is not None:
        model = _with_statistics(model, args.statistics, reader)
    elif not lessons and not args.forget:
        raise ValueError("give --class NAME RECORDING..., --forget NAME or --statistics DATASET")
    check_teachable(model, args.model)
    for name in args.forget:
        model = _changed("--forget", name, partial(model.without_class, name))
    for name in lessons:  # before a camera is read for seconds
        if name in model.classes:
            raise ValueError(f"--class {name}: the model has this class; give --forget {name}, too")
    for name, sources in lessons.items():
        recordings = reader.read_all(name, sources)
        model = _changed("--class", name, partial(model.with_class, name, recordings))
    model.save(args.out)
    _print(args, model, list(lessons), reader.left_out)
    return 0


def _lessons(args: argparse.Namespace) -> dict[str, list[str]]:
    """Name of a class -> the recordings to teach it from, as they were typed."""
    lessons: dict[str, list[str]] = {}
    for name, *sources in args.lessons:
        if name in lessons:
            raise ValueError(f"--class {name} is given twice: give all of its recordings at once")
        if not sources:
            raise ValueError(f"--class {name} needs recordings behind the name")
        lessons[name] = sources
    return lessons


def _changed(option: str, name: str, change: Callable[[], Model]) -> Model:
    """The changed model. An error says which class it is about."""
    try:
        return change()
    except ValueError as error:
        raise ValueError(f"{option} {name}: {message_of(error)}") from None


# -- reading ---------------------------------------------------------------------------------------


@dataclass
class _Reader:
    """Reads recordings, cameras and network streams as the model sees them.

    Parameters
    ----------
    pixels : the pixels that the model sees.
    reading : options of `open_recording`.
    seconds : how long a live source is read.

    Attributes
    ----------
    left_out : recordings that were left out, and why, a line each.
    """

    pixels: ModelPixels
    reading: dict[str, Any]
    seconds: float
    left_out: list[str] = field(default_factory=list)
    _known: dict[bytes, tuple[str, str]] = field(default_factory=dict)

    def read_all(self, label: str, sources: Sequence[str]) -> list[np.ndarray]:
        """The events of each recording of a class.

        Raises
        ------
        ValueError, OSError : a source is of another sensor; there is no such file or folder; or no
            recording is left.
        """
        files: list[str | Path] = []
        for source in sources:
            path = user_path(source)
            if is_live(source):
                files.append(source)
            elif path.is_dir():
                files += recordings_under(path)
            else:
                files.append(path)
        found = []
        n_before = len(self.left_out)
        with progress(len(files), f"reading {label}") as bar:
            for file in files:
                events = self._read_new(label, file)
                if events is not None:
                    found.append(events)
                bar.update()
        left_out = self.left_out[n_before:]
        for line in left_out:
            note(f"left out: {line}")
        if not found:
            reason = left_out[-1] if left_out else "no recordings there"
            raise ValueError(f"--class {label}: nothing to learn it from ({reason})")
        return found

    def _read_new(self, label: str, file: str | Path) -> np.ndarray | None:
        """The events of a recording; None if it is left out."""
        try:
            events = self._live(file) if isinstance(file, str) else self.read_file(file)
        except (SourceError, FileNotFoundError):
            raise
        except EXPECTED_ERRORS as error:
            self.left_out.append(_with_name(file, message_of(error)))
            return None
        if not len(events):
            self.left_out.append(_with_name(file, self.pixels.no_events_message))
            return None
        first = self._known.setdefault(fingerprint(events), (label, str(file)))
        if first == (label, str(file)):
            return events
        if first[0] != label:
            raise ValueError(f"{file}: the same events as {first[1]}, which shows {first[0]}")
        self.left_out.append(f"{file}: the same events as {first[1]}")
        return None

    def read_file(self, path: Path, between_us: tuple[int, int] | None = None) -> np.ndarray:
        """The events of a file that the model sees."""
        if not path.exists():
            raise FileNotFoundError(f"no recording {path}")
        part = {} if between_us is None else {"between_us": between_us}
        recording, keep = self.pixels.open(path, **{**self.reading, **part})
        events: np.ndarray = keep(recording.read())
        return events

    def _live(self, name: str) -> np.ndarray:
        """The events of the first seconds of a camera or a network stream."""
        parts = [np.empty(0, EVENT_DTYPE)]
        with open_source(name, self.pixels.expected) as source:
            keep = self.pixels.filter_of(name, source.sensor)
            where = getattr(source, "url", name)
            note(f"{where}: {self.seconds:g} s from the first event on")
            first_us = None
            for packet in source:
                events = as_events(keep(packet), source.sensor)
                if not len(events):
                    continue
                parts.append(events)
                first_us = int(events["t"][0]) if first_us is None else first_us
                if events["t"][-1] >= first_us + 1e6 * self.seconds:
                    break
        return np.concatenate(parts)


def _with_name(file: str | Path, message: str) -> str:
    return message if str(file) in message else f"{file}: {message}"


@dataclass(frozen=True)
class _File:
    """A labelled recording that is read when it is needed.

    Parameters
    ----------
    reader : reads its file.
    recording : the file, and the part of it.
    bar : counts what was read.
    kept : the events of the first `MOST_KEPT` recordings of its class that were read. `read` adds
        its own.
    """

    reader: _Reader
    recording: LabelledRecording
    bar: Bar
    kept: list[np.ndarray]

    def read(self) -> np.ndarray:
        """The events that the model sees."""
        self.bar.update()
        events = self.reader.read_file(self.recording.path, self.recording.between_us)
        if len(self.kept) < MOST_KEPT:
            self.kept.append(events)
        return events


def _with_statistics(model: Model, folder: Path, reader: _Reader) -> Model:
    """The model with statistics from the recordings of a data set."""
    found = find_recordings(folder, "Train")
    kept: dict[str, list[np.ndarray]] = {name: [] for name in found}
    try:
        with progress(sum(map(len, found.values())), "reading") as bar:
            recordings = {
                name: [_File(reader, file, bar, kept[name]) for file in files]
                for name, files in found.items()
            }
            model = model.with_statistics(recordings)
        labels = [label for label, name in enumerate(model.classes) for _ in kept[name]]
        events = Recordings.from_events(chain(*(kept[name] for name in model.classes)), labels)
        return with_nothing(model, windows_of(events, model.config))
    except SourceError:
        raise
    except ValueError as error:
        raise ValueError(f"--statistics {folder}: {message_of(error)}") from None


# -- what is printed -------------------------------------------------------------------------------


def _print(
    args: argparse.Namespace, model: Model, names: Sequence[str], left_out: Sequence[str]
) -> None:
    """Print what was taught, what it costs the other classes, and the file."""
    n_bytes = args.out.stat().st_size
    taught = {name: model.record["taught"][name] for name in names}
    if args.json:
        report = {
            "out": str(args.out),
            "bytes": n_bytes,
            "classes": list(model.classes),
            "taught": taught,
            "forgotten": args.forget,
            "left_out": list(left_out),
        }
        say(json.dumps(report))
        return
    for name, entry in taught.items():
        say(*lesson_lines(name, entry))
    say(f"wrote {args.out}: {len(model.classes)} classes, {n_bytes / 1e6:.1f} MB")
