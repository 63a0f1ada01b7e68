"""async-tnt info: what recordings, folders and models hold."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from async_tnt.base.files import user_path
from async_tnt.base.progress import progress
from async_tnt.cli.options import READABLE, add_reading, reading_of, sample_or_path, size_of
from async_tnt.cli.output import can_print, complain, message_of, say
from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.labelled_recordings import recordings_under
from async_tnt.sources.recording_summary import RecordingSummary, summarize
from async_tnt.volume.sensor import format_size

DESCRIPTION = """\
Say what recordings, folders of recordings and models hold.

  async-tnt info desk.aedat4               a recording
  async-tnt info a.npy --sensor 346x260    one whose file does not state its sensor
  async-tnt info a.bag --topic /events     a ROS bag: its topics, the events of one
  async-tnt info gestures                  a folder: its classes, a line a recording
  async-tnt info digits mine.safetensors   models

Of a recording it says format, sensor, times, rates, share of ON events, unsorted events
and hot pixels; of a model classes, volume, network and training record.

Times are those of the file, in microseconds. The bars show events a second, from the
recording's earliest event to its latest; they are high where something moves. Exit code
2 if something cannot be read; the rest is shown.
"""
BARS = " ▁▂▃▄▅▆▇█"
"""Bars for rates of events, from none to the highest."""
ASCII_BARS = " .:-=+*#@"
"""Bars for an output that cannot print `BARS`."""
N_HOT = 5
"""Number of hot pixels that are listed: the busiest."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "what",
        nargs="+",
        metavar="WHAT",
        help=f"recordings ({READABLE}), or digits of bundled ones, folders, .safetensors files or "
        f"bundled models ({', '.join(bundled_models())})",
    )
    parser.add_argument(
        "--sensor",
        type=size_of,
        metavar="WxH",
        help="the camera's pixels, where a recording does not state them",
    )
    add_reading(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object for each, a line each")


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt info`. Returns the exit code."""
    failed = False
    for name in args.what:
        try:
            report, lines = _described(
                name, {"sensor": args.sensor, **reading_of(args)}, args.written
            )
        except (OSError, ValueError, ImportError, MemoryError) as error:
            if len(args.what) == 1:
                raise
            message = message_of(error, args.written)
            complain(message if name in message else f"{name}: {message}")
            failed = True
            continue
        failed |= any("error" in found for found in report.get("recordings", ()))
        if args.json:
            say(json.dumps(report))
        else:
            say(*lines)
    return 2 if failed else 0


def _described(
    name: str, reading: Mapping[str, Any], written: Mapping[str, str]
) -> tuple[dict[str, Any], list[str]]:
    """Describe a recording, a folder or a model: as a dict for --json, and as lines of text.

    Parameters
    ----------
    name : the recording, the folder or the model, as it was typed.
    reading : arguments of `summarize`.
    written : parameter -> the option that gives it, for errors.
    """
    path = user_path(name)
    if path.suffix.lower() == ".safetensors" or (name in bundled_models() and not path.exists()):
        model = load_model(name)
        return {"model": name, **_of_model(model)}, list(_model_lines(name, model))
    if path.is_dir():
        return _of_folder(path, reading, written)
    found = summarize(sample_or_path(path), **reading)
    return asdict(found), list(_recording_lines(found))


def _recording_lines(found: RecordingSummary) -> Iterator[str]:
    """Yield a recording's summary as lines of text."""
    yield f"{found.recording}: {found.format}, {found.bytes / 1e6:,.1f} MB"
    for topic in found.topics:
        is_read = ", which is read" if topic["is_read"] else ""
        messages = f"{topic['messages']:,} messages"
        yield f"  topic      {topic['name']}: {topic['type']}, {messages}{is_read}"
    if not found.events:
        yield "  no events"
        return
    yield _sensor_line(found)
    seconds = (found.last_us - found.first_us) * 1e-6
    yield f"  time       {found.first_us:,} to {found.last_us:,} us: {seconds:,.3f} s"
    rate = f", {found.events / seconds:,.0f} a second" if seconds else ""
    yield f"  events     {found.events:,}{rate}; {found.on / found.events:.0%} ON"
    if found.off_sensor:
        yield f"  off sensor {found.off_sensor:,} more events lie off the sensor and are left out"
    if found.unsorted:
        yield f"  unsorted   {found.unsorted:,} are earlier than the event before them"
    yield f"  rate       {_rate_bars(found)} up to {max(found.events_a_second):,.0f} a second"
    if found.hot_pixels:
        n_hot = len(found.hot_pixels)
        share = sum(pixel["events"] for pixel in found.hot_pixels) / found.events
        shown = ", ".join(f"({pixel['x']}, {pixel['y']})" for pixel in found.hot_pixels[:N_HOT])
        more = ", ..." if n_hot > N_HOT else ""
        make = f"{n_hot} make {share:.1%} of the events"
        yield f"  hot pixels {make}: {shown}{more}; see async-tnt mask"


def _sensor_line(found: RecordingSummary) -> str:
    """A line about a recording's sensor. Without a known sensor, it says how far events reach."""
    if found.sensor is not None:
        given = "" if found.sensor_stated else ", as given"
        return f"  sensor     {format_size(found.sensor)}{given}"
    strays = "" if found.reach == found.extent else f", and strays {format_size(found.reach)}"
    reach = f"events reach {format_size(found.extent)}{strays}"
    return f"  sensor     not stated; {reach}; for hot pixels give --sensor WxH"


def _rate_bars(found: RecordingSummary) -> str:
    """A row of bars: the rate of events in each part of a recording.

    A part with few events still has the lowest bar. Only a part without events has none.
    """
    bars = BARS if can_print(BARS, sys.stdout) else ASCII_BARS
    most = max(found.events_a_second)
    row = ""
    for rate in found.events_a_second:
        height = round(rate / most * (len(bars) - 1))
        if rate > 0:
            height = max(1, height)
        row += bars[height]
    return row


def _of_folder(
    folder: Path, reading: Mapping[str, Any], written: Mapping[str, str]
) -> tuple[dict[str, Any], list[str]]:
    """Describe all recordings below a folder: as a dict for --json, and as lines of text.

    Also count the recordings in each folder. In a data set, each folder is a class.
    """
    paths = recordings_under(folder)
    folders = Counter(str(path.parent.relative_to(folder)) for path in paths)
    reports = []
    lines = []
    n_events = 0
    with progress(len(paths), "reading") as bar:
        for path in paths:
            name = f"  {path.relative_to(folder)!s:<32}"
            try:
                found = summarize(sample_or_path(path), **reading)
                reports.append(asdict(found))
                size = "-" if found.sensor is None else format_size(found.sensor)
                seconds = (found.last_us - found.first_us) * 1e-6
                lines.append(f"{name} {size:>9} {seconds:>11,.3f} s {found.events:>12,} events")
                n_events += found.events
            except (OSError, ValueError, ImportError, MemoryError) as error:
                reports.append({"recording": str(path), "error": str(error)})
                lines.append(f"{name} cannot be read: {message_of(error, written)}")
            bar.update()
    counts = "no folders in it"
    if {*folders} != {"."}:
        counts = ", ".join(f"{name} {n}" for name, n in folders.items())
    head = f"{folder}: {len(paths)} recordings, {n_events:,} events; {counts}"
    return {"folder": str(folder), "folders": folders, "recordings": reports}, [head, *lines]


def _of_model(model: Model) -> dict[str, Any]:
    """What a model holds, as --json prints it."""
    return {
        "classes": model.classes,
        "config": model.config.to_dict(),
        "volume": model.config.shape,
        "layers": {
            name: [layer["op"] for layer in layers] for name, layers in model.network.items()
        },
        "weights": sum(weights.size for weights in model.weights.values()),
        "multiplications": model.multiplications,
        "map": None if model.places is None else model.logits_shape[1:],
        "record": model.record,
    }


def _model_lines(name: str, model: Model) -> Iterator[str]:
    """Yield what a model holds, as lines of text."""
    config = model.config
    found = _of_model(model)
    yield f"{name}: {len(model.classes)} classes: {', '.join(model.classes)}"

    grid = f"{format_size(config.sensor)}, grid {format_size(config.grid)}"
    if config.window_events is None:
        length = f"{config.window_us:,} us"
    else:
        length = f"{config.window_events:,} events"
    yield f"  sensor     {grid}, windows of {length}"

    other_lines = ("sensor", "grid", "window_us", "window_events")
    settings = [
        f"{key} {value}"
        for key, value in config.to_dict().items()
        if value and key not in other_lines
    ]
    yield f"  volume     {'x'.join(map(str, config.shape))}: {', '.join(settings)}"

    layers = "; ".join(f"{part}: {', '.join(ops)}" for part, ops in found["layers"].items())
    yield f"  network    {layers}"
    per_window = f"{found['multiplications']:,} multiplications a complete window"
    yield f"  cost       {found['weights']:,} weights, {per_window}"
    if model.places is not None:
        yield f"  decides    objects, at {found['map'][1]}x{found['map'][0]} places of the sensor"
    for key, value in model.record.items():
        if isinstance(value, (str, int, float)):
            yield f"  {key:<10} {value}"
    yield "  all of its training record: --json"
