"""What boxes cost beside points: a decision of a map model after one event, in one run.

    python -m experiments.box_cost [MODEL] [--quick] [--json FILE]

MODEL is a map model that says sizes; by default the bundled `digits-everywhere` with two more
channels of random weights. The model of points is the same without these channels. Both see the
same moving recordings on two sensors, and take turns: 300 events that are not timed, then one event
and the decision. The classes and places of the objects must be equal, up to those that boxes
suppress; of a model that says where the middles of boxes are, the classes and probabilities.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np

from async_tnt import Model, Processor, load_model
from async_tnt.base.progress import progress
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.interleaved import WorkDiffers
from experiments.speed.moving_recordings import moving
from experiments.speed.timing import latency, machine, no_collector, one_thread

SENSORS = ((240, 180), (640, 480))
"""Width and height of the sensors, in pixels."""

BUNDLED = "digits-everywhere"
"""The bundled map model, of points."""

N_MOMENTS = 1_000
"""Number of decisions of each model that are timed."""

N_BEFORE = 300
"""Number of events between two timed ones."""

N_OBJECTS = 3
"""Number of recordings that stand on the sensor."""


def with_sizes(model: Model) -> Model:
    """A map model with two more channels, whose weights are random: sizes of about five places."""
    rng = np.random.default_rng(0)
    *_, last = model.layers
    weights = dict(model.weights)
    for role, name in last["weights"].items():
        shape = (2, *weights[name].shape[1:])
        added = rng.normal(0.0, 0.05, shape) + (np.log(5.0) if role == "bias" else 0.0)
        weights[name] = np.concatenate([weights[name], added.astype(np.float32)])
    return replace(model, weights=weights)


def without_sizes(model: Model) -> Model:
    """The same model without the channels of boxes."""
    n = len(model.classes) + 1
    *_, last = model.layers
    weights = dict(model.weights)
    for name in last["weights"].values():
        weights[name] = weights[name][:n]
    return replace(model, weights=weights)


def measure(model: Model, n_moments: int) -> dict[str, Any]:
    """Microseconds of a decision after one event, and the ratio of both models."""
    report = {}
    n_of_boxes = model.logits_shape[0] - len(model.classes) - 1
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
                    _check(answers, n_of_boxes)
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


def _check(answers: dict[str, Any], n_of_boxes: int) -> None:
    """Refuse boxes that are not at places where the other model has an object of the class.

    n_of_boxes : number of channels of boxes. With four of them, a box has another middle than the
        point; then its class and probability must be those of a point.
    """

    def key(one: Any) -> tuple[Any, ...]:
        place = (one.x, one.y) if n_of_boxes == 2 else ()
        return (one.label, one.probability, *place)

    points = {key(one) for one in answers["points"].objects}
    for one in answers["boxes"].objects:
        if key(one) not in points:
            raise WorkDiffers("a box is not where the same network without sizes finds an object")


def main(argv: list[str] | None = None) -> int:
    """Measure the report or read it, and print its table."""
    parser = script_parser("box_cost", __doc__, "30 decisions")
    text = f"default: {BUNDLED} with random sizes"
    parser.add_argument("model", nargs="?", metavar="MODEL", help=text)
    args = parser.parse_args(argv)

    def measured(quick: bool) -> dict[str, Any]:
        model = load_model(args.model) if args.model else with_sizes(load_model(BUNDLED))
        if not model.has_sizes:
            raise ValueError(f"{args.model}: not a map model that says sizes")
        with one_thread(True):
            return {"sensors": measure(model, 30 if quick else N_MOMENTS), "machine": machine()}

    return run_script(parser, argv, measured, "box_cost")


if __name__ == "__main__":
    exit_with(main)
