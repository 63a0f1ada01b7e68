"""`async-tnt table`: train and test all networks of the thesis' results table, and print it beside the thesis'."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.checking.timing import machine
from async_tnt.cli.data_options import add_folder, add_precision, command_words, data_folder, seed_number
from async_tnt.cli.options import positive_int
from async_tnt.files import check_folder, write_text
from async_tnt.process import available_cores
from async_tnt.training.settings import TrainSettings
from async_tnt.training.table import ROWS, TRAINED_ON

if TYPE_CHECKING:
    from async_tnt.training.table_data import RealData

PLAIN = [name for name, row in ROWS.items() if row.motions is None]
DESCRIPTION = """Train and test the networks of the thesis' results table, and print it beside the thesis' numbers.

Rows: the plain event volume (Baseline), TNT about the image centre, TNT about a regressed landmark, and the
streaming landmarks `running` and `line` (flow removed, unsigned); then the plain volume and `running` with motion
re-synthesis, an augmentation (see `async-tnt train --motions`). Columns, trained on / tested on:

  all/all   all three saccades of N-MNIST / all three, of other digits
  1/all     the first saccade only        / all three, of other digits
  1/train   the first saccade only        / all three, of the digits trained on
  all/sim   all three saccades            / 30 simulated motions of N-MOVING-MNIST
  1/sim     the first saccade only        / 30 simulated motions

With --trained-on confounded, each digit is seen in one saccade only: 0-3 in the first, 4-6 in the second, 7-9 in the
third.

A network is validated on held-out digits of its training motion, and tested only at the end. Checkpoints and results
of all networks are kept in --out: stop with Ctrl-C, give the same command again, and it resumes.
"""
EPILOG = """\
examples:
  async-tnt table --smoke --nmnist N-MNIST --mnist MNIST     everything in a minute or two, few digits
  async-tnt simulate --mnist MNIST --out moving-mnist        10,000 digits, 30 motions
  async-tnt table --nmnist N-MNIST --simulated moving-mnist --iterations 10000 --out table
  async-tnt table --nmnist N-MNIST --simulated moving-mnist --rows baseline line --seeds 0 --out table
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = EPILOG
    data = parser.add_argument_group("data")
    add_folder(
        data,
        "--nmnist",
        "N-MNIST: the folder with Train/<digit>/*.bin and Test/<digit>/*.bin (default: $TNT_DATA/nmnist)",
    )
    add_folder(
        data,
        "--simulated",
        "a set made by `async-tnt simulate`; by default the test set of 30 motions is first made in --out",
    )
    add_folder(data, "--mnist", "MNIST's IDX files, to make that set from (default: $TNT_DATA/mnist)")
    data.add_argument(
        "--skip-damaged",
        action="store_true",
        help="leave damaged recordings out, with a warning each, instead of stopping",
    )
    what = parser.add_argument_group("what to train")
    what.add_argument(
        "--rows", nargs="+", choices=list(ROWS), default=PLAIN, help="default: those without re-synthesis"
    )
    what.add_argument(
        "--trained-on", nargs="+", choices=TRAINED_ON, default=["all", "1"], help="saccades (default: all 1)"
    )
    what.add_argument(
        "--seeds",
        nargs="+",
        type=seed_number,
        default=[0, 1, 2],
        metavar="N",
        help="of weights, order and augmentation (default: 0 1 2)",
    )
    how = parser.add_argument_group("training")
    how.add_argument(
        "--iterations",
        type=positive_int,
        default=60_000,
        metavar="N",
        help="steps of the optimizer for each network (default: 60000, the thesis' number)",
    )
    how.add_argument("--batch", type=positive_int, default=64, metavar="N", help="windows per step (default: 64)")
    add_precision(how)
    how.add_argument(
        "--workers",
        type=positive_int,
        metavar="N",
        help="networks trained at a time, one thread each (default: all cores; 1 where torch sees a GPU)",
    )
    how.add_argument(
        "--smoke",
        action="store_true",
        help="try everything in a minute or two: 8 recordings a digit, 30 iterations, seed 0, 20 simulated digits",
    )
    out = parser.add_argument_group("results")
    add_folder(out, "--out", "networks, results.json, table.md (default: table; with --smoke: table-smoke)")
    out.add_argument("--json", action="store_true", help="print the results as one JSON object")


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt table`. Returns the exit code 0."""
    try:
        import torch
        from tnt_reference import Classifier  # noqa: F401
    except ImportError as error:
        raise ImportError(f"the table needs torch ({error}); install it with: pip install '.[train]'") from None
    from async_tnt.training.table import aggregate, markdown_table, motions_table, text_table
    from async_tnt.training.table_data import RealFolder
    from async_tnt.training.table_runs import Run, run_networks

    args.out = args.out or Path("table-smoke" if args.smoke else "table")
    check_folder(args.out, ("results.json", "table.md"))
    if args.smoke:
        args.seeds, args.iterations = args.seeds[:1], min(args.iterations, 30)
    per_digit = 8 if args.smoke else None
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    # now, so that a missing or damaged file shows before anything is trained
    real = RealFolder(nmnist, 0.25 if args.smoke else 0.1, per_digit, args.skip_damaged)
    data = real.read()
    args.out.mkdir(parents=True, exist_ok=True)
    simulated = args.simulated or _simulate(args, args.out / "simulated")
    simulated_description = _set_description(simulated, data)
    runs = [Run(row, on, seed) for seed in args.seeds for row in args.rows for on in args.trained_on]
    settings = TrainSettings(iterations=args.iterations, batch=args.batch, precision=args.precision)
    workers = args.workers or (1 if torch.cuda.is_available() else available_cores())
    started = time.monotonic()
    results = run_networks(runs, real, simulated, settings, args.out / "networks", workers)
    table = aggregate(results)
    record = {
        "command": command_words(
            "async-tnt table --nmnist N-MNIST --simulated MOVING-MNIST",
            args,
            add_arguments,
            leave_out=("json", "workers", "skip_damaged"),
        ),
        "data": {**data.description, "simulated": simulated_description},
        "rows": {
            name: {
                "config": ROWS[name].config.to_dict(),
                "augmentation": asdict(ROWS[name].augmentation),
                "motions": {r["trained_on"]: r["motions"] for r in results if r["row"] == name and r["motions"]},
            }
            for name in args.rows
        },
        "settings": {"iterations": args.iterations, "batch": args.batch, "precision": args.precision},
        "seeds": args.seeds,
        "machine": machine("torch"),
        "table": table,
        "validation": {Run(r["row"], r["trained_on"], r["seed"]).name: r["validation"] for r in results},
    }
    write_text(args.out / "results.json", json.dumps(record, indent=1) + "\n")
    pages = [markdown_table(table)]
    for column in ("1/all", "all/sim", "1/sim"):
        if any(column in columns for columns in table.values()):
            pages.append(f"{column}, by motion:\n\n{motions_table(table, column)}")
    write_text(args.out / "table.md", "\n\n".join(pages) + "\n")
    if args.json:
        print(json.dumps(record))
    else:
        print(text_table(table))
        print(_in_words(record, args, time.monotonic() - started))
    return 0


def _simulate(args: argparse.Namespace, folder: Path) -> Path:
    from async_tnt.simulation.moving_mnist import build

    mnist = data_folder(args.mnist, "mnist", "--mnist")
    build(mnist, folder, split="test", kind="constant", digits=20 if args.smoke else None, workers=args.workers)
    return folder


def _set_description(folder: Path, data: RealData) -> dict[str, Any]:
    """What the simulated set is, and how much of it is tested on."""
    from async_tnt.simulation.moving_mnist import open_set

    made = open_set(folder)
    if made.parameters["split"] != "test" or made.parameters["kind"] == "nmnist":
        raise ValueError(
            f"{folder}: the table needs simulated motions of MNIST's test images, got split "
            f"{made.parameters['split']!r}, motions {made.parameters['kind']!r}; see async-tnt simulate --help"
        )
    n_images = made.parameters["digits"]
    n_unseen = n_images - int((data.seen_images < n_images).sum())
    if n_unseen == 0:
        raise ValueError(
            f"{folder}: all of its {n_images} images are shown by training recordings; simulate more digits"
        )
    return {"motions": len(made.motions), "images_tested_on": n_unseen, **made.parameters}


def _in_words(record: dict[str, Any], args: argparse.Namespace, seconds: float) -> str:
    data = record["data"]
    seeds = ", ".join(map(str, args.seeds))
    return (
        f"\nmean ± deviation over seeds {seeds}; {args.iterations} iterations of {args.batch} windows each.\n"
        f"N-MNIST: {data['training_recordings']} recordings to train on, {data['held_out_recordings']} held out, "
        f"{data['test_recordings']} to test on; the split is {data['split']}.\n"
        f"Simulated: {data['simulated']['motions']} motions of {data['simulated']['images_tested_on']} MNIST test "
        "images that no training recording shows.\n"
        f"wrote {args.out / 'results.json'} and {args.out / 'table.md'} ({seconds / 60:.1f} minutes)"
    )
