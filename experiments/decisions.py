"""How long a decision takes.

Our engine, which computes what has changed, is compared with onnxruntime, OpenVINO, torch and
eventcv.

    python -m experiments.decisions [--quick] [--json FILE] [--picture FILE]

All backends run in one process with one thread each, and take turns on the windows of the bundled
recordings. Before anything is timed, all backends must give the same logits within 1e-4.

Decisions are timed in two ways. In the first way, backends alternate from call to call, so a
backend finds the caches full of other backends' data. In the second way, a backend makes a block of
decisions in a row, and has the caches to itself. Compare only numbers of the same way.

Rows whose package is not installed are left out, with the reason. To install all:
`pip install torch==2.13.0 onnx onnxruntime openvino eventcv`.
"""

from __future__ import annotations

import os
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", RAYON_NUM_THREADS="1")

from async_tnt import load_model, warmup
from async_tnt.base.progress import progress
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed import backends, end_to_end
from experiments.speed.drawing import draw_decisions
from experiments.speed.every_event import bench_every_event
from experiments.speed.moments import NEW_EVENTS, bench_recordings, windows_of
from experiments.speed.networks import bench_network, fastest
from experiments.speed.timing import is_installed, machine, one_thread

MODEL = "digits"
"""The model whose decisions are timed."""

PACKAGES = ("torch", "onnx", "onnxruntime", "openvino", "eventcv")
"""Packages whose versions the report names."""

FULL = {"blocks": 40, "decisions_a_block": 50, "rounds": 10}
"""How much is measured."""

QUICK = {"blocks": 2, "decisions_a_block": 10, "rounds": 1}
"""How much is measured with --quick."""


def measure(settings: dict[str, int], quick: bool) -> dict[str, Any]:
    """The report of all measurements, as one JSON object.

    Raises
    ------
    WorkDiffers : backends do not give the same results. Then there is no report.
    """
    model = load_model(MODEL)
    recordings = bench_recordings(model.config)
    windows = []
    for events in recordings:
        windows += windows_of(events, model.config.window_us)
    counts = {"blocks": settings["blocks"], "size": settings["decisions_a_block"]}
    with progress(2 + 2 * len(NEW_EVENTS), "compiling") as bar, one_thread(is_installed("torch")):
        warmup(model)
        networks = backends.dense_networks(model)
        network_times = {}
        for n_new in NEW_EVENTS:
            bar.update(title=f"the network alone, new events: {n_new}")
            network_times[str(n_new)] = bench_network(model, networks, windows, n_new, **counts)
        faster_way = fastest(backends.ONNXRUNTIME, network_times)
        end_to_end_times = {}
        for n_new in NEW_EVENTS:
            bar.update(title=f"from packet to decision, new events: {n_new}")
            end_to_end_times[str(n_new)] = end_to_end.bench_end_to_end(
                model, faster_way, windows, n_new, **counts
            )
        bar.update(title="a decision after every event")
        slower_ways = set(backends.ONNXRUNTIME) - {faster_way}
        other_networks = {
            name: engine for name, engine in networks.items() if name not in slower_ways
        }
        n_events = 500 if quick else None
        rates = bench_every_event(
            model, other_networks, recordings, rounds=settings["rounds"], n_events=n_events
        )
    return {
        "machine": machine(*PACKAGES),
        "settings": {"quick": quick, "threads": 1, **settings, "onnxruntime_way": faster_way},
        "model": {
            "name": MODEL,
            "config": model.config.to_dict(),
            "events": sum(map(len, recordings)),
            "windows": len(windows),
        },
        "work": {
            "network": {name: engine.work for name, engine in backends.ENGINES.items()},
            "end_to_end": end_to_end.WORK,
        },
        "network": network_times,
        "end_to_end": end_to_end_times,
        "every_event": rates,
        "left_out": {
            "network": backends.left_out(),
            "end_to_end": backends.left_out(end_to_end.NEEDS),
        },
    }


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write JSON and the picture if asked.

    Returns 1 if backends do not give the same results.
    """
    parser = script_parser("decisions", __doc__, "few rounds", draws=True)

    def measure_report(quick: bool) -> dict[str, Any]:
        return measure(QUICK if quick else FULL, quick)

    return run_script(parser, argv, measure_report, "decisions", draw_decisions)


if __name__ == "__main__":
    exit_with(main)
