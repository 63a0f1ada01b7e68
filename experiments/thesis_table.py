"""`python -m experiments.thesis_table`: the thesis' experiment.

Train and test its networks, and compare them.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from async_tnt.base.extras import needs_extra
from async_tnt.base.files import check_folder, write_text
from async_tnt.base.package import available_cores
from async_tnt.cli.options import positive_int, whole_number
from async_tnt.cli.output import note, say
from async_tnt.training.settings import TrainSettings
from experiments.records.run import command_line
from experiments.scripts.options import add_folder, data_folder, exit_with, plain_parser
from experiments.thesis.rows import FOREIGN, GROUPS, INPUTS, ROWS, SETS, TRAINED_ON, Run, runs_of

DESCRIPTION = f"""\
The thesis' experiment: networks that saw digits move in one way, tested in other motions.

Rows, in groups (--list names them all, and trains nothing):

{chr(10).join(f"  {name:<15} {text}" for name, text in GROUPS.items())}

Columns, trained on / tested on:

  all/all     all three saccades of N-MNIST / all three, of other digits
  1/all       the first saccade only        / all three, of other digits
  1/others    the first saccade only        / the second and third, of other digits
  1/train     the first saccade only        / all three, of the digits trained on
  .../sim ... the same                      / N-MOVING-MNIST, nine sets of 30 simulated motions,
                                              made in --out

Rows are compared seed by seed and digit by digit. The results hold each difference with its 95 %
interval, and which of them hold when all are asked at once (Holm's method).

A network is validated on held-out digits of its training motion, and tested only at the end.
Checkpoints and results of all networks are kept in --out: stop with Ctrl-C, give the same command
again, and it resumes.
"""
EPILOG = """\
examples:
  everything in a minute or two:
    python -m experiments.thesis_table --smoke --nmnist N-MNIST --mnist MNIST
  the networks, and their steps:
    python -m experiments.thesis_table --list
  the thesis' own rows:
    python -m experiments.thesis_table --nmnist N-MNIST --mnist MNIST --rows thesis --out table
  two rows with two seeds, tested on fewer images:
    python -m experiments.thesis_table --nmnist N-MNIST --mnist MNIST --rows raw line --seeds 0 1 \\
        --images 100
  the pages' results, rows at a time:
    python -m experiments.thesis_table --rows raw running --into experiments/results/thesis
"""

SMOKE_ITERATIONS = 30
"""Largest number of steps of a network with --smoke."""

SMOKE_IMAGES = 20
"""Largest number of images to simulate with --smoke."""

SMOKE_PER_DIGIT = 8
"""Number of recordings of each digit with --smoke."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    _add_data(parser.add_argument_group("data"))
    _add_rows(parser.add_argument_group("what to train"))
    _add_training(parser.add_argument_group("training"))
    _add_results(parser.add_argument_group("results"))


def _add_data(group: argparse._ArgumentGroup) -> None:
    add_folder(
        group,
        "--nmnist",
        "N-MNIST: the folder with Train/<digit>/*.bin and Test/<digit>/*.bin (default: "
        "$TNT_DATA/nmnist)",
    )
    add_folder(group, "--mnist", "MNIST's IDX files, to simulate from (default: $TNT_DATA/mnist)")
    group.add_argument(
        "--images",
        type=positive_int,
        default=500,
        metavar="N",
        help="test images of MNIST to simulate, that no training recording shows (default: 500)",
    )

    add_folder(
        group,
        "--v2e",
        "a checkout of https://github.com/SensorsINI/v2e: networks are also tested on the motions "
        "of sim as its pixels see them",
    )


def _add_rows(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--rows",
        nargs="+",
        choices=[*GROUPS, *ROWS],
        metavar="ROW",
        help=f"rows, or groups of them: {', '.join(GROUPS)} (default: all groups)",
    )
    group.add_argument(
        "--trained-on",
        nargs="+",
        choices=TRAINED_ON,
        default=list(TRAINED_ON),
        help=f"only networks trained on these (default: {' '.join(TRAINED_ON)})",
    )
    group.add_argument(
        "--seeds",
        nargs="+",
        type=whole_number,
        default=[0, 1, 2],
        metavar="N",
        help="of weights, order and augmentation (default: 0 1 2)",
    )
    group.add_argument("--list", action="store_true", help="print the networks, and stop")


def _add_training(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--iterations",
        type=positive_int,
        metavar="N",
        help="steps of the optimizer for each network (default: each row's, see --list)",
    )
    group.add_argument(
        "--batch", type=positive_int, default=64, metavar="N", help="windows per step (default: 64)"
    )
    group.add_argument(
        "--workers",
        type=positive_int,
        metavar="N",
        help="networks trained at a time, one thread each (default: all cores; 1 where torch sees "
        "a GPU)",
    )
    group.add_argument(
        "--smoke",
        action="store_true",
        help="try everything in a minute or two: three rows, 8 recordings a digit, 30 steps, seed "
        "0, 20 simulated digits",
    )


def _add_results(group: argparse._ArgumentGroup) -> None:
    add_folder(
        group,
        "--out",
        "networks, results.json, table.md (default: table; with --smoke: table-smoke)",
    )
    add_folder(
        group,
        "--into",
        "also put the result of each network there, as soon as it is trained and tested: "
        "experiments/results/thesis, which has those of other rows",
    )
    group.add_argument("--json", action="store_true", help="print the results as one JSON object")


def main(argv: list[str] | None = None) -> int:
    """Train, test and compare the networks, and write the results. Returns the exit code 0."""
    args = _parsed(argv)
    seeds = list(dict.fromkeys(args.seeds))
    runs = runs_of(args.rows or GROUPS, args.trained_on, seeds)
    if not runs:
        raise ValueError(
            f"none of the rows {', '.join(args.rows)} is trained on {', '.join(args.trained_on)}"
        )
    if args.list:
        say(*_listed(runs, args.iterations))
        return 0
    with needs_extra("test", "the table needs torch and SciPy"):
        import scipy  # noqa: F401
        import torch  # noqa: F401
        from tnt_reference import Classifier  # noqa: F401

    check_folder(args.out, ("results.json", "table.md"))
    if args.into is not None:
        # refused now, not after hours of training
        check_folder(args.into, ())
        args.into.mkdir(parents=True, exist_ok=True)
    record, seconds = _measured(runs, args)
    _write(record, args)
    if args.json:
        say(json.dumps(record))
    else:
        say(*_tables(record).splitlines(), *_in_words(record, args, seconds))
    return 0


def _parsed(argv: list[str] | None) -> argparse.Namespace:
    """The options of the command, with what --smoke changes."""
    parser = plain_parser("thesis_table", DESCRIPTION, EPILOG)
    add_arguments(parser)
    args = parser.parse_args(argv)
    if args.smoke:
        args.rows = args.rows or list(INPUTS)
        args.seeds = args.seeds[:1]
        args.iterations = min(args.iterations or SMOKE_ITERATIONS, SMOKE_ITERATIONS)
        args.images = min(args.images, SMOKE_IMAGES)
    args.out = args.out or Path("table-smoke" if args.smoke else "table")
    return args


def _measured(runs: list[Run], args: argparse.Namespace) -> tuple[dict[str, Any], float]:
    """The tables of the trained and tested networks, and the seconds that they took."""
    import torch

    from experiments.thesis.data import RealFolder, make_foreign_set, make_set
    from experiments.thesis.runs import run_networks
    from experiments.thesis.table import table_of

    # a missing or damaged file is refused before anything is trained
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    if args.smoke:
        real = RealFolder(nmnist, validation=0.25, per_digit=SMOKE_PER_DIGIT)
    else:
        real = RealFolder(nmnist)
    data = real.read()
    args.out.mkdir(parents=True, exist_ok=True)
    mnist = data_folder(args.mnist, "mnist", "--mnist")
    workers = args.workers or (1 if torch.cuda.is_available() else available_cores())
    simulated = {}
    for name in SETS:
        folder = args.out / "simulated" / name.replace(" ", "-")
        simulated[name] = make_set(name, mnist, folder, data, args.images, workers)

    if args.v2e is not None:
        folder = args.out / "simulated" / FOREIGN.replace(" ", "-")
        simulated[FOREIGN] = make_foreign_set(args.v2e, mnist, folder, data, args.images)

    note(*_listed(runs, args.iterations))
    networks = args.out / "networks"
    settings = TrainSettings(iterations=args.iterations, batch=args.batch)
    started = time.monotonic()
    command = command_line(args.module)
    results = run_networks(runs, real, simulated, settings, networks, workers, command, args.into)
    record = {
        "data": data.description,
        "seeds": list(dict.fromkeys(run.seed for run in runs)),
        **table_of(result["numbers"] for result in results),
    }
    return record, time.monotonic() - started


def _write(record: dict[str, Any], args: argparse.Namespace) -> None:
    """Write the files of --out."""
    write_text(args.out / "results.json", json.dumps(record, indent=1) + "\n")
    write_text(args.out / "table.md", _tables(record) + "\n")


def _tables(record: dict[str, Any]) -> str:
    """The table of each group of rows, in Markdown."""
    from experiments.thesis.numbers import markdown_table

    table = record["table"]
    groups = dict.fromkeys(ROWS[name].group for name in table)
    return "\n\n".join(markdown_table(table, [group]) for group in groups)


def _listed(runs: list[Run], iterations: int | None) -> list[str]:
    """Lines that list the networks, a line for each row.

    A line says what a row's networks are trained on, with how many seeds, and for how many steps.
    """
    lines = [f"{len(runs)} networks:"]
    for name in dict.fromkeys(run.row for run in runs):
        row = ROWS[name]
        row_runs = [run for run in runs if run.row == name]
        training_sets = ", ".join(dict.fromkeys(run.trained_on for run in row_runs))
        seeds = len({run.seed for run in row_runs})
        steps = f"{iterations or row.iterations:,} steps"
        lines.append(
            f"  {name:<30} trained on {training_sets:<10} {seeds} "
            f"seed{'s' if seeds > 1 else ' '}  {steps}"
        )
    return lines


def _in_words(record: dict[str, Any], args: argparse.Namespace, seconds: float) -> list[str]:
    """Lines on what the printed tables show, and on where the results are."""
    data = record["data"]
    n_seeds = len(record["seeds"])
    rows_with_fewer = []
    for name, columns in record["table"].items():
        n = min(len(part["seeds"]) for part in columns.values())
        if n < n_seeds:
            rows_with_fewer.append(f"{name} {n}")
    seeds = ", ".join(map(str, record["seeds"]))
    exceptions = f" (fewer: {', '.join(rows_with_fewer)})" if rows_with_fewer else ""
    return [
        "",
        f"mean ± deviation over seeds {seeds}{exceptions}; windows per step: {args.batch}.",
        f"N-MNIST: {data['training_recordings']} recordings to train on, "
        f"{data['held_out_recordings']} held out, {data['test_recordings']} to test on; the split "
        f"is {data['split']}.",
        f"{', '.join(SETS)}: 30 simulated motions each of {args.images} MNIST test "
        "images that no training recording shows.",
        f"wrote {args.out / 'results.json'} and {args.out / 'table.md'} ({seconds / 60:.1f} "
        "minutes)",
    ]


if __name__ == "__main__":
    exit_with(main)
