"""Has an event or a decision become slower? Two checkouts take turns.

    python -m experiments.between_commits CHECKOUT [--models MODEL ...] [--rounds N] [--json FILE]
    python -m experiments.between_commits CHECKOUT --graph GRAPH --recordings FILE ...

CHECKOUT is a folder with another commit, such as `git worktree add ../before HEAD~20` makes it. Its
`async-tnt bench` and that of this checkout take turns, each in a process of its own, and the table
has the ratio of the medians: below 1, this checkout is faster. Both compile their kernels in a
first run that is not counted. With --graph, a spiking network (.nir, reset by subtraction) takes
the events of recordings instead.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from experiments.scripts.options import (
    add_json,
    exit_with,
    plain_parser,
    write_outputs,
)
from experiments.speed.timing import machine

HERE = Path(__file__).parent.parent
"""The folder of this checkout."""

FIGURES = {
    "ns an event into the volume": ("ns_an_event",),
    "us a decision, 1 new event": ("us_a_decision", "1"),
    "us a decision, 100 new events": ("us_a_decision", "100"),
    "us a decision, 1,300 new events": ("us_a_decision", "1300"),
    "us a decision after every event": ("decisions_a_second",),
}
"""Name of a figure -> where `async-tnt bench --json` has its median."""

SPIKING_FIGURES = {
    "us an event": "us_an_event",
    "us an event with a decision": "us_an_event_and_decision",
}
"""Name of a figure -> its name in what `experiments/speed/spiking_events.py` prints."""


def of_bench(checkout: Path, model: str) -> dict[str, float]:
    """The figures of one run of a checkout's `async-tnt bench`."""
    report = _output_of(checkout, ["-m", "async_tnt", "bench", "--model", model, "--json"])
    figures = {}
    for name, path in FIGURES.items():
        part: Any = report
        for key in path:
            part = part[key]
        figures[name] = float(part["median"])
    figures["us a decision after every event"] = 1e6 / figures["us a decision after every event"]
    return figures


def of_graph(checkout: Path, graph: Path, recordings: Sequence[Path]) -> dict[str, float]:
    """The figures of a spiking network, by a checkout's package."""
    script = HERE / "experiments" / "speed" / "spiking_events.py"
    report = _output_of(checkout, [str(script), str(graph), *map(str, recordings)])
    return {name: report[key] for name, key in SPIKING_FIGURES.items()}


def _output_of(checkout: Path, words: list[str]) -> Any:
    """What a Python program prints as JSON that imports the package of a checkout."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(checkout), str(checkout / "reference")]),
        "OMP_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, *words],
        cwd=checkout,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def compared(
    other: Path, measure: Callable[[Path], dict[str, float]], rounds: int, words: str
) -> dict[str, dict[str, float]]:
    """Name of a figure -> its medians in both checkouts, and the median of their ratios.

    "least" and "most" are the smallest and the largest ratio of two runs that follow each other.

    measure : the figures of one run of a checkout.
    words : what is measured, for the progress.
    """
    for checkout in (other, HERE):
        measure(checkout)
    runs = []
    with progress(rounds, words) as bar:
        for k in range(rounds):
            order = (other, HERE) if k % 2 == 0 else (HERE, other)
            one = {checkout: measure(checkout) for checkout in order}
            runs.append((one[other], one[HERE]))
            bar.update()
    numbers = {}
    for name in runs[0][0]:
        before = np.array([run[0][name] for run in runs])
        now = np.array([run[1][name] for run in runs])
        ratios = now / before
        numbers[name] = {
            "before": float(np.median(before)),
            "now": float(np.median(now)),
            "ratio": float(np.median(ratios)),
            "least": float(ratios.min()),
            "most": float(ratios.max()),
        }
    return numbers


def table(report: dict[str, dict[str, dict[str, float]]]) -> list[str]:
    """The report as lines of Markdown."""
    lines = [
        "| model | figure | before | now | ratio | smallest to largest |",
        "|---|---|---|---|---|---|",
    ]
    for model, figures in report.items():
        for name, one in figures.items():
            cells = [
                model,
                name,
                f"{one['before']:.3g}",
                f"{one['now']:.3g}",
                f"{one['ratio']:.2f}",
            ]
            cells.append(f"{one['least']:.2f} to {one['most']:.2f}")
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def main(argv: list[str] | None = None) -> int:
    """Measure, and print the table."""
    parser = plain_parser("between_commits", __doc__)
    parser.add_argument("checkout", type=_checkout, metavar="CHECKOUT", help="the other commit")
    parser.add_argument(
        "--models", nargs="+", default=["digits", "digits-everywhere"], metavar="MODEL"
    )
    parser.add_argument("--graph", type=Path, metavar="FILE", help="a .nir file, instead of models")
    parser.add_argument(
        "--recordings", nargs="+", type=Path, default=[], metavar="FILE", help="for --graph"
    )
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="(default: 5)")
    parser.add_argument("--quick", action="store_true", help="one round of the first model")
    add_json(parser)
    args = parser.parse_args(argv)
    if args.quick:
        args.models = args.models[:1]
        args.rounds = 1
    if bool(args.graph) != bool(args.recordings):
        parser.error("--graph and --recordings belong together")
    report = {}
    if args.graph:
        measure = partial(
            of_graph,
            graph=args.graph.resolve(),
            recordings=[path.resolve() for path in args.recordings],
        )
        report[args.graph.name] = compared(args.checkout, measure, args.rounds, args.graph.name)
    for model in [] if args.graph else args.models:
        measure = partial(of_bench, model=model)
        report[model] = compared(args.checkout, measure, args.rounds, model)
    print(*table(report), sep="\n")
    write_outputs(args, {"figures": report, "machine": machine()})
    return 0


def _checkout(text: str) -> Path:
    """A folder with the package. This is an argparse type."""
    path = Path(text).resolve()
    if not (path / "async_tnt" / "__init__.py").is_file():
        raise argparse.ArgumentTypeError(f"{text}: no checkout, it has no folder async_tnt")
    return path


if __name__ == "__main__":
    exit_with(main)
