"""How long a decision takes: ours, from what has changed, and the same by onnxruntime, OpenVINO, torch and eventcv.

    python -m experiments.decisions [--quick] [--json FILE] [--picture FILE]

One process, one thread each, warm, interleaved, on the windows of the bundled recordings; before anything is timed, all
must give the same logits within 1e-4. Decisions are timed twice: backends alternate from call to call (each finds
the caches full of the others), and they decide in blocks (each has them to itself). Compare within one of these only.
Rows whose package is not installed are left out, with the reason:
`pip install torch==2.13.0 onnx onnxruntime openvino eventcv`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

if __name__ == "__main__":  # before any library reads them
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", RAYON_NUM_THREADS="1")

from async_tnt import load_model, warmup
from async_tnt.progress import Bar, progress
from experiments import bench_backends as backends
from experiments import measure_end_to_end as end_to_end
from experiments.bench_every_event import bench_every_event
from experiments.bench_moments import NEW_EVENTS, bench_recordings, windows_of
from experiments.bench_network import bench_network, bench_on_noise, fastest
from experiments.bench_timing import is_installed, machine, machine_text, one_thread, quartiles
from experiments.draw_decisions import draw_decisions
from experiments.measure_singles import bench_singles
from experiments.measure_touched import bench_touched
from experiments.script_options import exit_with, run_script, script_parser

MODEL = "digits"
PACKAGES = ("torch", "onnx", "onnxruntime", "openvino", "eventcv")
FULL = {"blocks": 40, "decisions_a_block": 50, "rounds": 10, "single_decisions": 100_000}
QUICK = {"blocks": 2, "decisions_a_block": 10, "rounds": 1, "single_decisions": 2_000}
MODES = {"call_by_call": "backends alternate from call to call", "in_blocks": "each decides in blocks of {} calls"}


def measure(settings: dict[str, int], quick: bool) -> dict[str, Any]:
    """All measurements, as one JSON object.

    Raises
    ------
    WorkDiffers : backends do not agree. Then nothing is reported.
    """
    with progress(5 + 2 * len(NEW_EVENTS), "compiling") as bar:
        return _measure(settings, quick, bar)


def _measure(settings: dict[str, int], quick: bool, bar: Bar) -> dict[str, Any]:
    model = load_model(MODEL)
    warmup(model)
    recordings = bench_recordings(model.config)
    windows = [window for events in recordings for window in windows_of(events, model.config.window_us)]
    counts = {"blocks": settings["blocks"], "size": settings["decisions_a_block"]}
    with one_thread(is_installed("torch")):
        networks = backends.dense_networks(model)
        network = {}
        for n_new in NEW_EVENTS:
            bar.update(title=f"the network alone, new events: {n_new}")
            network[str(n_new)] = bench_network(model, networks, windows, n_new, **counts)
        bar.update(title="the network alone, random numbers")
        network["random"] = bench_on_noise(model, networks, **counts)
        way = fastest(backends.ONNXRUNTIME, network)
        whole = {}
        for n_new in NEW_EVENTS:
            bar.update(title=f"from packet to decision, new events: {n_new}")
            whole[str(n_new)] = end_to_end.bench_end_to_end(model, way, windows, n_new, **counts)
        bar.update(title="a decision after every event")
        others = {name: f for name, f in networks.items() if name not in backends.ONNXRUNTIME or name == way}
        n_events = 500 if quick else None
        rates = bench_every_event(model, others, recordings, rounds=settings["rounds"], n_events=n_events)
        bar.update(title="single decisions")
        singles = bench_singles(model, recordings, n_decisions=settings["single_decisions"])
    bar.update(title="what new events touch")
    touched = bench_touched(model, windows, moments=40 if quick else 1000)
    return {
        "machine": machine(*PACKAGES),
        "settings": {"quick": quick, "threads": 1, **settings, "onnxruntime_way": way},
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
        "network": network,
        "end_to_end": whole,
        "every_event": {"packets": rates, "singles": singles},
        "touched": touched,
        "left_out": {
            "network": backends.left_out(),
            "end_to_end": end_to_end.left_out(),
        },
    }


def lines(report: dict[str, Any]) -> Iterator[str]:
    """The report as text."""
    about, settings = report["machine"], report["settings"]
    yield machine_text(about, *PACKAGES)
    titles = {"network": "The network alone", "end_to_end": "From a packet of new events to the decision"}
    for part, title in titles.items():
        for mode, words in MODES.items():
            words = words.format(settings["decisions_a_block"])
            yield ""
            yield f"{title}, us: median [quartiles], p99, times ours; {words}"
            yield from _turns(report[part], mode)
    yield ""
    yield "A decision after every event, recordings in packets: us of processor time, decisions a second, times ours"
    for name, row in report["every_event"]["packets"].items():
        ratio = f"{row['ratio']['median']:8.1f}" if "ratio" in row else ""
        yield f"  {name:22}{quartiles(row['us']):>26}{row['a_second']:>12,.0f}{ratio}"
    yield ""
    yield f"Single decisions, push_one, {settings['single_decisions']:,} each: us"
    for name, row in report["every_event"]["singles"].items():
        yield (
            f"  {name:22}{quartiles(row):>26}  p99 {row['p99']:.1f}  p99.9 {row['p999']:.1f}  max {row['max']:.0f}  "
            f"p99 / median {row['p99_over_median']:.1f}"
        )
    yield ""
    yield "What new events touch, means: multiplications; cells that change, places of each layer computed"
    for name, row in report["touched"].items():
        places = ", ".join(f"{layer} {n:.1f}" for layer, n in row.items() if layer != "multiplications")
        yield f"  {name:6}{row['multiplications']:>12,.0f}   {places}"
    yield ""
    yield "What each row does:"
    for part, rows in report["work"].items():
        for name, words in rows.items():
            why = report["left_out"][part].get(name)
            yield f"  {name:22}" + (f"left out: {why}" if why else words)


def _turns(rows: dict[str, Any], mode: str) -> Iterator[str]:
    for name, row in rows.items():
        yield "  volumes of random numbers" if name == "random" else f"  {name} new event{'s' if name != '1' else ''}"
        for backend, us in row[mode]["us"].items():
            ratio = row[mode]["ratio"].get(backend)
            yield f"    {backend:20}{quartiles(us):>26}{us['p99']:>9.1f}" + (f"{ratio['median']:9.2f}" if ratio else "")


def main(argv: list[str] | None = None) -> int:
    """Run, print, and write JSON and the picture if asked. Returns 1 if backends do not agree."""
    parser = script_parser("decisions", __doc__, "few rounds", draws=True)
    return run_script(parser, argv, lambda quick: measure(QUICK if quick else FULL, quick), lines, draw_decisions)


if __name__ == "__main__":
    exit_with(main)
