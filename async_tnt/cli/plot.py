"""async-tnt plot: draw events, volumes and decisions of a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from async_tnt.base.files import check_ours, user_path
from async_tnt.cli.options import (
    MODELS,
    READABLE,
    add_reading,
    add_volume,
    model_of,
    positive_int,
    reading_of,
    sample_or_path,
    size_of,
    volume_of,
)
from async_tnt.cli.output import complain, say
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import open_recording
from async_tnt.views.figure_objects import draw_window_objects
from async_tnt.views.figure_overview import draw_overview
from async_tnt.views.figure_style import FORMATS, check_picture, save, styled
from async_tnt.views.figure_subject import Subject
from async_tnt.volume.config import TIME_IMAGES, TNTConfig
from async_tnt.volume.sensor import check_sensor, format_size

DPI = 100  # figures are 10.4 inches wide
DEFAULT_MODEL = "digits"
DEFAULT_SAMPLE = 3

DESCRIPTION = """Draw what happens to the events of a recording, on one page, as PNG, SVG or PDF: a window's events in
space-time, raw and transformed, the bins of both volumes, and the probability of each class during the recording.
With a model that finds objects: where they are found, at three moments of the window.

Events and volumes are drawn as the model makes them, or by the options. Decisions always use the model's own
volume: a network only knows the kind of volume that it was trained on.

  async-tnt plot                                         a bundled recording of a 3
  async-tnt plot 8 --window 2 --out eight.svg            the second window of the bundled 8
  async-tnt plot my.npz --volume landmark=line,remove_flow=yes,t_max=2

async-tnt train draws what motion re-synthesis makes of a window.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        nargs="?",
        metavar="FILE",
        default=str(DEFAULT_SAMPLE),
        help=f"recording ({READABLE}), or the digit of a bundled one (default: %(default)s)",
    )
    parser.add_argument(
        "--out",
        type=user_path,
        metavar="FILE",
        help=f"{', '.join(FORMATS)} (default: <recording>.png in the current folder)",
    )
    parser.add_argument(
        "--model",
        metavar="NAME|FILE",
        help=f"{MODELS} (default: {DEFAULT_MODEL}, if it fits the recording's sensor)",
    )
    add_reading(parser)
    what = parser.add_argument_group("what is drawn")
    what.add_argument(
        "--window",
        type=positive_int,
        default=1,
        metavar="K",
        help="the window, counted from 1 (default: 1)",
    )
    what.add_argument(
        "--start-us",
        type=int,
        metavar="US",
        help="start of the first window (default: the first event)",
    )
    volume = parser.add_argument_group("the volume, if other than the model's")
    add_volume(
        volume, "the model's; volume and count are drawn, and without the transform in any case"
    )
    volume.add_argument(
        "--window-us", type=positive_int, metavar="US", help="length of a window, in microseconds"
    )
    volume.add_argument(
        "--sensor", type=size_of, metavar="WxH", help="the camera's pixels, if not in the file"
    )


def main(args: argparse.Namespace) -> int:
    path = sample_or_path(user_path(args.file))
    out = args.out or Path(f"{path.stem}.png")
    check_picture(out)
    if args.out is None:
        check_ours([out], ("async_tnt",))
    subject = subject_of(path, args)
    with styled():
        if subject.model is not None and subject.model.places is not None:
            save(draw_window_objects(subject.window(args.window), subject.model), out, DPI)
        else:
            save(draw_overview(subject, args.window), out, DPI)
    if subject.model is None:
        sensor = format_size(subject.config.sensor)
        complain(
            f"{path}: no decisions, model {DEFAULT_MODEL} is not for {sensor} pixels (--model)"
        )
    say(f"{out} ({out.stat().st_size / 1e3:.0f} kB)")
    return 0


def subject_of(path: Path, args: argparse.Namespace) -> Subject:
    """The recording, and how it is drawn by the model and the options.

    Raises
    ------
    ValueError : empty or damaged, of another sensor, or options that do not fit each other or the
        model.
    OSError : a file is missing or not readable.
    """
    recording = open_recording(path, sensor=args.sensor, **reading_of(args))
    check_sensor(path, recording.sensor, args.sensor, "--sensor says")
    name = args.model or DEFAULT_MODEL
    trained = model_of(name)
    if (n := trained.config.window_events) is not None:
        raise ValueError(f"{name}: windows of a duration can be drawn, but not of {n} events")
    sensor = recording.sensor or trained.config.sensor
    recording.sensor = sensor
    if trained.places is not None:
        if args.volume is not None or args.window_us is not None:
            raise ValueError(
                f"{name} finds objects, in its own volume: --volume and --window-us cannot be used "
                "with it"
            )
        model = trained.for_sensor(sensor)
        return Subject(path.name, recording.read(), model.config, model, name, args.start_us)
    decides: Model | None = trained
    config = trained.config
    if sensor != config.sensor:
        if args.model is not None:
            check_sensor(path, sensor, config.sensor)
        decides, config = None, config.replace(sensor=sensor, grid=sensor)
    return Subject(
        path.name, recording.read(), _configured(config, args), decides, name, args.start_us
    )


def _configured(config: TNTConfig, args: argparse.Namespace) -> TNTConfig:
    """A configuration with the options' changes."""
    changes = volume_of(args.volume)
    if args.window_us is not None:
        changes["window_us"] = args.window_us
    if changes.get("landmark", "line") != "line":  # a model's own flow removal goes with its line
        changes.setdefault("remove_flow", False)
    if (kind := changes.get("representation", config.representation)) in TIME_IMAGES:
        raise ValueError(
            f"event volumes and counts can be drawn, but not {kind} (`model`, `volume`)"
        )
    if changes.setdefault("transform", "tnt") != "tnt":
        raise ValueError(
            "--volume transform=none: the volume without the transform is drawn anyway, beside the "
            "other"
        )
    return config.replace(**changes)
