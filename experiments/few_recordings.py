"""How many real recordings does a classifier need beside pictures, and without?

The answer is the accuracy on N-MNIST's Test, by the number of recordings of Train.

    python -m experiments.few_recordings [--nmnist N-MNIST] [--mnist MNIST] [--seeds N]
                                         [--out FOLDER] [--json FILE] [--picture FILE]

Each data set has the first 0, 1, 10, 100 or all recordings of each class, with MNIST's training
images or without. `async-tnt train` is given no option but the sensor's size. If a data set has
pictures, `train` also turns, shears and thins windows. Finished trainings in --out are kept, and
interrupted trainings resume.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.views.figure_style import OFF, ON, axes_at, headline, new_figure
from experiments.pictures.symbols import write_mnist
from experiments.scripts.options import (
    add_count,
    add_folder,
    data_folder,
    exit_with,
    run_script,
    script_parser,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PER_CLASS = (0, 1, 10, 100, 10_000)
"""Numbers of recordings of each class. The last number means all, as no class has so many."""

FEWEST_ALONE = 10
"""Least number of recordings of each class without pictures. Fewer are too few to hold some out."""

WAYS = {"pictures and recordings": ON, "recordings alone": OFF}
"""What is trained on -> its colour."""


def write_set(folder: Path, pictures: Path | None, nmnist: Path, n: int) -> int:
    """Write links to pictures and to the first `n` recordings of each class.

    Returns the number of recordings of a class, as a rounded mean over the classes.
    """
    counts = []
    for source in sorted(path for path in (nmnist / "Train").iterdir() if path.is_dir()):
        recordings = sorted(source.glob("*.bin"))[:n]
        counts.append(len(recordings))
        picture_files = sorted((pictures / source.name).glob("*.png")) if pictures else []
        (folder / source.name).mkdir(parents=True, exist_ok=True)
        for path in [*recordings, *picture_files]:
            link = folder / source.name / path.name
            if not link.exists():
                link.symlink_to(path.resolve())
    return round(np.mean(counts))


def measure(nmnist: Path, mnist: Path, out: Path, seeds: int, quick: bool) -> dict[str, Any]:
    """The report: accuracies for each number of recordings, with pictures and without."""
    n_pictures = 20 if quick else 60_000
    options = ("--epochs", "1") if quick else ()
    per_class = (0, 10) if quick else PER_CLASS
    pictures = out / "mnist"
    write_mnist(pictures, mnist, n_pictures)
    rows_by_way: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    with progress(len(WAYS) * len(per_class), "training") as bar:
        for n in per_class:
            for way, rows in rows_by_way.items():
                is_alone = way == "recordings alone"
                bar.update()
                if is_alone and n < FEWEST_ALONE:
                    continue
                folder = out / f"{'alone' if is_alone else 'both'}{n}"
                n_recordings = write_set(folder, None if is_alone else pictures, nmnist, n)
                networks = []
                for seed in range(seeds):
                    model = out / f"{folder.name}-{seed}.safetensors"
                    arguments = ["--sensor", "34x34", *options, "--seed", seed, "--out", model]
                    command("train", folder, *arguments, "--json")
                    report = command("evaluate", model, nmnist / "Test", "--json")
                    networks.append(
                        {name: report[name] for name in ("accuracy", "window_accuracy")}
                    )
                rows.append({"per_class": n_recordings, "networks": networks})
    return {"ways": rows_by_way, "pictures": n_pictures, "machine": machine("torch")}


def draw(report: dict[str, Any]) -> Figure:
    """Draw the share of wrong windows against the number of recordings of each class.

    Both axes are logarithmic, so no recordings are drawn at 0.3.
    """
    figure = new_figure(3.6)
    axes = axes_at(figure, 0.8, 0.6, 9.2, 2.4)
    for way, colour in WAYS.items():
        rows = report["ways"][way]
        wrong_percent = [
            100 * (1 - np.mean([network["window_accuracy"] for network in row["networks"]]))
            for row in rows
        ]
        axes.plot(
            [max(0.3, row["per_class"]) for row in rows],
            wrong_percent,
            color=colour,
            marker="o",
            label=way,
        )
    counts = [row["per_class"] for row in report["ways"]["pictures and recordings"]]
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([max(0.3, n) for n in counts], [f"{n:,}" for n in counts])
    axes.minorticks_off()
    axes.set_yticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
    axes.set_xlabel("real recordings of each class")
    axes.set_ylabel("windows wrong (%)")
    axes.legend(frameon=False)
    headline(figure, "N-MNIST's test windows: pictures in the place of recordings")
    return figure


def main(argv: list[str] | None = None) -> int:
    """Measure the report or read it, print its tables, and write its files and picture."""
    parser = script_parser(
        "few_recordings", __doc__, "one epoch, 20 pictures, 10 recordings", draws=True
    )
    add_folder(parser, "--nmnist", "with Train/<digit>/*.bin and Test (default: $TNT_DATA/nmnist)")
    add_folder(parser, "--mnist", "with MNIST's IDX files (default: $TNT_DATA/mnist)")
    add_count(parser, "--seeds", 1, "networks of each")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="data and models (default: few)")
    args = parser.parse_args(argv)

    def measure_report(quick: bool) -> dict[str, Any]:
        folders = (
            data_folder(args.nmnist, "nmnist", "--nmnist"),
            data_folder(args.mnist, "mnist", "--mnist"),
        )
        with TemporaryDirectory() as name:
            return measure(*folders, args.out or Path(name if quick else "few"), args.seeds, quick)

    return run_script(parser, argv, measure_report, "few_recordings", draw)


if __name__ == "__main__":
    exit_with(main)
