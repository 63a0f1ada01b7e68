"""`python -m experiments.thesis_table`: the thesis' experiment. Train and test its networks, and
compare them."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from async_tnt.base.checks import needs_extra
from async_tnt.base.files import check_folder, write_text
from async_tnt.base.package import available_cores
from async_tnt.cli.options import command_words, positive_int, whole_number
from async_tnt.cli.output import note, say
from async_tnt.training.settings import TrainSettings
from experiments.scripts.options import (
    add_folder,
    data_folder,
    exit_with,
    plain_parser,
    writable_file,
)
from experiments.speed.timing import machine
from experiments.tables.parts import read_json
from experiments.thesis.rows import GROUPS, INPUTS, ROWS, SETS, TRAINED_ON, Run, runs_of

DESCRIPTION = f"""The thesis' experiment: networks that saw digits move in one way, tested in other motions.

Rows, in groups (--list names them all, and trains nothing):

{chr(10).join(f"  {name:<11} {text}" for name, text in GROUPS.items())}

Columns, trained on / tested on:

  all/all   all three saccades of N-MNIST / all three, of other digits
  1/all     the first saccade only        / all three, of other digits
  1/others  the first saccade only        / the second and third, of other digits
  1/train   the first saccade only        / all three, of the digits trained on
  .../sim ...  the same                   / N-MOVING-MNIST, nine sets of 30 simulated motions, made in --out
  confounded: each digit in one saccade only, 0-3 in the first, 4-6 in the second, 7-9 in the third

Rows are compared seed by seed and digit by digit; the results hold each difference with its 95 % interval, and which
of them hold when all are asked at once (Holm's method).

A network is validated on held-out digits of its training motion, and tested only at the end. Checkpoints and results
of all networks are kept in --out: stop with Ctrl-C, give the same command again, and it resumes.
"""
EPILOG = """\
examples:
  python -m experiments.thesis_table --smoke --nmnist N-MNIST --mnist MNIST    everything in a minute or two
  python -m experiments.thesis_table --list                                    the networks, and their steps
  python -m experiments.thesis_table --nmnist N-MNIST --mnist MNIST --rows thesis --out table
                                                                               the thesis' own rows
  python -m experiments.thesis_table --nmnist N-MNIST --mnist MNIST --rows raw line --seeds 0 1 --images 100
  python -m experiments.thesis_table --rows raw-span raw --into experiments/results/table.json
                                                                               the pages' results, rows at a time
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    data = parser.add_argument_group("data")
    add_folder(
        data,
        "--nmnist",
        "N-MNIST: the folder with Train/<digit>/*.bin and Test/<digit>/*.bin (default: "
        "$TNT_DATA/nmnist)",
    )
    add_folder(data, "--mnist", "MNIST's IDX files, to simulate from (default: $TNT_DATA/mnist)")
    data.add_argument(
        "--images",
        type=positive_int,
        default=500,
        metavar="N",
        help="test images of MNIST to simulate, that no training recording shows (default: 500)",
    )
    what = parser.add_argument_group("what to train")
    what.add_argument(
        "--rows",
        nargs="+",
        choices=[*GROUPS, *ROWS],
        metavar="ROW",
        help="rows, or groups of them: " + ", ".join(GROUPS) + " (default: all groups)",
    )
    what.add_argument(
        "--trained-on",
        nargs="+",
        choices=TRAINED_ON,
        default=list(TRAINED_ON),
        help=f"only networks trained on these (default: {' '.join(TRAINED_ON)})",
    )
    what.add_argument(
        "--seeds",
        nargs="+",
        type=whole_number,
        default=[0, 1, 2, 3, 4],
        metavar="N",
        help="of weights, order and augmentation (default: 0 1 2 3 4)",
    )
    what.add_argument("--list", action="store_true", help="print the networks, and stop")
    how = parser.add_argument_group("training")
    how.add_argument(
        "--iterations",
        type=positive_int,
        metavar="N",
        help="steps of the optimizer for each network (default: each row's, see --list)",
    )
    how.add_argument(
        "--batch", type=positive_int, default=64, metavar="N", help="windows per step (default: 64)"
    )
    how.add_argument(
        "--workers",
        type=positive_int,
        metavar="N",
        help="networks trained at a time, one thread each (default: all cores; 1 where torch sees a GPU)",
    )
    how.add_argument(
        "--smoke",
        action="store_true",
        help="try everything in a minute or two: five rows, 8 recordings a digit, 30 steps, seed 0, 20 simulated "
        "digits",
    )
    out = parser.add_argument_group("results")
    add_folder(
        out, "--out", "networks, results.json, table.md (default: table; with --smoke: table-smoke)"
    )
    out.add_argument(
        "--into",
        type=writable_file,
        metavar="FILE",
        help="put the results into this one, too, which has those of other rows: experiments/results/table.json",
    )
    out.add_argument("--json", action="store_true", help="print the results as one JSON object")


def main(argv: list[str] | None = None) -> int:
    """Train, test, compare, and write. Returns the exit code 0."""
    parser = plain_parser("thesis_table", DESCRIPTION, EPILOG)
    add_arguments(parser)
    args = parser.parse_args(argv)
    if args.smoke:
        args.rows = args.rows or list(INPUTS)
        args.seeds = args.seeds[:1]
        args.iterations = min(args.iterations or 30, 30)
        args.images = min(args.images, 20)
    if not (runs := runs_of(args.rows or GROUPS, args.trained_on, list(dict.fromkeys(args.seeds)))):
        raise ValueError(
            f"none of the rows {', '.join(args.rows)} is trained on {', '.join(args.trained_on)}"
        )
    if args.list:
        say(*_listed(runs, args.iterations))
        return 0
    with needs_extra("test", "the table needs torch and SciPy"):
        import scipy  # noqa: F401
        import torch
        from tnt_reference import Classifier  # noqa: F401
    from experiments.thesis.data import RealFolder, make_set
    from experiments.thesis.factors import effects
    from experiments.thesis.merge import merged
    from experiments.thesis.numbers import aggregate, differences, markdown_table
    from experiments.thesis.runs import right_of, run_networks

    args.out = args.out or Path("table-smoke" if args.smoke else "table")
    check_folder(args.out, ("results.json", "table.md"))
    if args.into is not None:
        read_json(args.into)  # a wrong file shows now
    per_digit = 8 if args.smoke else None
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    # now, so that a missing or damaged file shows before anything is trained
    real = RealFolder(nmnist, 0.25 if args.smoke else 0.1, per_digit)
    data = real.read()
    args.out.mkdir(parents=True, exist_ok=True)
    mnist = data_folder(args.mnist, "mnist", "--mnist")
    workers = args.workers or (1 if torch.cuda.is_available() else available_cores())
    simulated = {
        name: make_set(
            name, mnist, args.out / "simulated" / name.replace(" ", "-"), data, args.images, workers
        )
        for name in SETS
    }
    note(*_listed(runs, args.iterations))
    settings = TrainSettings(iterations=args.iterations, batch=args.batch)
    started = time.monotonic()
    results = run_networks(runs, real, simulated, settings, args.out / "networks", workers)
    table = aggregate(results)
    right = right_of(results, args.out / "networks")
    by_name = {Run(r["row"], r["trained_on"], r["seed"]).name: r for r in results}
    record = {
        "command": command_words(
            "python -m experiments.thesis_table --nmnist N-MNIST --mnist MNIST",
            args,
            add_arguments,
            leave_out=("into", "json", "workers"),
        ),
        "data": {
            **data.description,
            "simulated": {name: made.parameters for name, made in simulated.items()},
        },
        "rows": {
            name: {
                "config": ROWS[name].config.to_dict(),
                "augmentation": asdict(ROWS[name].augmentation),
                "iterations": args.iterations or ROWS[name].iterations,
                "span_events": ROWS[name].span,
                "motions": {
                    r["trained_on"]: r["motions"]
                    for r in results
                    if r["row"] == name and r["motions"]
                },
            }
            for name in table
        },
        "settings": {
            name: value for name, value in results[0]["settings"].items() if name != "iterations"
        },
        "seeds": list(dict.fromkeys(run.seed for run in runs)),
        "machine": machine("torch"),
        "table": table,
        "differences": differences(right),
        "effects": effects(right),
        "validation": {name: r["validation"] for name, r in by_name.items()},
        "curves": {
            name: [{k: round(n, 6) for k, n in row.items()} for row in r["history"]]
            for name, r in by_name.items()
            if ROWS[r["row"]].group == "long"
        },
    }
    write_text(args.out / "results.json", json.dumps(record, indent=1) + "\n")
    groups = dict.fromkeys(ROWS[name].group for name in table)
    tables = "\n\n".join(markdown_table(table, [group]) for group in groups)
    write_text(args.out / "table.md", tables + "\n")
    if args.into is not None:
        there = read_json(args.into)
        write_text(args.into, json.dumps(merged(there, record), indent=1) + "\n")
    if args.json:
        say(json.dumps(record))
    else:
        say(*tables.splitlines(), *_in_words(record, args, time.monotonic() - started))
    return 0


def _listed(runs: list[Run], iterations: int | None) -> list[str]:
    """The networks, a line for each row: what it is trained on, with how many seeds, for how many
    steps."""
    lines = [f"{len(runs)} networks:"]
    for name in dict.fromkeys(run.row for run in runs):
        row = ROWS[name]
        of = [run for run in runs if run.row == name]
        on = ", ".join(dict.fromkeys(run.trained_on for run in of))
        seeds = len({run.seed for run in of})
        steps = f"{iterations or row.iterations:,} steps"
        lines.append(
            f"  {name:<30} trained on {on:<10} {seeds} seed{'s' if seeds > 1 else ' '}  {steps}"
        )
    return lines


def _in_words(record: dict[str, Any], args: argparse.Namespace, seconds: float) -> list[str]:
    data = record["data"]
    seeds = ", ".join(map(str, record["seeds"]))
    counts = {
        name: min(len(part["seeds"]) for part in columns.values())
        for name, columns in record["table"].items()
    }
    fewer = ", ".join(f"{name} {n}" for name, n in counts.items() if n < len(record["seeds"]))
    return [
        "",
        f"mean ± deviation over seeds {seeds}{f' (fewer: {fewer})' if fewer else ''}; windows per "
        f"step: {args.batch}.",
        f"N-MNIST: {data['training_recordings']} recordings to train on, "
        f"{data['held_out_recordings']} held out, "
        f"{data['test_recordings']} to test on; the split is {data['split']}.",
        f"{', '.join(data['simulated'])}: 30 simulated motions each of {args.images} MNIST test "
        "images that no "
        "training recording shows.",
        f"wrote {args.out / 'results.json'} and {args.out / 'table.md'} ({seconds / 60:.1f} "
        "minutes)",
    ]


if __name__ == "__main__":
    exit_with(main)
