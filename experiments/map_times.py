"""The time that a map model takes from events to objects, on large sensors.

This time is compared with the time that it takes to compute the whole map.

    python -m experiments.map_times [--quick] [--ssla-rt PROGRAM WEIGHTS] [--json FILE]

The models are the bundled `digits-everywhere`, and four convolutions with random weights. They see
bundled recordings that stand anywhere on the sensor, with 1,400 events a window. Everything runs in
one warm process with one thread. At each moment these are timed in turn:

- `push` and `fire` with one event, which follows another event,
- `push` and `fire` with 1,000 more events,
- `push` and `fire` with the first event of a window,
- the whole map of a volume, by our engine and by ONNX Runtime.

Before anything is timed, our objects must be the same to the bit for any cut of the events into
packets. ONNX Runtime must give the same map as our engine, within 1e-4.

With --ssla-rt, SSLA-RT (https://github.com/haohq19/ssla-rt) is measured, too, by its own clock. It
has a network of its own, which drops three of four events at each of its stages. PROGRAM is
SSLA-RT's program `s2_decomp_st`. WEIGHTS is a folder that was written by SSLA-RT's
`tools/make_ssla_stub.py --h 240 --w 304`.

Last comes the load of a million events a second: recordings sped up, each moving across 320x240
pixels, with a decision every millisecond. The report has the processor time for each second of the
stream.
"""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from tempfile import TemporaryDirectory
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
import torch
from torch import nn

from async_tnt import Decision, Model, Processor, load_model
from async_tnt.base.progress import progress
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed import backends
from experiments.speed.interleaved import WorkDiffers
from experiments.speed.moving_recordings import moving
from experiments.speed.timing import latency, machine, no_collector, one_thread

SENSORS = ((128, 96), (304, 240), (640, 480))
"""Width and height of the sensors that are compared, in pixels."""

N_OBJECTS = 3
"""Number of recordings that stand on the sensor. Under load, each number up to this is measured."""

N_WINDOW_EVENTS = 1_400
"""Number of events of a window."""

N_MOMENTS = 300
"""Number of moments that are timed."""

SPEED_SENSOR = (320, 240)
"""Width and height of the sensor under load."""

RATE = 1_000_000
"""Events a second under load."""

EVERY_US = 1_000
"""Time between decisions under load, in microseconds."""


def four(channels: int) -> nn.Module:
    """Four convolutions, and a 1x1 convolution to the logits of ten classes and of "nothing".

    The map has a place for each 8x8 pixels. The last bias makes the answer "nothing" likely,
    because few places have an object.
    """
    widths = (channels, 16, 32, 32, 48)
    strides = (2, 2, 2, 1)
    layers: list[nn.Module] = []
    for k, stride in enumerate(strides):
        layers += [nn.Conv2d(widths[k], widths[k + 1], 3, stride, 1), nn.ReLU()]
    last = nn.Conv2d(widths[-1], 11, 1)
    assert last.bias is not None
    nn.init.ones_(last.bias[-1:])
    return nn.Sequential(*layers, last)


def models() -> dict[str, Model]:
    """The models by name, each for any sensor."""
    bundled = load_model("digits-everywhere")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        random_model = Model.from_torch(
            four(bundled.config.channels), bundled.config, bundled.classes
        )
    return {"digits-everywhere": bundled, "four convolutions": random_model}


def check(model: Model, events: np.ndarray, networks: dict[str, backends.Network]) -> None:
    """Check that objects do not depend on the cut into packets, and that all networks agree.

    Raises
    ------
    WorkDiffers : the objects differ, or the map of a network differs from ours.
    """
    at_once = Processor(model, start_us=0)
    in_parts = Processor(model, start_us=0)
    at_once.push(events)
    for part in np.array_split(events, 50):
        in_parts.push(part)
        in_parts.fire()
    decision = at_once.fire()
    if _objects(decision) != _objects(in_parts.fire()):
        raise WorkDiffers("objects depend on how the events are cut")
    volume = at_once.volume()
    for name, network in networks.items():
        difference = float(np.abs(network(volume) - decision.logits).max())
        if difference > (0.0 if name == "dense" else 1e-4):
            raise WorkDiffers(f"the map of {name} is {difference:g} away from ours")


def _objects(decision: Decision) -> list[Any]:
    """The objects of a decision without their numbers, which depend on earlier decisions."""
    return [replace(found_object, id=0) for found_object in decision.objects or ()]


def times(model: Model, n_moments: int) -> dict[str, Any]:
    """What is timed -> statistics of its time, in microseconds."""
    networks = backends.dense_networks(model)
    networks = {name: networks[name] for name in ("dense", "onnxruntime_run") if name in networks}
    duration_us = model.config.window_us * n_moments
    events = moving(model.config.sensor, N_OBJECTS, N_WINDOW_EVENTS * n_moments, duration_us, 20.0)
    check(model, events[:1_300], networks)
    # `continued` gets all events; `fresh` begins again at each moment
    continued = Processor(model, start_us=0)
    fresh = Processor(model, start_us=0)
    times_us: dict[str, list[float]] = {}

    def timed(name: str, work: Callable[[Any], object], argument: object) -> None:
        started = time.perf_counter()
        work(argument)
        times_us.setdefault(name, []).append(1e6 * (time.perf_counter() - started))

    def decide(processor: Processor) -> Callable[[Any], object]:
        return lambda events: (processor.push(events), processor.fire())

    with no_collector():
        for k in range(n_moments):
            new_events = events[N_WINDOW_EVENTS * k : N_WINDOW_EVENTS * (k + 1)]
            decide(continued)(new_events[:299])
            # This decision is not timed. It fills the caches again, after a dense pass has emptied
            # them.
            decide(continued)(new_events[299].item())
            timed("one event", decide(continued), new_events[300].item())
            timed("1,000 events", decide(continued), new_events[301:1301])
            volume = continued.volume()
            fresh.reset()
            timed("new window", decide(fresh), new_events[0].item())
            decide(fresh)(new_events)
            for name, network in networks.items():
                timed(name, network, volume)
    # the first tenth is left out, because caches and branch predictors get warm in it
    warm_times_us = {
        name: np.array(values[len(values) // 10 :]) for name, values in times_us.items()
    }
    return {name: latency(values) for name, values in warm_times_us.items()}


def ssla_rt(program: str, weights: str, *, n_moments: int) -> dict[str, float]:
    """The median and the 99th percentile of an event's time in SSLA-RT, in microseconds."""
    events = moving(SENSORS[1], N_OBJECTS, N_WINDOW_EVENTS * n_moments, 105_000 * n_moments, 20.0)
    with TemporaryDirectory() as folder:
        path = f"{folder}/events.npy"
        np.save(path, np.stack([events[name] for name in "txyp"], 1).astype(np.float32))
        command_words = [program, "--weights", weights, "--events", path]
        command_words += ["--warmup", str(len(events) // 10)]
        printed = subprocess.run(
            command_words, stdout=subprocess.PIPE, check=True, text=True
        ).stdout
    us_of_unit = {"ns": 1e-3, "us": 1.0, "ms": 1e3}
    rows = re.findall(r"(p50|p99) +: ([\d.]+) (.s)", printed)
    percentiles_us = {name: float(n) * us_of_unit[unit] for name, n, unit in rows}
    return {"median": percentiles_us["p50"], "p99": percentiles_us["p99"]}


def load(model: Model, n_objects: int, seconds: float) -> float:
    """Processor seconds for each second of the stream, under load."""
    events = moving(SPEED_SENSOR, n_objects, int(RATE * seconds), int(1e6 * seconds), 100.0)
    packets = [events[first : first + 1_000].copy() for first in range(0, len(events), 1_000)]
    processor = Processor(model.for_sensor(SPEED_SENSOR), start_us=0, every_us=EVERY_US)
    for packet in packets[:20]:
        processor.push(packet)
    processor.reset()
    started = time.process_time()
    for packet in packets:
        processor.push(packet)
    return (time.process_time() - started) / seconds


def measure(quick: bool, peer: tuple[str, str] | None) -> dict[str, Any]:
    """The report. `peer` is the program of SSLA-RT and its weights, or None."""
    n_moments = 20 if quick else N_MOMENTS
    seconds = 0.05 if quick else 1.0
    rows: dict[str, Any] = {}
    models_by_name = models()
    with (
        progress(len(models_by_name) * (len(SENSORS) + N_OBJECTS), "times") as bar,
        one_thread(True),
    ):
        for name, model in models_by_name.items():
            rows[name] = {"times_us": {}, "load": {}}
            for sensor in SENSORS:
                size = "x".join(map(str, sensor))
                rows[name]["times_us"][size] = times(model.for_sensor(sensor), n_moments)
                bar.update()
            for n_objects in range(1, N_OBJECTS + 1):
                rows[name]["load"][str(n_objects)] = load(model, n_objects, seconds)
                bar.update()
    if peer:
        rows["SSLA-RT, its own network"] = {
            "times_us": {"304x240": {"one event": ssla_rt(*peer, n_moments=n_moments)}},
            "load": {},
        }
    left_out = backends.left_out({"onnxruntime": ("onnxruntime",)})
    return {"machine": machine("torch", "onnxruntime"), "models": rows, "left_out": left_out}


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write JSON if asked.

    Returns 1 if networks do not give the same results.
    """
    parser = script_parser("map_times", __doc__, "few moments")
    parser.add_argument(
        "--ssla-rt", nargs=2, metavar=("PROGRAM", "WEIGHTS"), help="measure it, too"
    )
    peer = parser.parse_args(argv).ssla_rt
    return run_script(parser, argv, lambda quick: measure(quick, peer), "map_times")


if __name__ == "__main__":
    exit_with(main)
