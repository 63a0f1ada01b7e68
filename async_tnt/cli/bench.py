"""The command `async-tnt bench`: what an event and a decision cost on this machine."""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np

from async_tnt.base.package import __version__
from async_tnt.base.progress import progress
from async_tnt.cli.options import model_of
from async_tnt.cli.output import reach_text, say
from async_tnt.kernels.shipped import state_of_kernels
from async_tnt.networks.models.compiled import CompiledRegressor
from async_tnt.networks.models.compiled_network import compiled_network_of
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_volume import SpikingVolume
from async_tnt.sources.files.nmnist import SENSOR as SAMPLE_SENSOR
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.streaming.compile_ahead import warmup
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.streams import pieces_for
from async_tnt.volume.sensor import Sensor
from async_tnt.volume.volume import TNTVolume

REMOVED = {"--quick": "leave it out; a measurement takes some seconds"}

DESCRIPTION = """\
Measure on this machine, warm and on one thread:

  - how long an event takes on its way into the volume,
  - how long a decision takes, 1, 100 and 1,300 events after the previous decision,
    beside a pass through the whole network, and what one event reaches,
  - how many decisions a second are possible, with one after every event.

The events are those of the bundled recordings. They are spread over the model's sensor,
if that is another one. On a quiet machine the quartiles are close together.

  async-tnt bench                               the bundled model `digits`
  async-tnt bench --model mine.safetensors --json
"""

NEW_EVENTS = (1, 100, 1300)
"""Numbers of events between two decisions; the time of the second one is measured."""
PACKET_EVENTS = 1000
"""Number of events in a packet."""
ROUNDS = 50
"""How often all windows are pushed into the volume."""
N_MOMENTS = 50
"""Number of decisions that are timed in each recording."""
N_PASSES = 5
"""Number of passes through the whole network on each recording."""
N_EVENTS = 2000
"""Number of events of each recording that are pushed with a decision after every event."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "--model",
        metavar="NAME|FILE",
        default="digits",
        help="a bundled model or a file (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt bench`. Returns the exit code."""
    model = model_of(args.model)
    recordings, origin = _recordings_for(model.config.sensor)
    report: dict[str, Any] = {}
    with progress(len(NEW_EVENTS) + 3, "compiling") as bar:
        warmup(model)
        bar.update(title="events into the volume")
        report["ns_an_event"] = _spread(_volume_ns(model, recordings))
        bar.update(title="decisions")
        report["us_a_decision"] = {}
        for n_new in NEW_EVENTS:
            report["us_a_decision"][str(n_new)] = _spread(_decision_us(model, recordings, n_new))
            bar.update()
        if model.is_spiking:
            report |= _spiking_report(model, recordings)
        else:
            report["us_a_whole_pass"] = _spread(_whole_pass_us(model, recordings))
        bar.update()
        rates = _decisions_a_second(model, [events[:N_EVENTS] for events in recordings])
        report["decisions_a_second"] = _spread(rates)

    if not model.is_spiking:
        work = model.work_of_one_event
        report["multiplications"] = {"one_event": work.touched, "whole_pass": work.whole}
    report["machine"] = machine()
    report["kernels"] = state_of_kernels()
    report["model"] = {
        "name": args.model,
        "config": model.config.to_dict(),
        "classes": len(model.classes),
        "outputs": len(model.outputs),
    }
    report["events_from"] = origin
    if args.json:
        say(json.dumps(report))
    else:
        last = _spikes_text(report) if model.is_spiking else f"one event {reach_text(work)}"
        say(*_lines(report), last)
    return 0


def _recordings_for(sensor: Sensor) -> tuple[list[np.ndarray], str]:
    """The events of each bundled sample, and a description of the samples.

    If `sensor` has another size than the samples' sensor, the events are spread over `sensor`.
    """
    recordings = [open_recording(path).read() for path in sample_recordings().values()]
    if sensor == SAMPLE_SENSOR:
        return recordings, "bundled samples"
    for events in recordings:
        for axis, side, sample_side in zip("xy", sensor, SAMPLE_SENSOR, strict=True):
            events[axis] = events[axis].astype(np.int64) * side // sample_side
    return recordings, "bundled samples, spread over the sensor"


def _packets(events: np.ndarray) -> list[np.ndarray]:
    """Cut events into packets of `PACKET_EVENTS` events."""
    return [
        events[first : first + PACKET_EVENTS].copy()
        for first in range(0, events.size, PACKET_EVENTS)
    ]


def _first_window(model: Model, events: np.ndarray) -> np.ndarray:
    """The events of a recording's first window."""
    in_window = events["t"] < events["t"][0] + model.config.window_us
    window: np.ndarray = events[in_window][: model.config.window_events]
    return window


def _new_volume(model: Model) -> TNTVolume:
    """A volume of the model, which knows no end of a window."""
    if model.is_spiking:
        return SpikingVolume(model)
    regressor = CompiledRegressor(model) if model.config.needs_regressor else None
    return TNTVolume(model.config, regressor=regressor)


def _volume_ns(model: Model, recordings: list[np.ndarray]) -> Iterator[float]:
    """Yield the nanoseconds that one event takes on its way into the volume, once for each round.

    A round pushes the first window of every recording. Opening a window is not timed.
    """
    volume = _new_volume(model)
    windows = [_packets(_first_window(model, events)) for events in recordings]
    n_events = sum(packet.size for window in windows for packet in window)
    for _ in range(ROUNDS):
        duration_s = 0.0
        for window in windows:
            volume.open(int(window[0]["t"][0]))
            started = time.perf_counter()
            for packet in window:
                volume.update(packet)
            duration_s += time.perf_counter() - started
        yield 1e9 * duration_s / n_events


def _decision_us(model: Model, recordings: list[np.ndarray], n_new: int) -> Iterator[float]:
    """Yield the microseconds of each call of `fire`, `n_new` events after the previous decision.

    The calls are evenly spread over each recording.
    """
    processor = Processor(model)
    for events in recordings:
        processor.reset()
        n_pushed = 0
        for n_at_call in np.linspace(n_new, events.size, N_MOMENTS).astype(int):
            # The decision before the timed one comes after this number of events. It must not come
            # before the previous timed decision, or before the first event.
            n_before = n_at_call - n_new
            if n_before < max(n_pushed, 1):
                continue
            processor.push(events[n_pushed:n_before])
            processor.fire()
            processor.push(events[n_before:n_at_call])
            started = time.perf_counter()
            processor.fire()
            yield 1e6 * (time.perf_counter() - started)
            n_pushed = n_at_call


def _whole_pass_us(model: Model, recordings: list[np.ndarray]) -> Iterator[float]:
    """Yield the microseconds of passes through the whole network.

    There are `N_PASSES` for each recording, on the volume of its first window.
    """
    network = compiled_network_of(model)
    # not a Processor's volume, which is that of the next window once the events are complete
    volume = _new_volume(model)
    for events in recordings:
        window = _first_window(model, events)
        volume.open(int(window["t"][0]))
        volume.update(window)
        array = volume.array.copy()
        array.flags.writeable = False
        for _ in range(N_PASSES):
            started = time.perf_counter()
            network(array)
            yield 1e6 * (time.perf_counter() - started)


def _spiking_report(model: Model, recordings: list[np.ndarray]) -> dict[str, Any]:
    """How many spikes and additions of weights an event causes, by layer, on average."""
    volume = SpikingVolume(model)
    spikes = dict.fromkeys(volume.network.layers, 0)
    additions = dict.fromkeys(volume.network.layers, 0)
    n_events = 0
    for events in recordings:
        volume.open(int(events["t"][0]))
        volume.update(_first_window(model, events))
        n_events += volume.n_events
        for layer in spikes:
            spikes[layer] += volume.spikes(layer)
            additions[layer] += volume.additions(layer)
    return {
        "spikes_an_event": {layer: n / n_events for layer, n in spikes.items()},
        "additions_an_event": {layer: n / n_events for layer, n in additions.items()},
    }


def _spikes_text(report: dict[str, Any]) -> str:
    """Spikes and additions of an event, in words."""
    by_layer = [f"{layer} {n:.2f}" for layer, n in report["spikes_an_event"].items()]
    additions = sum(report["additions_an_event"].values())
    return f"one event causes spikes in layer {', '.join(by_layer)}; {additions:,.0f} weights added"


def _decisions_a_second(model: Model, recordings: list[np.ndarray]) -> Iterator[float]:
    """Yield the decisions a second in each recording, with a decision after every event."""
    processor: Processor[Any] = Processor(model, every_events=1)
    for events in recordings:
        processor.reset()
        packets = _packets(events)
        started = time.perf_counter()
        n_decisions = 0
        for packet in packets:
            for piece in pieces_for(processor, packet):
                n_decisions += len(processor.push(piece))
        yield n_decisions / (time.perf_counter() - started)


def _spread(values: Iterator[float]) -> dict[str, float]:
    """The median and the quartiles of the values, and the number of values."""
    measured = list(values)
    q1, median, q3 = np.percentile(measured, [25, 50, 75]).tolist()
    return {"median": median, "q1": q1, "q3": q3, "n": len(measured)}


def machine() -> dict[str, Any]:
    """The facts that a measurement depends on: processor, load, versions."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "cpu": _cpu_name(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "load_1min": None if load is None else round(load, 2),
        "python": platform.python_version(),
        "async_tnt": __version__,
        "numpy": np.__version__,
        "numba": numba.__version__,
    }


def _cpu_name() -> str:
    """The name of the processor's model, as the system reports it."""
    fields = {}
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                # every core has the same fields, so one value of each is enough
                name, _, value = line.partition(":")
                fields[name.strip()] = value.strip()
    except OSError:
        return platform.processor() or platform.machine()
    # Some virtual machines hide the name of the model ("Intel(R) Xeon(R) Processor"). The
    # numbers of the family and the model still identify it.
    name = fields.get("model name", "?")
    family = fields.get("cpu family", "?")
    return f"{name} (family {family}, model {fields.get('model', '?')})"


def _lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield the report as lines of text."""
    facts = report["machine"]
    config = report["model"]["config"]
    versions = [f"{name} {facts[name]}" for name in ("python", "async_tnt", "numpy", "numba")]
    load = f"load {facts['load_1min']}"
    yield f"{facts['cpu']}, {facts['cores']} cores, {load}; {', '.join(versions)}"

    yield f"kernels: {report['kernels']}"

    sensor = "{} x {}".format(*config["sensor"])
    pixels = f"{sensor} pixels, landmark {config['landmark']}"
    yield f"model {report['model']['name']}: {pixels}; {report['events_from']}"

    yield f"{'':44}{'median':>10}  quartiles"
    where = "the network" if "spikes_an_event" in report else "the volume"
    rows = {f"ns an event into {where}": report["ns_an_event"]}
    for n_new, spread in report["us_a_decision"].items():
        events = "event" if n_new == "1" else "events"
        rows[f"us a decision, {int(n_new):,} new {events}"] = spread
    if "us_a_whole_pass" in report:
        rows["us a pass through the whole network"] = report["us_a_whole_pass"]
    rows["decisions a second, one after every event"] = report["decisions_a_second"]
    for title, spread in rows.items():
        n_decimals = 0 if spread["median"] >= 1000 else 1
        quartiles = f"{spread['q1']:,.{n_decimals}f} to {spread['q3']:,.{n_decimals}f}"
        yield f"{title:44}{spread['median']:>10,.{n_decimals}f}  {quartiles}"
