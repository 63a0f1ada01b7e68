"""Classifiers that are trained on pictures alone, and tested on recordings of real cameras.

    python -m experiments.from_pictures [--nmnist N-MNIST] [--poker POKER-DVS] [--characters FOLDER]
                                        [--made] [--fonts FOLDER] [--seeds N] [--out FOLDER]
                                        [--json FILE]

Each set has pictures for training and recordings for the test:

nmnist      Training: MNIST's training images. Test: N-MNIST's official test part, which is Test and
            the recordings of Train with numbers above 60,000; also digits simulated in other
            motions, at other speeds and bright (`pictures/moving_digits.py`). The first network,
            with its test in its record, becomes FOLDER/digits-from-pictures.safetensors.
poker       Training: card pips, drawn with fonts. Test: both parts of POKER-DVS. Its recordings are
            crops that follow a pip.
characters  Training: ten digits and 26 letters, drawn with fonts. Test: both parts of HOTS'
            characters, which `examples/hots_characters.py` makes.
made        Training: ten pictures of each of six objects, with backgrounds. Test: made recordings
            of other objects of these kinds (`pictures/made.py`).

The networks of nmnist and made are trained by `async-tnt train PICTURES` with the options that
their rows state. Those of poker and characters are trained in the same way, but with a simulated
sensor that follows the object. Each network reads the recordings once. Finished trainings in --out
are kept, and interrupted trainings resume. FILE keeps the entries of sets that this run does not
measure.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import load_model
from async_tnt.base.package import available_cores
from async_tnt.base.progress import progress
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.data import dataset_data
from async_tnt.training.fitting import fit
from async_tnt.training.held_out import Split
from async_tnt.training.plan import Plan
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.work import Work
from experiments.digit_data.mnist import load_mnist
from experiments.pictures import made, moving_digits
from experiments.pictures.symbols import CHARACTERS, PIPS, write_glyphs, write_mnist
from experiments.scripts.options import (
    add_count,
    add_folder,
    data_folder,
    earlier_parts,
    exit_with,
    print_tables,
    script_parser,
    write_part,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine
from experiments.thesis.data import OFFICIAL

TITLES = {
    "nmnist": "N-MNIST",
    "poker": "POKER-DVS",
    "characters": "HOTS' characters",
    "made": "made objects",
}
"""Set -> its name in the table."""

TESTS = {
    "nmnist": ["official"],
    "poker": ["pips_train", "pips_test"],
    "characters": ["Train", "Test"],
    "made": ["Test"],
}
"""Set -> the folders whose recordings are for the test."""

OPTIONS = {
    # A digit has about 20 of the 28 pixels of its picture, and N-MNIST shows the picture on 28 of
    # the sensor's 34 pixels: a digit has about .6 of the sensor's size. There are many pictures, so
    # a wide network and many epochs pay, and a small share is enough to validate.
    "nmnist": "--sensor 34x34 --size 0.5-0.7 --validation 0.05 --network wide --epochs 40",
    "poker": "--sensor 35x35 --window-us 25000",
    "characters": "--sensor 32x32",
    "made": "--sensor 48x48 --size 0.7-1",
}
"""Set -> options of `train`."""

FOLLOWING = {"poker": VolumeChoice.of(window_us=25_000), "characters": VolumeChoice.of()}
"""Set whose recordings are crops that follow the object -> the choice of its volume. No option of
`async-tnt train` simulates such crops, so `train_following` trains for these sets."""

SENSORS = {"poker": (35, 35), "characters": (32, 32)}
"""Set of `FOLLOWING` -> width and height of its sensor, in pixels."""


def train_following(
    name: str, pictures: Path, seed: int, epochs: int | None, out: Path
) -> dict[str, Any]:
    """Train as `async-tnt train` does, but with a simulated sensor that follows the object.

    Writes the model to `out`, and returns its record.
    """
    run_folder = out.parent / "runs" / out.stem
    run_folder.mkdir(parents=True, exist_ok=True)
    volume = FOLLOWING[name]
    data = dataset_data(
        pictures,
        volume,
        pixels=Pixels(sensor=SENSORS[name]),
        split=Split(seed=seed),
        scenes={"follow": True},
        work=Work(run_folder, available_cores(), progress),
    )
    plan = Plan(volume, seed=seed, epochs=epochs, has_pictures=True)
    fitted = fit(data, plan.settings_for(data), run_folder, progress=progress)
    fitted.model.save(out)
    return dict(fitted.model.record)


def write_pictures(name: str, folder: Path, mnist: Path | None, n: int, fonts: Path | None) -> None:
    """Write the pictures of a set."""
    if name == "nmnist":
        write_mnist(folder, data_folder(mnist, "mnist", "--mnist"), n)
    elif name == "poker":
        write_glyphs(folder, PIPS, fonts)
    elif name == "made":
        made.write_pictures(folder, 10, 0)
    else:
        write_glyphs(folder, CHARACTERS, fonts)


def link_official(nmnist: Path, out: Path) -> None:
    """Write links to N-MNIST's recordings of the official test part, in `out/official/<digit>`.

    See `thesis/data.py`.
    """
    for path in [*nmnist.glob("Test/*/*.bin"), *nmnist.glob("Train/*/*.bin")]:
        if path.parts[-3] == "Test" or int(path.stem) > OFFICIAL[0]:
            link = out / "official" / path.parent.name / path.name
            link.parent.mkdir(parents=True, exist_ok=True)
            if not link.exists():
                link.symlink_to(path.resolve())


def measure(
    name: str,
    pictures: Path,
    tests: list[Path],
    seeds: int,
    out: Path,
    more_options: tuple[str, ...],
) -> dict[str, Any]:
    """The entry of a set in the report, with a trained and tested network for each seed.

    more_options : options of `train` besides those of `OPTIONS`.
    """
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    with progress(seeds, f"training for {TITLES[name]}") as bar:
        for seed in range(seeds):
            model = out / f"{name}{seed}.safetensors"
            arguments = [
                *OPTIONS[name].split(),
                *more_options,
                "--seed",
                seed,
                "--out",
                model,
                "--json",
            ]
            began = time.monotonic()
            is_new = not model.exists()
            if name in FOLLOWING:
                # the only further option is --epochs, with its number
                epochs = int(more_options[1]) if more_options else None
                record = train_following(name, pictures, seed, epochs, model)
            else:
                record = command("train", pictures, *arguments)
            minutes = (time.monotonic() - began) / 60
            reports = [command("evaluate", model, folder, "--json") for folder in tests]
            recording_confusion = np.sum([report["confusion"] for report in reports], 0)
            window_confusion = np.sum([report["window_confusion"] for report in reports], 0)
            rows.append(
                {
                    "accuracy": float(np.trace(recording_confusion) / recording_confusion.sum()),
                    "recordings": int(recording_confusion.sum()),
                    "window_accuracy": float(np.trace(window_confusion) / window_confusion.sum()),
                    "windows": int(window_confusion.sum()),
                    "minutes": minutes if is_new else None,
                    "simulated_held_out": record["validation"]["per_window"],
                    "confusion": recording_confusion.tolist(),
                }
            )
            bar.update()
    command_line = f"async-tnt train PICTURES {OPTIONS[name]}"
    if name in FOLLOWING:
        command_line += " (following)"
    return {
        "title": TITLES[name],
        "command": " ".join((command_line, *more_options)),
        "pictures": record["data"]["pictures"],
        "classes": reports[0]["classes"],
        "networks": rows,
        "machine": machine("torch"),
    }


def test_moving(networks: list[dict[str, Any]], out: Path, mnist: Path, n: int) -> dict[str, Any]:
    """Accuracies of the networks on `n` simulated digits.

    The function also writes the model that is bundled: the first network, with its test in its
    record.
    """
    models = [load_model(out / f"models/nmnist{seed}.safetensors") for seed in range(len(networks))]
    tested = {"recordings of": "N-MNIST's official test part", **networks[0], "minutes": None}
    bundled = replace(models[0], record={**models[0].record, "test": tested})
    bundled.save(out / "digits-from-pictures.safetensors")
    images, labels = load_mnist(mnist, "test")
    return moving_digits.accuracies(models, images[:n], labels[:n])


def main(argv: list[str] | None = None) -> int:
    """Make the pictures, train and test the networks, print the tables, and write the report."""
    parser = script_parser("from_pictures", __doc__, "one seed and epoch, 20 pictures of MNIST")
    for name in [name for name in TITLES if name != "made"]:
        add_folder(parser, f"--{name}", TITLES[name])
    parser.add_argument("--made", action="store_true", help="made objects")
    add_folder(parser, "--mnist", "with MNIST's IDX files (default: $TNT_DATA/mnist)")
    add_folder(
        parser,
        "--fonts",
        "TrueType and OpenType files, at any depth (default: those of matplotlib)",
    )
    add_count(parser, "--pictures", 60_000, "of MNIST")
    add_count(parser, "--seeds", 5, "networks")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="default: pictures, of --quick pictures/quick"
    )
    args = parser.parse_args(argv)
    out = args.out or Path("pictures/quick" if args.quick else "pictures")
    folders = {name: getattr(args, name) for name in TITLES if getattr(args, name)}
    if not folders:
        parser.error(f"give one of --{', --'.join(TITLES)}")
    if args.made:
        folders["made"] = out / "recordings"
        made.write_recordings(folders["made"] / "Test", 30, 1)
    report = earlier_parts(args)
    for name, folder in folders.items():
        pictures = out / name
        write_pictures(name, pictures, args.mnist, 20 if args.quick else args.pictures, args.fonts)
        seeds, more = (1, ("--epochs", "1")) if args.quick else (args.seeds, ())
        if name == "nmnist":
            link_official(folder, out)
            folder = out
        parts = [folder / part for part in TESTS[name]]
        report[name] = measure(name, pictures, parts, seeds, out / "models", more)
        if name == "nmnist":
            mnist = data_folder(args.mnist, "mnist", "--mnist")
            n_images = 5 if args.quick else 1_000
            report[name]["simulated"] = test_moving(report[name]["networks"], out, mnist, n_images)
        write_part(args, name, report[name])
    print_tables(report, "from_pictures")
    return 0


if __name__ == "__main__":
    exit_with(main)
