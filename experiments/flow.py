"""Optical flow after every event: a small network, beside plane fits and zero flow.

    python -m experiments.flow [--quick] [--seeds N] [--steps N] [--json FILE]

The networks are trained on simulated scenes, as in `examples/flow_per_event.py`, one for each seed.
The settings of the plane fits are chosen on sequences for validation, of the kinds of scenes that
the training shows. Then each way tells the flow at the same events of the same test sequences: of
these kinds, and of kinds that no training shows.

Times are those of the first network on a sensor of 346x260 pixels.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from async_tnt import Model
from examples.optical_flow.network import HOP_US, WINDOW_US
from examples.optical_flow.scenes import TRAINED, UNSEEN
from examples.optical_flow.sequences import (
    DURATION_US,
    SENSOR,
    TEST,
    VALIDATION,
    Way,
    network_way,
    plane_way,
    pooled_way,
    sequences,
    zero_flow,
)
from examples.optical_flow.training import STEPS, train_flow
from experiments.optical_flow import comparison as C
from experiments.optical_flow.settings_search import PLANE_CHOICES, POOL_CHOICES, best_settings
from experiments.optical_flow.times import N_CHANGES, N_MOMENTS, N_STREAMED, times
from experiments.scripts.options import add_count, exit_with, run_script, script_parser
from experiments.speed.timing import machine

KINDS = {"as trained": TRAINED, "others": UNSEEN}
"""Name of a test set -> what it shows."""

SIZES = {"sequences": 60, "compared": 200, "validation": 20, "drawn": 80}
"""Number of test sequences of each kind, of events of each that are compared, of sequences for
validation, and of settings of plane fits that are drawn."""

QUICK_SIZES = {"sequences": 3, "compared": 20, "validation": 2, "drawn": 3}
"""The same for --quick."""

SEED = 0
"""Seed of all sequences."""


def compare_on(name: str, ways: dict[str, Way], models: list[Model], sizes: dict[str, int]) -> Any:
    """The errors of all ways on a test set, and of networks of other seeds."""
    known = list(sequences(TEST, KINDS[name], sizes["sequences"], sizes["compared"], SEED))
    answers = C.answers_of(ways, known)
    rows = C.by_sequence(answers, known)
    for row, hop_us in ((C.NETWORK, None), (C.OVERLAPPING, HOP_US)):
        others = [C.mean_error(network_way(model, hop_us), known) for model in models[1:]]
        rows[row]["seeds"] = [rows[row]["mean"], *others]
    return {
        "events": sum(len(sequence.compared) for sequence in known),
        "ways": rows,
        "by_age_ms": C.by_age(answers, known),
        "found": C.where_a_plane_is_found(answers, known),
    }


def measure(args: argparse.Namespace, quick: bool) -> dict[str, Any]:
    """The report."""
    sizes = QUICK_SIZES if quick else SIZES
    models = [train_flow(20 if quick else args.steps, seed) for seed in range(args.seeds)]
    validation = list(sequences(VALIDATION, TRAINED, sizes["validation"], 100, SEED))
    plane = best_settings(plane_way, PLANE_CHOICES, validation, sizes["drawn"], SEED)
    pooled = best_settings(pooled_way, POOL_CHOICES, validation, sizes["drawn"], SEED)
    ways = {
        C.ZERO: zero_flow,
        C.PLANE: plane_way(plane["settings"]),
        C.POOLED: pooled_way(pooled["settings"]),
        C.NETWORK: network_way(models[0], None),
        C.OVERLAPPING: network_way(models[0], HOP_US),
    }
    timed = (10, 3, 100) if quick else (N_MOMENTS, N_CHANGES, N_STREAMED)
    return {
        "machine": machine("torch", "onnxruntime"),
        "settings": {
            **sizes,
            "steps": models[0].record["steps"],
            "seeds": args.seeds,
            "sensor": list(SENSOR),
            "duration_us": DURATION_US,
            "window_us": WINDOW_US,
            "hop_us": HOP_US,
            "quick": quick,
        },
        "planes": {
            name: {**chosen, "settings": asdict(chosen["settings"])}
            for name, chosen in ((C.PLANE, plane), (C.POOLED, pooled))
        },
        "tests": {name: compare_on(name, ways, models, sizes) for name in KINDS},
        "times": times(models[0], *timed),
    }


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write JSON if asked."""
    parser = script_parser("flow", __doc__, "few steps and sequences")
    add_count(parser, "--seeds", 3, "number of networks")
    add_count(parser, "--steps", STEPS, "number of steps of a training")
    args = parser.parse_args(argv)
    return run_script(parser, argv, lambda quick: measure(args, quick), "flow")


if __name__ == "__main__":
    exit_with(main)
