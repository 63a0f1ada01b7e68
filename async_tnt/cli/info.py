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

import numpy as np

from async_tnt.base.files import user_path
from async_tnt.base.progress import progress
from async_tnt.cli.options import SUFFIXES_TEXT, add_reading, reading_of, sample_or_path, size_of
from async_tnt.cli.output import (
    EXPECTED_ERRORS,
    can_print,
    complain,
    message_of,
    reach_text,
    say,
)
from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.networks.models.model import Model
from async_tnt.networks.nir.graph import Graph, in_order, read_graph
from async_tnt.networks.nir.relu_networks import is_of_relus
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
  async-tnt info net.nir                   a NIR graph

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
SMALL_FIELD = 4
"""Up to this many numbers, a field of a NIR graph is not named."""
N_HOT = 5
"""Number of hot pixels that are listed, at most. They are the busiest ones."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "what",
        nargs="+",
        metavar="WHAT",
        help=f"recordings ({SUFFIXES_TEXT}), or digits of bundled ones, folders, .safetensors "
        f"and .nir files or bundled models ({', '.join(bundled_models())})",
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
            report, lines = _describe(
                name, {"sensor": args.sensor, **reading_of(args)}, args.option_names
            )
        except EXPECTED_ERRORS as error:
            if len(args.what) == 1:
                raise
            message = message_of(error, args.option_names)
            complain(message if name in message else f"{name}: {message}")
            failed = True
            continue
        failed |= any("error" in recording for recording in report.get("recordings", ()))
        if args.json:
            say(json.dumps(report))
        else:
            say(*lines)
    return 2 if failed else 0


def _describe(
    name: str, reading: Mapping[str, Any], option_names: Mapping[str, str]
) -> tuple[dict[str, Any], list[str]]:
    """Describe a recording, a folder or a model: as a dict for --json, and as lines of text.

    Parameters
    ----------
    name : the recording, the folder or the model, as it was typed.
    reading : arguments of `summarize`.
    option_names : parameter -> the option that gives it, for errors.
    """
    path = user_path(name)
    # a file or a folder that has the name of a bundled model is described instead of the model
    is_bundled = name in bundled_models() and not path.exists()
    if path.suffix.lower() == ".safetensors" or is_bundled:
        model = load_model(name)
        return {"model": name, **_model_report(model)}, list(_model_lines(name, model))
    if path.suffix.lower() == ".nir":
        graph = read_graph(path)
        return {"graph": name, **_graph_report(graph)}, list(_graph_lines(name, graph))
    if path.is_dir():
        return _describe_folder(path, reading, option_names)
    summary = summarize(sample_or_path(path), **reading)
    return asdict(summary), list(_recording_lines(summary))


def _recording_lines(summary: RecordingSummary) -> Iterator[str]:
    """Yield a recording's summary as lines of text."""
    yield f"{summary.recording}: {summary.format}, {summary.bytes / 1e6:,.1f} MB"
    for topic in summary.topics:
        mark = ", which is read" if topic["is_read"] else ""
        messages = f"{topic['messages']:,} messages"
        yield f"  topic      {topic['name']}: {topic['type']}, {messages}{mark}"
    if not summary.events:
        yield "  no events"
        return
    yield _sensor_line(summary)
    seconds = (summary.last_us - summary.first_us) * 1e-6
    yield f"  time       {summary.first_us:,} to {summary.last_us:,} us: {seconds:,.3f} s"
    rate = f", {summary.events / seconds:,.0f} a second" if seconds else ""
    yield f"  events     {summary.events:,}{rate}; {summary.on / summary.events:.0%} ON"
    if summary.off_sensor:
        yield f"  off sensor {summary.off_sensor:,} more events lie off the sensor and are left out"
    if summary.unsorted:
        yield f"  unsorted   {summary.unsorted:,} are earlier than the event before them"
    yield f"  rate       {_rate_bars(summary)} up to {max(summary.events_a_second):,.0f} a second"
    if summary.hot_pixels:
        n_hot = len(summary.hot_pixels)
        share = sum(pixel["events"] for pixel in summary.hot_pixels) / summary.events
        places = ", ".join(f"({pixel['x']}, {pixel['y']})" for pixel in summary.hot_pixels[:N_HOT])
        ellipsis = ", ..." if n_hot > N_HOT else ""
        activity = f"{n_hot} make {share:.1%} of the events"
        yield f"  hot pixels {activity}: {places}{ellipsis}; see async-tnt mask"


def _sensor_line(summary: RecordingSummary) -> str:
    """A line about a recording's sensor. Without a known sensor, it says how far events reach."""
    if summary.sensor is not None:
        origin = "" if summary.sensor_stated else ", as given"
        return f"  sensor     {format_size(summary.sensor)}{origin}"
    strays = "" if summary.reach == summary.extent else f", and strays {format_size(summary.reach)}"
    reach = f"events reach {format_size(summary.extent)}{strays}"
    return f"  sensor     not stated; {reach}; for hot pixels give --sensor WxH"


def _rate_bars(summary: RecordingSummary) -> str:
    """A row of bars: the rate of events in each part of a recording.

    A part with few events still has the lowest bar. Only a part without events has none.
    """
    # the first character stands for a part without events
    bars = BARS if can_print(BARS, sys.stdout) else ASCII_BARS
    most = max(summary.events_a_second)
    row = ""
    for rate in summary.events_a_second:
        height = round(rate / most * (len(bars) - 1))
        if rate > 0:
            height = max(1, height)
        row += bars[height]
    return row


def _describe_folder(
    folder: Path, reading: Mapping[str, Any], option_names: Mapping[str, str]
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
                summary = summarize(sample_or_path(path), **reading)
                reports.append(asdict(summary))
                size = "-" if summary.sensor is None else format_size(summary.sensor)
                seconds = (summary.last_us - summary.first_us) * 1e-6
                lines.append(f"{name} {size:>9} {seconds:>11,.3f} s {summary.events:>12,} events")
                n_events += summary.events
            except EXPECTED_ERRORS as error:
                reports.append({"recording": str(path), "error": str(error)})
                lines.append(f"{name} cannot be read: {message_of(error, option_names)}")
            bar.update()
    counts = "no folders in it"
    if {*folders} != {"."}:
        counts = ", ".join(f"{name} {n}" for name, n in folders.items())
    head = f"{folder}: {len(paths)} recordings, {n_events:,} events; {counts}"
    return {"folder": str(folder), "folders": folders, "recordings": reports}, [head, *lines]


def _model_report(model: Model) -> dict[str, Any]:
    """What a model holds, as --json prints it."""
    return {
        "classes": model.classes,
        "outputs": {name: list(shape) for name, shape in model.output_shapes.items()},
        "config": model.config.to_dict(),
        "volume": model.config.shape,
        "layers": {
            name: [layer["op"] for layer in layers] for name, layers in model.network.items()
        },
        "weights": sum(weights.size for weights in model.weights.values()),
        **_cost_report(model),
        "map": None if model.places is None else model.logits_shape[1:],
        "statistics": _statistics_report(model),
        "record": model.record,
    }


def _statistics_report(model: Model) -> dict[str, Any] | None:
    """What a model keeps about its classes for teaching more of them; None if it keeps nothing."""
    statistics = model.statistics
    if statistics is None:
        return None
    return {
        "bytes": statistics.n_bytes,
        "layer": statistics.layer,
        "components": statistics.n_components,
        "trained": list(statistics.trained),
        "taught": list(statistics.margins),
    }


def _graph_report(graph: Graph) -> dict[str, Any]:
    """What a NIR graph holds, as --json prints it."""
    nodes = {}
    for node in graph.nodes.values():
        shapes = {
            field: list(np.shape(values))
            for field, values in node.fields.items()
            if isinstance(values, np.ndarray)
        }
        nodes[node.name] = {"type": node.kind, "shapes": shapes}
    return {"nodes": nodes, "edges": graph.edges}


def _graph_lines(name: str, graph: Graph) -> Iterator[str]:
    """Yield the nodes of a NIR graph, as lines of text."""
    is_relu = is_of_relus(graph)
    kind = " of a network of ReLUs" if is_relu else ""
    yield f"{name}: NIR graph{kind}, {len(graph.nodes)} nodes, {len(graph.edges)} edges"
    sources: dict[str, list[str]] = {node: [] for node in graph.nodes}
    for source, target in graph.edges:
        sources[target].append(source)
    try:
        nodes = in_order(graph)
    except NotImplementedError:  # it has a circle
        nodes = list(graph.nodes.values())
    for node in nodes:
        read = f" reads {', '.join(sources[node.name])}" if sources[node.name] else ""
        shapes = [
            f"{field} {'x'.join(map(str, values.shape))}"
            for field, values in node.fields.items()
            if isinstance(values, np.ndarray) and values.size > SMALL_FIELD
        ]
        text = f"; {', '.join(shapes)}" if shapes else ""
        yield f"  {node.name:<10} {node.kind}{read}{text}"
    reset = "" if is_relu else " --reset subtract"
    yield f"  a model of it: async-tnt export {name}{reset} --out FILE.safetensors"


def _cost_report(model: Model) -> dict[str, int]:
    """The size of a model's work, as --json prints it."""
    if model.is_spiking:
        return {"neurons": model.n_neurons}
    return {
        "multiplications": model.multiplications,
        "multiplications_of_one_event": model.work_of_one_event.touched,
    }


def _model_lines(name: str, model: Model) -> Iterator[str]:
    """Yield what a model holds, as lines of text."""
    config = model.config
    report = _model_report(model)
    if model.outputs:
        shapes = report["outputs"].items()
        outputs = [f"{output} {'x'.join(map(str, shape))}" for output, shape in shapes]
        yield f"{name}: raw outputs: {', '.join(outputs)}"
    else:
        yield f"{name}: {len(model.classes)} classes: {', '.join(model.classes)}"

    grid = f"{format_size(config.sensor)}, grid {format_size(config.grid)}"
    if config.last_events is not None:
        length = f"the last {config.last_events:,} events"
    elif config.last_us is not None:
        length = f"the last {config.last_us:,} us"
    elif config.window_events is None:
        length = f"{config.window_us:,} us"
    else:
        length = f"{config.window_events:,} events"
    yield f"  sensor     {grid}, windows of {length}"

    # these fields are in the line above
    named_fields = ("sensor", "grid", "window_us", "window_events", "last_events", "last_us")
    settings = [
        f"{key} {value}"
        for key, value in config.to_dict().items()
        if value and key not in named_fields
    ]
    yield f"  volume     {'x'.join(map(str, config.shape))}: {', '.join(settings)}"

    layers = "; ".join(f"{part}: {', '.join(ops)}" for part, ops in report["layers"].items())
    yield f"  network    {layers}"
    if model.is_spiking:
        yield f"  cost       {report['weights']:,} weights, {report['neurons']:,} neurons"
        yield "  one event  goes through all layers: `async-tnt bench` counts its spikes"
    else:
        multiplications = f"{report['multiplications']:,} multiplications a complete window"
        yield f"  cost       {report['weights']:,} weights, {multiplications}"
        yield f"  one event  {reach_text(model.work_of_one_event)}"
    if model.places is not None:
        yield f"  decides    objects, at {report['map'][1]}x{report['map'][0]} places of the sensor"
    if model.statistics is not None:
        taught = ", ".join(model.statistics.margins) or "none yet"
        yield (
            f"  teach      more classes, from {model.statistics.n_bytes / 1e6:.1f} MB of "
            f"statistics; taught: {taught}"
        )
    for key, value in model.record.items():
        if isinstance(value, (str, int, float)):
            yield f"  {key:<10} {value}"
    yield "  all of its training record: --json"
