"""async-tnt plot: draw events, volumes and decisions of a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from async_tnt.checks import needs_extra
from async_tnt.cli.options import positive_int, size_of
from async_tnt.cli.output import complain, say
from async_tnt.config import LANDMARKS, POLARITIES, TIME_IMAGES, TNTConfig
from async_tnt.events import as_events
from async_tnt.files import check_writable
from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.networks.model import Model
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.recording import Recording, open_recording, sample_recordings
from async_tnt.sources.sensor import check_sensor, format_size
from async_tnt.views.figure_events import draw_events
from async_tnt.views.figure_heatmap import draw_heatmap
from async_tnt.views.figure_motions import draw_motions
from async_tnt.views.figure_overview import draw_overview
from async_tnt.views.figure_pipeline import draw_pipeline
from async_tnt.views.figure_probabilities import draw_probabilities
from async_tnt.views.figure_slices import draw_slices
from async_tnt.views.figure_style import FORMATS, save, styled
from async_tnt.views.figure_subject import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = {
    "overview": "a window's events and volumes, and the class probabilities, on one page",
    "events": "a window's events in space-time: raw (x, y, t) and transformed (u, v, t)",
    "slices": "the bins of a window's raw and transformed volume as pictures",
    "probabilities": "the probability of each class during the recording",
    "motions": "one digit under two motions, two windows or two files: raw against transformed",
    "heatmap": "what a landmark network looks at while a window's events arrive (a model with landmark regressor)",
    "pipeline": "recording, raw events, landmark, transformed events, volume, network, probabilities",
}
VOLUME_OPTIONS = ("landmark", "t_max", "polarity", "remove_flow", "bins", "window_us", "grid")
DRAWN_FREELY = ("overview", "events", "slices", "motions")  # the other figures draw what the model's network sees
USED_BY = {option: DRAWN_FREELY for option in VOLUME_OPTIONS} | {
    "window": ("overview", "events", "slices", "heatmap", "pipeline"),
    "windows": ("motions",),
    "slices": ("overview", "slices", "motions"),
    "every_us": ("overview", "probabilities"),
}
DEFAULT_MODEL = "digits"
DEFAULT_SAMPLE = 3

_LIST = "\n".join(f"  {name:<14} {words}" for name, words in FIGURES.items())
DESCRIPTION = f"""Draw what happens to the events of a recording, as PNG, SVG or PDF.

{_LIST}

Events and volumes are drawn as the model makes them, or by the options. Decisions always use the model's own
volume: a network only knows the kind of volume that it was trained on.

  async-tnt plot                                         overview of a bundled recording of a 3
  async-tnt plot 8 --figure pipeline --out eight.svg     of the bundled 8
  async-tnt plot --figure motions --windows 1 2          two saccades of one recording
  async-tnt plot right.npy down.npy --figure motions     two recordings
  async-tnt plot my.npz --figure events --landmark line --remove-flow --t-max 2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        nargs="*",
        metavar="FILE",
        type=str,
        help=f"recording ({', '.join(sorted(READERS))}), or the digit of a bundled one (default: {DEFAULT_SAMPLE}); "
        "two of them for --figure motions",
    )
    parser.add_argument("--figure", choices=tuple(FIGURES), default="overview", help="default: %(default)s")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=f"{', '.join(FORMATS)} (default: <recording>-<figure>.png in the current folder)",
    )
    parser.add_argument(
        "--model",
        metavar="NAME|FILE",
        help=f"a bundled model ({', '.join(bundled_models())}) or a .safetensors file (default: {DEFAULT_MODEL}, "
        "if it fits the recording's sensor)",
    )
    what = parser.add_argument_group("what is drawn")
    what.add_argument(
        "--window", type=positive_int, metavar="K", help="the window, counted from 1; for all but motions (default: 1)"
    )
    what.add_argument(
        "--windows",
        type=positive_int,
        nargs=2,
        metavar=("K", "K"),
        help="the two windows of --figure motions (default: 1 2; of two files: the first of each)",
    )
    what.add_argument("--start-us", type=int, metavar="US", help="start of the first window (default: the first event)")
    what.add_argument("--slices", type=int, nargs="+", metavar="B", help="bins to draw, counted from 0 (default: all)")
    what.add_argument(
        "--every-us",
        type=positive_int,
        metavar="US",
        help="time between decisions (default: 2500; more for recordings longer than 5 s)",
    )
    volume = parser.add_argument_group("the volume, if other than the model's")
    volume.add_argument("--landmark", choices=LANDMARKS, help="the point events are normalized about")
    volume.add_argument("--t-max", type=float, metavar="T", help="TNT time at a window's end")
    volume.add_argument("--polarity", choices=POLARITIES, help="ON minus OFF, both alike, or in separate bins")
    volume.add_argument(
        "--remove-flow", action=argparse.BooleanOptionalAction, help="subtract the fitted flow (landmark line)"
    )
    volume.add_argument("--bins", type=positive_int, metavar="B", help="time bins")
    volume.add_argument("--window-us", type=positive_int, metavar="US", help="length of a window, in microseconds")
    volume.add_argument("--sensor", type=size_of, metavar="WxH", help="the camera's pixels, if not in the file")
    volume.add_argument("--grid", type=size_of, metavar="WxH", help="the volume's pixels")
    parser.add_argument(
        "--dpi",
        type=_dpi,
        default=150,
        metavar="N",
        help="pixels per inch; figures are 10.4 inches wide (default: 150)",
    )


def main(args: argparse.Namespace) -> int:
    with needs_extra("plot", "plot draws with matplotlib"):
        import matplotlib  # noqa: F401
    _check_options(args)
    paths = _paths(args)
    out = args.out or Path("-".join(path.stem for path in paths) + f"-{args.figure}.png")
    check_writable(out, FORMATS)
    subjects = [subject_of(path, args) for path in paths]
    with styled():
        figure = _draw(subjects, args)
        save(figure, out, args.dpi)
    width, height = figure.get_size_inches()
    size = f"{width:g} x {height:.1f} inches"
    if out.suffix.lower() == ".png":
        size = f"{int(width * args.dpi)} x {int(height * args.dpi)} pixels"
    if args.figure == "overview" and subjects[0].model is None:
        sensor = format_size(subjects[0].config.sensor)
        complain(f"{paths[0]}: no decisions, model {DEFAULT_MODEL} is not for {sensor} pixels (--model)")
    say(f"{out} ({size}, {out.stat().st_size / 1e3:.0f} kB)")
    return 0


def subject_of(path: Path, args: argparse.Namespace) -> Subject:
    """The recording, and how it is drawn by the model and the options.

    Raises
    ------
    ValueError : empty or damaged, events off the sensor, or options that do not fit each other or the model.
    OSError : a file is missing or not readable.
    """
    recording = open_recording(path)
    trained = load_model(args.model or DEFAULT_MODEL)
    model: Model | None = trained
    sensor = _sensor(recording, args, trained)
    config = trained.config
    if sensor != config.sensor:
        if args.model is not None or args.figure not in DRAWN_FREELY:
            advice = "" if args.model else f"; give another --model than {DEFAULT_MODEL}"
            check_sensor(path, sensor, config.sensor, advice=advice)
        model, config = None, config.replace(sensor=sensor, grid=sensor)
    config = _configured(config, args)
    try:
        events = as_events(recording.read(), sensor)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None
    if events.size == 0:
        raise ValueError(f"{path}: no events to draw")
    return Subject(path.name, events, config, model, args.model or DEFAULT_MODEL, args.start_us)


def _paths(args: argparse.Namespace) -> list[Path]:
    samples = sample_recordings()
    paths = []
    for name in args.files or [str(DEFAULT_SAMPLE)]:
        is_digit = name.isdigit() and int(name) in samples and not Path(name).exists()
        paths.append(samples[int(name)] if is_digit else Path(name))
    most = 2 if args.figure == "motions" else 1
    if len(paths) > most:
        raise ValueError(f"--figure {args.figure} draws {most} recording{'s' * (most > 1)}, got {len(paths)}")
    return paths


def _check_options(args: argparse.Namespace) -> None:
    """Refuse options that the figure would silently ignore."""
    for option, figures in USED_BY.items():
        if getattr(args, option) is not None and args.figure not in figures:
            raise ValueError(
                f"--{option.replace('_', '-')} has no effect on --figure {args.figure}, only on {', '.join(figures)}"
            )


def _sensor(recording: Recording, args: argparse.Namespace, model: Model) -> tuple[int, int]:
    """The sensor of the file, else of --sensor, else of the model if all events lie on it."""
    if recording.sensor is not None:
        if args.sensor not in (None, recording.sensor):
            stated, given = format_size(recording.sensor), format_size(args.sensor)
            raise ValueError(f"{recording.path}: a sensor of {stated} pixels, got --sensor {given}")
        return recording.sensor
    if args.sensor is not None:
        return args.sensor
    events = recording.read()
    x, y = (int(events[name].max(initial=0)) for name in ("x", "y"))
    if args.model is None and (x >= model.config.sensor[0] or y >= model.config.sensor[1]):
        raise ValueError(f"{recording.path}: events reach pixel ({x}, {y}); give its size with --sensor WxH")
    return model.config.sensor


def _configured(config: TNTConfig, args: argparse.Namespace) -> TNTConfig:
    """A configuration with the options' changes."""
    changes = {name: getattr(args, name) for name in VOLUME_OPTIONS if getattr(args, name) is not None}
    if changes.get("landmark", "line") != "line":  # a model's own flow removal goes with its line
        changes.setdefault("remove_flow", False)
    if config.window_events is not None:
        raise ValueError(f"{args.model}: windows of a duration can be drawn, but not of {config.window_events} events")
    if config.representation in TIME_IMAGES:
        raise ValueError(f"{args.model}: event volumes and counts can be drawn, but not {config.representation}")
    if args.figure in DRAWN_FREELY and config.transform == "none":
        changes["transform"] = "tnt"
    return config.replace(**changes)


def _draw(subjects: list[Subject], args: argparse.Namespace) -> Figure:
    first, last = subjects[0], subjects[-1]
    number = args.window or 1
    match args.figure:
        case "motions":
            numbers = args.windows or ((1, 2) if first is last else (1, 1))
            return draw_motions(first.window(numbers[0]), last.window(numbers[1]), args.slices)
        case "events":
            return draw_events(first, number)
        case "slices":
            return draw_slices(first, number, args.slices)
        case "probabilities":
            return draw_probabilities(first, args.every_us)
        case "heatmap":
            return draw_heatmap(first, number)
        case "pipeline":
            return draw_pipeline(first, number)
        case _:
            return draw_overview(first, number, args.slices, args.every_us)


def _dpi(text: str) -> int:
    dpi = positive_int(text)
    if not 30 <= dpi <= 1200:
        raise argparse.ArgumentTypeError(f"must be in [30, 1200], got {dpi}")
    return dpi
