"""async-tnt plot: draw events, volumes and decisions or outputs of a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from async_tnt.base.files import check_ours, user_path
from async_tnt.cli.options import (
    MODELS_TEXT,
    SUFFIXES_TEXT,
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
from async_tnt.sources.files.recording import open_recording
from async_tnt.views.figure_objects import draw_window_objects
from async_tnt.views.figure_overview import draw_overview
from async_tnt.views.figure_style import FORMATS, check_picture, save, styled
from async_tnt.views.figure_subject import Subject
from async_tnt.volume.config import TIME_IMAGES, TNTConfig, with_an_end
from async_tnt.volume.sensor import check_sensor, format_size

DPI = 100
"""Pixels per inch. Figures are 10.4 inches wide."""
DEFAULT_MODEL = "digits"
DEFAULT_SAMPLE = 3
"""The digit of the bundled recording that is drawn if no file is given."""

REMOVED = {"--start-us": "windows begin with the first event; choose one with --window K"}

DESCRIPTION = """\
Draw what happens to the events of a recording, on one page, as PNG, SVG or PDF: the
events of a window in space and time, raw and transformed; the bins of both volumes; the
probability of each class during the recording. With a model that finds objects, the
page shows where they are found, at three moments of the window. With a model of raw
outputs it shows these at the ends of up to five windows: two channels as directions, one
as grey, more by the largest one, numbers as bars.

Events and volumes are drawn as the model makes them, or by the options. Decisions and
outputs are always of the model's own volume: a network knows only the kind of volume
that it was trained on.

  async-tnt plot                                  a bundled recording of a 3
  async-tnt plot 8 --window 2 --out eight.svg     the second window of the bundled 8
  async-tnt plot my.npz --volume landmark=line,remove_flow=yes,t_max=2

`async-tnt train` draws what motion re-synthesis makes of a window.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "file",
        nargs="?",
        metavar="FILE",
        default=str(DEFAULT_SAMPLE),
        help=f"recording ({SUFFIXES_TEXT}), or the digit of a bundled one (default: %(default)s)",
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
        help=f"{MODELS_TEXT} (default: {DEFAULT_MODEL}, if it fits the recording's sensor)",
    )
    parser.add_argument(
        "--window",
        type=positive_int,
        default=1,
        metavar="K",
        help="the window that is drawn, counted from 1 (default: 1)",
    )
    add_reading(parser)
    volume_group = parser.add_argument_group("the volume, if other than the model's")
    add_volume(
        volume_group, "the model's; only volume and count can be drawn, always also untransformed"
    )
    volume_group.add_argument(
        "--window-us", type=positive_int, metavar="US", help="length of a window, in microseconds"
    )
    volume_group.add_argument(
        "--sensor", type=size_of, metavar="WxH", help="the camera's pixels, if not in the file"
    )


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt plot`. Returns the exit code."""
    path = sample_or_path(user_path(args.file))
    out = args.out or Path(f"{path.stem}.png")
    check_picture(out)
    if args.out is None:
        # The name is not the user's choice, so it may be that of another program's picture. Ours
        # contains the name of this package.
        check_ours([out], ("async_tnt",))
    subject = subject_of(path, args)
    with styled():
        if subject.model is not None and subject.model.places is not None:
            figure = draw_window_objects(subject.window(args.window), subject.model)
        else:
            figure = draw_overview(subject, args.window)
        save(figure, out, DPI)
    if subject.model is None:
        sensor = format_size(subject.config.sensor)
        complain(
            f"{path}: no decisions, model {DEFAULT_MODEL} is not for {sensor} pixels (--model)"
        )
    say(f"{out} ({out.stat().st_size / 1e3:.0f} kB)")
    return 0


def subject_of(path: Path, args: argparse.Namespace) -> Subject:
    """The recording, with the model and the configuration by which it is drawn.

    Raises
    ------
    ValueError : the recording is empty, damaged or of another sensor; or the options do not fit
        each other or the model.
    OSError : a file is missing or not readable.
    """
    recording = open_recording(path, sensor=args.sensor, **reading_of(args))
    check_sensor(path, recording.sensor, args.sensor, "--sensor says")
    name = args.model or DEFAULT_MODEL
    model = model_of(name)
    window_events = model.config.window_events or model.config.last_events
    if window_events is not None:
        raise ValueError(
            f"{name}: windows of a duration can be drawn, but not of {window_events} events"
        )
    sensor = recording.sensor or model.config.sensor
    if model.config.slice_us is not None:
        raise ValueError(
            f"{name}: volumes of counts in slices have no picture here; `async-tnt view` shows them"
        )
    if min(sensor) == 1:
        raise ValueError(
            f"{path}: the picture shows volumes after the transform, and a line of "
            f"{format_size(sensor)} pixels has no plane to transform; `async-tnt view` shows it"
        )
    recording.sensor = sensor

    if model.places is not None:
        if args.volume is not None or args.window_us is not None:
            raise ValueError(
                f"{name} finds objects, in its own volume: --volume and --window-us cannot be used "
                "with it"
            )
        model = model.for_sensor(sensor)
        return Subject(path.name, recording.read(), model.config, model, name)

    if sensor == model.config.sensor:
        config = _changed_config(model.config, args)
        return Subject(path.name, recording.read(), config, model, name)
    if args.model is not None:
        check_sensor(path, sensor, model.config.sensor)
    # the default model does not fit the sensor, so only events and volumes are drawn
    config = _changed_config(model.config.replace(sensor=sensor, grid=sensor), args)
    return Subject(path.name, recording.read(), config, None, name)


def _changed_config(config: TNTConfig, args: argparse.Namespace) -> TNTConfig:
    """The configuration, with the changes of --volume and --window-us.

    Raises
    ------
    ValueError : the changed configuration cannot be drawn, or the changes do not fit each other.
    """
    changes = volume_of(args.volume)
    if args.window_us is not None:
        changes["window_us"] = args.window_us
    # the flow can be removed only with the landmark `line`
    if changes.get("landmark", "line") != "line":
        changes.setdefault("remove_flow", False)
    # a window that slides has no end; it is drawn at the ends of stretches as long as itself
    config = with_an_end(config)
    kind = changes.get("representation", config.representation)
    if kind in TIME_IMAGES:
        raise ValueError(
            f"event volumes and counts can be drawn, but not {kind} (--model, --volume)"
        )
    # the figure shows both volumes, with the transform and without it
    transform = changes.setdefault("transform", "tnt")
    if transform != "tnt":
        raise ValueError(
            "--volume transform=none: the volume without the transform is drawn anyway, beside the "
            "other"
        )
    return config.replace(**changes)
