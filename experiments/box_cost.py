"""What boxes cost beside points: a decision of a map model after one event, in one run.

    python -m experiments.box_cost [MODEL] [--quick] [--json FILE]

MODEL is a map model that says sizes; by default one with random weights, of `train`'s network and
ten classes. The model of points is the same without the last two channels of its map. Both see the
same moving recordings on two sensors, and take turns: 300 events that are not timed, then one event
and the decision. The classes and places of the objects must be equal, up to those that boxes
suppress.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
import torch

from async_tnt import Model, Processor, TNTConfig, load_model
from async_tnt.base.progress import progress
from experiments.map_times import moving
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.interleaved import WorkDiffers
from experiments.speed.timing import latency, machine, no_collector, one_thread

SENSORS = ((240, 180), (640, 480))
"""Width and height of the sensors, in pixels."""

N_MOMENTS = 1_000
"""Number of decisions of each model that are timed."""

N_BEFORE = 300
"""Number of events between two timed ones."""

N_OBJECTS = 3
"""Number of recordings that stand on the sensor."""


def random_model() -> Model:
    """A model with boxes and random weights, which finds a few objects."""
    from async_tnt.training.networks import build_network

    config = TNTConfig(representation="count")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = build_network("map", config.channels, config.grid, 10)
        last: Any = list(network.children())[-1]
        with torch.no_grad():
            last.weight.mul_(4)
            last.bias[10] += 1.0
    return Model.from_torch(network.eval(), config, [str(k) for k in range(10)])


def without_sizes(model: Model) -> Model:
    """The same model without the two channels of sizes."""
    n = len(model.classes) + 1
    *_, last = model.layers
    weights = dict(model.weights)
    for name in last["weights"].values():
        weights[name] = weights[name][:n]
    return replace(model, weights=weights)


def measure(model: Model, n_moments: int) -> dict[str, Any]:
    """Microseconds of a decision after one event, and the ratio of both models."""
    report = {}
    with progress(len(SENSORS) * n_moments, "decisions") as bar:
        for sensor in SENSORS:
            n = (N_BEFORE + 1) * n_moments
            events = moving(sensor, N_OBJECTS, n + N_OBJECTS, 75 * n, 20.0)
            processors = {
                "boxes": Processor(model.for_sensor(sensor)),
                "points": Processor(without_sizes(model).for_sensor(sensor)),
            }
            us: dict[str, list[float]] = {name: [] for name in processors}
            n_objects = 0
            with no_collector():
                for k in range(n_moments):
                    first = (N_BEFORE + 1) * k
                    packet = events[first : first + N_BEFORE]
                    one = events[first + N_BEFORE].item()
                    answers = {}
                    for name in processors if k % 2 else reversed(processors):
                        processor = processors[name]
                        processor.push(packet)
                        processor.fire()
                        started = time.perf_counter()
                        processor.push(one)
                        answers[name] = processor.fire()
                        us[name].append(1e6 * (time.perf_counter() - started))
                    _check(answers)
                    n_objects += len(answers["boxes"].objects or ())
                    bar.update()
            warm = {name: np.array(values[n_moments // 10 :]) for name, values in us.items()}
            medians = {name: float(np.median(values)) for name, values in warm.items()}
            report[f"{sensor[0]}x{sensor[1]}"] = {
                "us": {name: latency(values) for name, values in warm.items()},
                "ratio": medians["boxes"] / medians["points"],
                "objects": n_objects / n_moments,
            }
    return report


def _check(answers: dict[str, Any]) -> None:
    """Refuse boxes that are not at places where the other model has an object of the class."""
    points = {(one.label, one.probability, one.x, one.y) for one in answers["points"].objects}
    for one in answers["boxes"].objects:
        if (one.label, one.probability, one.x, one.y) not in points:
            raise WorkDiffers("a box is not where the same network without sizes finds an object")


def main(argv: list[str] | None = None) -> int:
    """Measure the report or read it, and print its table."""
    parser = script_parser("box_cost", __doc__, "30 decisions")
    parser.add_argument("model", nargs="?", metavar="MODEL", help="default: random weights")
    args = parser.parse_args(argv)

    def measured(quick: bool) -> dict[str, Any]:
        model = load_model(args.model) if args.model else random_model()
        if not model.has_sizes:
            raise ValueError(f"{args.model}: not a map model that says sizes")
        with one_thread(True):
            return {"sensors": measure(model, 30 if quick else N_MOMENTS), "machine": machine()}

    return run_script(parser, argv, measured, "box_cost")


if __name__ == "__main__":
    exit_with(main)
