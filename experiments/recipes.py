"""Which volume should `async-tnt train` take by default? Candidates on five data sets.

    python -m experiments.recipes [--cars N-CARS] [--nmnist N-MNIST] [--poker POKER-DVS]
                                  [--characters FOLDER] [--sets NAME ...] [--candidates NAME ...]
                                  [--seeds N] [--out FOLDER] [--json FILE]

The answer is the accuracy on held-out data. No test part is read:

- N-CARS, N-MNIST and POKER-DVS hold out the last recordings of each class of their training parts.
- HOTS' characters have one recording of each class. It is held out from its third window of 35 ms
  on.
- The set `sessions` is made here. It holds out a second session, with other noise, thresholds,
  places and sizes.

Finished trainings in --out are kept, and interrupted trainings resume. FILE keeps the entries of
sets and candidates that this run does not measure.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from async_tnt.base.progress import progress
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.data import dataset_data
from async_tnt.training.fitting import fit
from async_tnt.training.held_out import Split
from async_tnt.training.settings import default_config, settings_for
from async_tnt.training.training_data import TrainingData
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.work import Work
from experiments.objects.pairs import SENSOR, WINDOW_US, Session, write
from experiments.scripts.options import (
    add_count,
    add_folder,
    add_json,
    earlier_parts,
    exit_with,
    plain_parser,
    print_tables,
    write_part,
)
from experiments.speed.timing import machine

SPLIT = {"transform": "none", "polarity": "split"}
"""Settings that all candidates share."""

CANDIDATES: dict[str, dict[str, Any]] = {
    "counts": {"representation": "count", "bins": 1, **SPLIT},
    "5 bins": {"representation": "volume", "bins": 5, **SPLIT},
    "counts and times": {"representation": "count_time", "bins": 2, **SPLIT},
    "time surface": {"representation": "time_surface", "bins": 1, **SPLIT},
    "3 bins": {"representation": "volume", "bins": 3, **SPLIT},
}
"""Name of a candidate -> fields of `TNTConfig`."""

EPOCHS = {"cars": 10, "nmnist": 10}
"""Set -> number of epochs for every candidate. Other sets have the default number."""


def read(
    folder: Path, config: Any, *, part: str = "", sensor: tuple[int, int], validation: float = 0.2
) -> TrainingData:
    """The data of a folder of recordings, or of its subfolder `part`.

    validation : share of each class that is held out: its last recordings.
    """
    return dataset_data(
        folder / part,
        VolumeChoice(config, fitted=("grid", "window_us", "bins")),
        pixels=Pixels(sensor=sensor),
        split=Split(validation),
        work=Work(progress=progress),
    )


def characters(folder: Path, config: Any) -> TrainingData:
    """The data of HOTS' characters, in windows of 35 ms. From the third on they are held out."""
    data = read(folder, config.replace(window_us=35_000), sensor=(32, 32), validation=0.0)
    is_held_out = data.training.start_us >= 2 * 35_000
    return replace(
        data, training=data.training[~is_held_out], validation=data.training[is_held_out]
    )


def sessions(folder: Path, config: Any) -> TrainingData:
    """The data of two made sessions: the first is for training, the second is held out."""
    other_day = Session(threshold=0.28, mismatch=0.2, noise_hz=2.0, size=0.8, place=(6.0, -4.0))
    directions = tuple(np.pi / 4 * np.arange(8))
    session_data = []
    for k, session in enumerate((Session(), other_day)):
        session_folder = write(folder / f"session{k}", 60, directions, seed=k, session=session)
        config_of_set = config.replace(window_us=WINDOW_US)
        session_data.append(read(session_folder, config_of_set, sensor=SENSOR, validation=0.0))
    return replace(session_data[0], validation=session_data[1].training)


SETS: dict[str, Callable[[Path, Any], TrainingData]] = {
    "cars": partial(read, part="n-cars_train", sensor=(120, 100)),
    "nmnist": partial(read, sensor=(34, 34)),
    "poker": partial(read, part="pips_train", sensor=(35, 35), validation=0.34),
    "characters": characters,
    "sessions": sessions,
}
"""Set -> function that reads its folder."""


def measure(
    name: str, data: TrainingData, volume: Mapping[str, Any], seed: int, run_folder: Path
) -> dict[str, Any]:
    """Held-out accuracies of one candidate on one set, and the size of the network."""
    config = data.config.replace(**volume)
    settings = settings_for(config, len(data.training), epochs=EPOCHS.get(name), seed=seed)
    fitted = fit(replace(data, config=config), settings, run_folder, progress=progress)
    validation = fitted.model.record["validation"]
    return {
        "seed": seed,
        "per_window": validation["per_window"],
        "mean_over_time": float(np.mean(list(validation["against_time_ms"].values()))),
        "against_time_ms": validation["against_time_ms"],
        "sure_of_nothing": validation["sure_of_nothing"],
        "multiplications": fitted.model.multiplications,
        "windows": validation["windows"],
    }


def main(argv: list[str] | None = None) -> int:
    """Train the candidates, print the tables, and write the report."""
    parser = plain_parser("recipes", __doc__)
    for name in SETS:
        if name != "sessions":
            add_folder(parser, f"--{name}", f"the data set {name}")
    parser.add_argument(
        "--sets", nargs="+", choices=list(SETS), metavar="NAME", help="default: those with a folder"
    )
    parser.add_argument(
        "--candidates",
        nargs="+",
        choices=list(CANDIDATES),
        default=list(CANDIDATES)[:2],
        metavar="NAME",
    )
    add_count(parser, "--seeds", 1, "of each candidate")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("recipes"),
        metavar="FOLDER",
        help="runs (default: recipes)",
    )
    add_json(parser)
    args = parser.parse_args(argv)
    torch.set_num_threads(1)
    sets_with_folder = [
        name for name in SETS if name == "sessions" or getattr(args, name) is not None
    ]
    names = args.sets or sets_with_folder
    report = earlier_parts(args)
    for name in names:
        _measure_set(name, args, report)
    print_tables(report, "recipes")
    return 0


def _measure_set(name: str, args: argparse.Namespace, report: dict[str, Any]) -> None:
    """Measure the candidates and seeds that the report does not have yet, and write each."""
    folder = args.out / "sessions" if name == "sessions" else getattr(args, name)
    if folder is None:
        raise FileNotFoundError(f"no folder of {name}: give --{name}")
    data = SETS[name](folder, default_config())
    for candidate in args.candidates:
        for seed in range(args.seeds):
            part = f"{name}, {candidate}, seed {seed}"
            if part not in report:
                run_folder = args.out / name / f"{candidate}{seed}".replace(" ", "_")
                numbers = measure(name, data, CANDIDATES[candidate], seed, run_folder)
                report[part] = {"set": name, "candidate": candidate, **numbers}
                write_part(args, part, {**report[part], "machine": machine("torch")})


if __name__ == "__main__":
    exit_with(main)
