"""Accuracy of `async-tnt train` with no option but the sensor's size, on three small data sets.

    python -m experiments.bare [--nmnist N-MNIST] [--poker POKER-DVS] [--characters FOLDER]
                               [--seeds N] [--out FOLDER] [--json FILE]

The folder of N-MNIST has the parts Train and Test, and the folder of POKER-DVS has pips_train and
pips_test. The folder of HOTS' characters is made by `examples/hots_characters.py`. N-CARS is
measured by the recipe `bare` of `experiments.cars`.

Finished trainings in --out are kept, and interrupted trainings resume. FILE keeps the entries of
sets that this run does not measure. Each network reads the test part once.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from async_tnt.base.progress import progress
from async_tnt.volume.sensor import format_size
from experiments.objects.pairs import SENSOR, write
from experiments.scripts.options import (
    add_count,
    add_folder,
    earlier_parts,
    exit_with,
    print_tables,
    script_parser,
    write_part,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine

SETS = {
    "nmnist": ("N-MNIST", "", "Test", ""),
    "poker": ("POKER-DVS", "pips_train", "pips_test", "--sensor 35x35"),
    "characters": ("HOTS' characters", "Train", "Test", "--sensor 32x32"),
}
"""Name of a set -> its title, its folder for training and for tests, and options of `train`."""

TESTED = ("accuracy", "recordings", "window_accuracy", "windows")
"""Numbers of the output of `async-tnt evaluate` that the report keeps."""


def measure(
    folder: Path, name: str, seeds: int, out: Path, parts: tuple[str, str, str, str]
) -> dict[str, Any]:
    """The entry of a set in the report, with a trained and tested network for each seed.

    parts : the set's row of `SETS`.
    """
    title, train, test, options = parts
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    with progress(seeds, f"training on {title}") as bar:
        for seed in range(seeds):
            model = out / f"{name}{seed}.safetensors"
            arguments = [*options.split(), "--seed", seed, "--out", model]
            record = command("train", folder / train, *arguments, "--json")
            report = command("evaluate", model, folder / test, "--json")
            row = {number: report[number] for number in TESTED}
            row["multiplications"] = record["multiplications"]
            rows.append(row)
            bar.update()
    command_line = f"async-tnt train {folder.name}/{train}".rstrip("/")
    return {
        "title": title,
        "command": f"{command_line} {options}".strip(),
        "networks": rows,
        "machine": machine("torch"),
    }


def main(argv: list[str] | None = None) -> int:
    """Train and test the networks, print the tables, and write the report."""
    parser = script_parser("bare", __doc__, "a made set and one epoch")
    for name, (title, *_) in SETS.items():
        add_folder(parser, f"--{name}", title)
    add_count(parser, "--seeds", 5, "networks")
    parser.add_argument(
        "--out", type=Path, default=Path("bare"), metavar="FOLDER", help="models (default: bare)"
    )
    args = parser.parse_args(argv)
    folders = {name: getattr(args, name) for name in SETS if getattr(args, name) is not None}
    if args.quick == bool(folders):
        parser.error(f"give --quick, or one of --{', --'.join(SETS)}")
    report = earlier_parts(args)
    for name, folder in folders.items():
        report[name] = measure(folder, name, args.seeds, args.out, SETS[name])
        write_part(args, name, report[name])
    if args.quick:
        report["made"] = _quick()
        write_part(args, "made", report["made"])
    print_tables(report, "bare")
    return 0


def _quick() -> dict[str, Any]:
    """The entry of a small made set, for --quick."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        for part, n, seed in (("train", 6, 0), ("test", 3, 1)):
            write(folder / part, n, (0.0,), seed)
        options = f"--sensor {format_size(SENSOR)} --epochs 1"
        parts = ("made objects", "train", "test", options)
        return measure(folder, "made", 1, folder / "models", parts)


if __name__ == "__main__":
    exit_with(main)
