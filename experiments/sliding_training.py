"""Is a stream decided better by windows that slide? Networks trained on both kinds of windows.

    python -m experiments.sliding_training [--nmnist N-MNIST] [--cars N-CARS] [--seeds N]
                                           [--out FOLDER] [--json FILE] [--picture FILE]

Both networks of a seed see counts of ON and OFF events, and are trained by `async-tnt train` with
the same options besides the length of a window: `--window-us` or `--last-us`. Then test recordings
are streamed. A decision is made every fiftieth of a window, and at a moment since a recording's
first event the newest one counts, whichever window it is about. The network of fixed windows is
also tried in a window that slides.

Recordings of N-MNIST are as long as three windows, those of N-CARS as long as one. Finished
trainings in --out are kept, and interrupted ones resume. FILE keeps the sets that this run does not
measure. Each network reads the test part once in each kind of window.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from async_tnt import Model, Processor, load_model
from async_tnt.base.progress import progress
from async_tnt.evaluation.early import decision_at, every_us
from async_tnt.sources import open_recording
from async_tnt.sources.files.labelled_recordings import find_recordings
from async_tnt.volume.sensor import format_size
from experiments.objects.pairs import SENSOR, write
from experiments.scripts.options import (
    add_count,
    add_folder,
    earlier_parts,
    exit_with,
    run_script,
    script_parser,
    write_part,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine
from experiments.tables.sliding_curves import draw_curves


@dataclass(frozen=True)
class DataSet:
    """A data set, and how networks are trained on it.

    Parameters
    ----------
    title : its name.
    train, test : its folders for training and for tests.
    options : options of `train`, besides the length of a window.
    window_us : the length of a window.
    duration_us : up to when decisions are looked at, since a recording's first event.
    """

    title: str
    train: str
    test: str
    options: str
    window_us: int
    duration_us: int


COUNTS = "--volume representation=count"
"""Option of every training: without it, the data set decides on time bins."""

SETS = {
    "nmnist": DataSet("N-MNIST", "", "Test", COUNTS, 105_000, 315_000),
    "cars": DataSet(
        "N-CARS",
        "n-cars_train",
        "n-cars_test",
        f"--sensor 120x100 --mirror --epochs 6 --validation 0.05 {COUNTS}",
        100_000,
        100_000,
    ),
}
"""Name of a set -> what it is."""

LENGTHS = {"fixed": "--window-us", "sliding": "--last-us"}
"""Kind of windows -> the option of `train` for their length."""


def measure(name: str, data_set: DataSet, folder: Path, seeds: int, out: Path) -> dict[str, Any]:
    """The entry of a set in the report: curves of the networks of each seed."""
    out.mkdir(parents=True, exist_ok=True)
    networks = []
    with progress(2 * seeds, f"training on {data_set.title}") as bar:
        for seed in range(seeds):
            curves = {}
            for kind, option in LENGTHS.items():
                path = out / f"{name}-{kind}{seed}.safetensors"
                words = [*data_set.options.split(), option, data_set.window_us]
                arguments = [*words, "--seed", seed, "--out", path]
                command("train", folder / data_set.train, *arguments, "--json")
                model = load_model(str(path))
                curves[f"trained {kind}, streamed {kind}"] = _curve(model, data_set, folder)
                if kind == "fixed":
                    slid = replace(model, config=model.config.replace(last_us=data_set.window_us))
                    curves["trained fixed, streamed sliding"] = _curve(slid, data_set, folder)
                bar.update()
            networks.append(curves)
    options = f"{data_set.options} --window-us|--last-us {data_set.window_us}"
    return {
        "title": data_set.title,
        "command": f"async-tnt train {folder.name}/{data_set.train} {options}",
        "window_ms": data_set.window_us / 1e3,
        "networks": networks,
        "machine": machine("torch"),
    }


def _curve(model: Model, data_set: DataSet, folder: Path) -> dict[str, Any]:
    """The shares of test recordings that are right at moments since their first events."""
    step_us = every_us(model.config)
    assert step_us is not None
    moments_us = np.arange(step_us, data_set.duration_us + 1, step_us)
    processor = Processor(model, every_us=step_us)
    right = np.zeros(len(moments_us), np.int64)
    n = 0
    recordings = [
        (label, recording.path)
        for label, files in find_recordings(folder / data_set.test).items()
        for recording in files
    ]
    with progress(len(recordings), "testing") as bar:
        for label, path in recordings:
            right += _right(processor, model, label, path, moments_us)
            n += 1
            bar.update()
    return {
        "recordings": n,
        "right": dict(zip((moments_us / 1e3).tolist(), right.tolist(), strict=True)),
        "mean": float(right.mean() / n),
        "end": float(right[-1] / n),
    }


def _right(
    processor: Processor, model: Model, label: str, path: Path, moments_us: np.ndarray
) -> Sequence[bool]:
    """Whether the newest decision at each moment is right. Without a decision none is."""
    processor.reset()
    events = open_recording(path, sensor=model.config.sensor).read()
    if not len(events):
        return [False] * len(moments_us)
    decisions = processor.push(events) + processor.finish()
    first_us = int(events["t"][0])
    newest = [decision_at(decisions, first_us + int(moment)) for moment in moments_us]
    return [decision is not None and decision.label == label for decision in newest]


def main(argv: list[str] | None = None) -> int:
    """Train and test the networks, print the tables, and draw the picture if asked."""
    parser = script_parser("sliding_training", __doc__, "a made set and one epoch", draws=True)
    for name, data_set in SETS.items():
        add_folder(parser, f"--{name}", data_set.title)
    add_count(parser, "--seeds", 2, "networks of each kind")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("sliding"),
        metavar="FOLDER",
        help="models (default: sliding)",
    )
    args = parser.parse_args(argv)

    def measured(quick: bool) -> dict[str, Any]:
        return _measured(args, quick)

    return run_script(parser, argv, measured, "sliding_training", draw_curves, is_written=True)


def _measured(args: argparse.Namespace, quick: bool) -> dict[str, Any]:
    """The report."""
    if quick:
        return {"made": _quick(args)}
    folders = {name: getattr(args, name) for name in SETS if getattr(args, name) is not None}
    if not folders:
        raise ValueError(f"give --quick, or one of --{', --'.join(SETS)}")
    report = earlier_parts(args)
    for name, folder in folders.items():
        report[name] = measure(name, SETS[name], folder, args.seeds, args.out)
        write_part(args, name, report[name])
    return report


def _quick(args: argparse.Namespace) -> dict[str, Any]:
    """The entry of a small made set, for --quick."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        for part, n, seed in (("train", 6, 0), ("test", 3, 1)):
            write(folder / part, n, (0.0,), seed)
        options = f"--sensor {format_size(SENSOR)} --epochs 1 {COUNTS}"
        made = DataSet("made objects", "train", "test", options, 50_000, 150_000)
        numbers = measure("made", made, folder, 1, folder / "models")
    write_part(args, "made", numbers)
    return numbers


if __name__ == "__main__":
    exit_with(main)
