"""Time per event and time to a decision, beside torch, onnxruntime and OpenVINO.

    python -m experiments.bench_suite [--quick] [--json] [--landmark NAME] [--model NAME|FILE]

How long TNTVolume takes for an event, how long a Processor with its network takes, and the latency from the last event
to the decision. If torch is installed, the same decisions are also made in batches (the window's whole volume again,
then torch's network), in the same run, interleaved with ours; both are first checked to give the same volumes and the
same classes.

Then the network alone, 1 to 1300 events after the previous decision (ours computes what has changed), and a
Processor that decides after every event, compared with onnxruntime, OpenVINO and torch if they are installed and
give the same logits.

One thread. Events are made by a seeded generator; decisions are measured on bundled recordings. A minute or less.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from async_tnt.compile_ahead import warmup
from async_tnt.config import LANDMARKS, TIME_IMAGES
from async_tnt.networks.loading import load_model
from async_tnt.networks.model import Model
from async_tnt.progress import Bar, progress
from experiments.bench_backends import ENGINES, dense_networks, left_out
from experiments.bench_every_event import bench_every_event
from experiments.bench_interleaved import WorkDiffers
from experiments.bench_latency import bench_latency, bench_stream
from experiments.bench_moments import NEW_EVENTS, bench_recordings, windows_of
from experiments.bench_network import bench_network
from experiments.bench_timing import is_installed, machine, machine_text, one_thread, quartiles
from experiments.bench_volumes import GRIDS, PACKETS, bench_volume

NO_TORCH = "torch is not installed: only our own times (pip install 'async_tnt[reference]' for batch processing)"
PACKAGES = ("torch", "onnxruntime", "openvino")
SIZES: dict[str, tuple[Any, Any]] = {  # name: in full, with --quick
    "rounds": (31, 5),
    "moments": (1000, 120),
    "blocks": (10, 2),
    "decisions_a_block": (50, 10),
    "recordings": (3, 1),
    "events": (None, 300),
}


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--landmark",
        choices=[name for name in LANDMARKS if name != "regressor"],  # which needs a trained network
        default="running",
        help="landmark of the volumes that are timed alone (default: running)",
    )
    parser.add_argument(
        "--model",
        metavar="NAME|FILE",
        default="digits",
        help="network for the decisions (default: the bundled %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated events (default: 0)")
    parser.add_argument("--quick", action="store_true", help="fewer events and rounds: seconds, wider quartiles")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Measure and print. Returns 0; 1 if stream and batch do not agree."""
    parser = make_parser()
    args = parser.parse_args(argv)
    try:
        model = load_model(args.model)
        _check_model(model)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    with_torch = is_installed("torch", "tnt_reference")
    try:
        with progress(len(GRIDS) + len(NEW_EVENTS) + 4, "compiling") as bar, one_thread(with_torch):
            warmup(model)
            report = _measure(args, model, with_torch, bar)
    except WorkDiffers as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    print(json.dumps(report) if args.json else "\n".join(table(report)))
    return 0


def _check_model(model: Model) -> None:
    """Refuse what the batch computations beside the stream do not make."""
    config = model.config
    if config.representation in TIME_IMAGES or config.window_events is not None:
        got = f"representation={config.representation!r}, window_events={config.window_events}"
        raise ValueError(f"bench compares event volumes of windows of a duration; the model has {got}")


def _measure(args: argparse.Namespace, model: Model, with_torch: bool, bar: Bar) -> dict[str, Any]:
    rng = np.random.default_rng(args.seed)
    sizes = {name: both[args.quick] for name, both in SIZES.items()}
    rounds = sizes["rounds"]  # many short rounds: another process interrupts few of them
    volumes = []
    for grid in GRIDS:
        bar.update(title=f"volume, {grid[0]} x {grid[1]}")
        n_events = 13_000 if args.quick else 26_000  # whole packets of every size
        volumes.append(bench_volume(grid, args.landmark, rng, n_events=n_events, rounds=rounds))
    recordings = bench_recordings(model.config, args.seed)
    events = recordings[3]
    bar.update(title="recording through a Processor")
    stream = bench_stream(model, events, rounds=rounds, with_torch=with_torch)
    bar.update(title="latency of decisions")
    decisions = bench_latency(model, events, moments=sizes["moments"], with_torch=with_torch)
    windows = [window for r in recordings for window in windows_of(r, model.config.window_us)]
    networks, of_network = dense_networks(model), {}
    for n_new in NEW_EVENTS:
        bar.update(title=f"the network, {n_new} new events")
        of_network[str(n_new)] = bench_network(
            model, networks, windows, n_new, blocks=sizes["blocks"], size=sizes["decisions_a_block"]
        )
    bar.update(title="a decision after every event")
    rates = bench_every_event(
        model, networks, recordings[: sizes["recordings"]], rounds=sizes["recordings"], n_events=sizes["events"]
    )
    return {
        "machine": machine(*PACKAGES),
        "settings": {"quick": args.quick, "seed": args.seed, "threads": 1, "batch": with_torch, **sizes},
        "model": {"name": args.model, "config": model.config.to_dict(), "classes": len(model.classes)},
        "volume": volumes,
        "processor": {"stream": stream, "latency": decisions, "every_event": rates},
        "network": of_network,
        "left_out": left_out(),
    }


def table(report: dict[str, Any]) -> Iterator[str]:
    """The report as text."""
    about, settings = report["machine"], report["settings"]
    yield machine_text(about, *PACKAGES)
    yield f"processor time, medians of {settings['rounds']} interleaved rounds, quartiles in brackets"
    volumes = report["volume"]
    yield ""
    yield (
        f"TNTVolume, landmark {volumes[0]['landmark']}, {volumes[0]['bins']} bins, "
        f"{volumes[0]['events']:,} events a window: ns per event"
    )
    yield f"{'':28}" + "".join(f"{'{} x {}'.format(*v['grid']):>28}" for v in volumes)
    ways = {"single": "update_one, each event"}
    ways |= {f"packet_{n}_{form}": f"packets of {n}, {form}" for n in PACKETS for form in ("structured", "columns")}
    for way, title in ways.items():
        yield f"{title:28}" + _row([v["ns_per_event"][way] for v in volumes])
    yield f"{'us to open a window':28}" + _row([v["open_us"] for v in volumes])
    yield f"{'us to read after 1300':28}" + _row([v["read_us"] for v in volumes])
    stream, decisions = report["processor"]["stream"], report["processor"]["latency"]
    config = report["model"]["config"]
    yield ""
    yield (
        f"Processor, model {report['model']['name']} at {config['grid'][0]} x {config['grid'][1]}, "
        f"landmark {config['landmark']}; a recording of {stream['events']:,} events, "
        f"{stream['windows']} windows decided"
    )
    names = {"single": "push_one, each event", "batch": "batch, torch, a window at once"}
    for way, figure in stream["ns_per_event"].items():
        title = names.get(way) or f"packets of {way.split('_')[1]}"
        yield f"{title + ', ns per event':48}" + _row([figure])
    yield ""
    yield f"from the last event to the decision, {decisions['moments']} moments: us by the wall clock, then p99"
    names = {
        "stream": "stream: push_one + fire",
        "push_one": "  push_one",
        "fire": "  fire",
        "batch": "batch: window's volume + network, torch",
        "batch_volume": "  volume",
        "batch_network": "  network",
    }
    for way, figure in decisions["us"].items():
        yield f"{names[way]:48}" + _row([figure]) + f"   p99 {figure['p99']:.1f}"
    if settings["batch"]:
        ratio, worst = decisions["batch_over_stream"], decisions["largest_difference"]
        yield f"{'batch / stream':48}" + _row([ratio])
        yield f"checked: the same logits, the same volumes (at most {worst['volume']:.0e} of the largest cell apart)"
    else:
        yield NO_TORCH
    yield from _decisions(report)


def _decisions(report: dict[str, Any]) -> Iterator[str]:
    """The network alone, and a Processor that decides after every event."""
    rows, size = report["network"], report["settings"]["decisions_a_block"]
    yield ""
    yield f"the network alone, each in blocks of {size} decisions: us by the wall clock"
    yield f"{'new events since the last decision':36}" + "".join(f"{int(n):>26,}" for n in rows)
    first = next(iter(rows.values()))["in_blocks"]["us"]
    for name in first:
        figures = [row["in_blocks"]["us"][name] for row in rows.values()]
        yield f"{_title(name):36}" + "".join(f"{quartiles(figure):>26}" for figure in figures)
    worst = max(row[mode]["largest_difference"] for row in rows.values() for mode in row)
    yield f"checked: the same logits (at most {worst:.0e} apart)"
    yield ""
    yield "a decision after every event, recordings in packets: decisions a second, us each"
    for name, row in report["processor"]["every_event"].items():
        yield f"{_title(name):36}{row['a_second']:>12,.0f}" + _row([row["us"]])
    for name, why in report["left_out"].items():
        yield f"{_title(name)}: {why}"


def _title(backend: str) -> str:
    return "the Processor's own network" if backend == "ours" else ENGINES[backend].title


def _row(figures: list[dict[str, float]]) -> str:
    return "".join(f"{quartiles(figure):>28}" for figure in figures)


if __name__ == "__main__":
    sys.exit(main())
