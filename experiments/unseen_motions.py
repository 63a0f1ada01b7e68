"""Recognizing objects in motions that were not recorded: with and without motion re-synthesis.

    python -m experiments.unseen_motions [--set NAME] [--seeds N] [--out FOLDER] [--nmnist N-MNIST]
                                         [--mnist MNIST] [--json FILE]

The sets are:

hands      eight objects that a hand swings by two or three pixels in front of a sensor of 128x128,
           made by a renderer and pixels of their own (`objects/hands.py`). They are also tested in
           a second session.
saccades   N-MNIST's digits with a fifth of their events (`digit_data/thinned_saccades.py`)
volumes    the digits of `saccades`, trained with re-synthesis and with several volumes
whole      all recordings of N-MNIST with all of their events, trained with re-synthesis. They are
           also tested in the 30 constant motions of N-MOVING-MNIST (*sim*, 3,000 images that no
           training recording shows).

All training recordings move in one direction, to the right or as in the first saccade. The networks
are tested in this motion and in others, and are compared with networks that are trained in all
directions. Hands are also shown to networks by cheap ways to other directions, as
controls. The commands with and without re-synthesis differ by one option:

    async-tnt train OBJECTS --sensor WxH --window-us US
    async-tnt train OBJECTS --sensor WxH --window-us US --motions resynthesized

Finished trainings in --out are kept, and interrupted ones resume.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from async_tnt import load_model
from async_tnt.base.package import available_cores
from async_tnt.base.progress import progress
from async_tnt.training.evaluation import class_probabilities
from async_tnt.training.pipeline import pipeline_of
from async_tnt.volume.sensor import format_size
from experiments.digit_data import thinned_saccades
from experiments.digit_data.recordings import CLASSES, SACCADE_US
from experiments.motions.versions import FLIPPED
from experiments.objects import hands
from experiments.objects.versions import GROUPS, write_versions
from experiments.scripts.options import (
    add_count,
    add_folder,
    data_folder,
    exit_with,
    print_tables,
    script_parser,
    write_outputs,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine
from experiments.thesis.data import RealFolder, make_set, simulated_windows

RIGHT = (0.0,)
"""The direction that is recorded."""

OTHERS = hands.DIRECTIONS[1:]
"""The directions that are not recorded."""

OF_NMNIST = ("saccades", "volumes", "whole")
"""Sets that are made of N-MNIST."""

N_IMAGES = 3_000
"""Number of images that are simulated in other motions."""

SETS = ("hands", *OF_NMNIST)
"""Names of the sets."""

MOVED = ("--motions", "resynthesized")
"""Option of `train` for motion re-synthesis."""


@dataclass(frozen=True)
class Mode:
    """A way to train.

    Parameters
    ----------
    directions : directions of the recordings, in radians.
    options : options of `train`.
    versions : versions in which each recording is shown, too, see `objects.versions`.
    epochs : number of epochs without versions; None: the default of `train`. With versions it is
        divided by their number, so that all ways have as many steps.
    """

    directions: tuple[float, ...]
    options: tuple[str, ...] = ()
    versions: tuple[str, ...] = ()
    epochs: int | None = None


TURNED = "turned"
"""Version of a recording that is turned by any angle."""

UNSIGNED = ("--volume", "polarity=unsigned")
"""Option of `train` that leaves out polarity."""

CHEAP_WAYS = {
    "turned": Mode(RIGHT, (), (TURNED,), 25),
    "reversed": Mode(RIGHT, (), ("reversed",), 25),
    "flipped": Mode(RIGHT, (), FLIPPED, 25),
    "unsigned": Mode(RIGHT, UNSIGNED, (), 25),
    "unsigned, turned, reversed, flipped": Mode(
        RIGHT, UNSIGNED, (TURNED, *FLIPPED, "reversed"), 25
    ),
}
"""Cheap ways to other directions of hand motion, the controls of re-synthesis."""

VOLUMES = {
    "counts": ("--volume", "representation=count,polarity=split,transform=none"),
    "5 bins": ("--volume", "representation=volume,bins=5,polarity=split,transform=none"),
    "5 bins, unsigned": (
        "--volume",
        "representation=volume,bins=5,polarity=unsigned,transform=none",
    ),
    "9 bins, signed": ("--volume", "representation=volume,bins=9,polarity=signed,transform=none"),
    "TNT, running": (
        "--volume",
        "representation=volume,bins=9,polarity=split,transform=tnt,landmark=running,t_max=4",
    ),
}
"""Name of a volume -> option of `train`."""


@dataclass(frozen=True)
class MadeSet:
    """A set: how its recordings are made, and which of them are for training and for tests.

    Parameters
    ----------
    classes : names of the classes.
    sensor : width and height of the sensor, in pixels.
    window_us : length of a window, in microseconds.
    write : function that writes training recordings. It is called with folder, number of recordings
        of each class, directions, and seed.
    n_train, n_test : numbers of recordings of each class; None: all.
    modes : name of a way to train -> its recordings and options.
    tests : name of a test -> directions of the recordings, and function that writes them.
    simulated : function that is called with models, a folder and a number of images, and gives the
        accuracy of each model in simulated motions. None: there is no such test.
    """

    classes: tuple[str, ...]
    sensor: tuple[int, int]
    window_us: int
    write: Callable[..., Path]
    n_train: int | None
    n_test: int | None
    modes: Mapping[str, Mode]
    tests: Mapping[str, tuple[tuple[float, ...], Callable[..., Path]]]
    simulated: Callable[[list[Path], Path, int], list[float]] | None = None


def sets(nmnist: Path | None, mnist: Path | None = None) -> dict[str, MadeSet]:
    """Name -> set. Without the folder of N-MNIST, there are no sets that are made of it.

    mnist : MNIST, which the test of `whole` in simulated motions needs.
    """
    write_hands = partial(hands.write, session=hands.SESSIONS[0])
    write_other_hands = partial(hands.write, session=hands.SESSIONS[1])
    sets_by_name = {
        "hands": MadeSet(
            tuple(hands.SHAPES),
            hands.SENSOR,
            hands.WINDOW_US,
            write_hands,
            160,
            40,
            {**_modes(RIGHT, hands.DIRECTIONS, 25), **CHEAP_WAYS},
            {
                "recorded motion": (RIGHT, write_hands),
                "other motions": (OTHERS, write_hands),
                "opposite": ((np.pi,), write_hands),
                "perpendicular": ((np.pi / 2, -np.pi / 2), write_hands),
                "turned": (tuple(np.pi / 4 * np.array([1, 3, 5, 7])), write_hands),
                "other motions, another session": (OTHERS, write_other_hands),
            },
        ),
    }
    if nmnist is not None:
        write_training = partial(thinned_saccades.write, source=nmnist / "Train")
        write_test = partial(thinned_saccades.write, source=nmnist / "Test")
        sets_by_name["saccades"] = MadeSet(
            CLASSES,
            thinned_saccades.SENSOR,
            SACCADE_US,
            write_training,
            480,
            100,
            _modes((0,), (0, 1, 2)),
            {"recorded motion": ((0,), write_test), "other motions": ((1, 2), write_test)},
        )
        sets_by_name["volumes"] = replace(
            sets_by_name["saccades"],
            modes={name: Mode((0,), (*MOVED, *options)) for name, options in VOLUMES.items()},
        )
        sets_by_name["whole"] = MadeSet(
            CLASSES,
            thinned_saccades.SENSOR,
            SACCADE_US,
            partial(write_training, share=1.0),
            None,
            None,
            {"resynthesized": Mode((0,), MOVED)},
            {
                "first saccade": ((0,), partial(write_test, share=1.0)),
                "all saccades": ((0, 1, 2), partial(write_test, share=1.0)),
            },
            None if mnist is None else partial(_in_simulated_motions, nmnist=nmnist, mnist=mnist),
        )
    return sets_by_name


def _modes(
    recorded: tuple[float, ...], every: tuple[float, ...], epochs: int | None = None
) -> dict[str, Mode]:
    """Three ways to train: on the recorded directions, re-synthesized, and on all directions.

    every : all directions.
    """
    return {
        "recorded": Mode(recorded, epochs=epochs),
        "resynthesized": Mode(recorded, MOVED, epochs=epochs),
        "all directions": Mode(every, epochs=epochs),
    }


def measure(
    made_set: MadeSet, seeds: int, out: Path, extra: tuple[str, ...] = ()
) -> dict[str, Any]:
    """The report of a set, with the accuracy of each way to train in each test.

    extra : options of `train` for all networks.
    """
    results: dict[str, list[dict[str, float]]] = {mode: [] for mode in made_set.modes}
    records = []
    with progress(len(made_set.modes) * seeds, "training") as bar:
        for seed in range(seeds):
            # random seeds of three kinds of data: training in one direction, training in all
            # directions, and each of the tests
            one_seed = (len(made_set.tests) + 2) * seed
            all_seed = one_seed + 1
            first_test_seed = one_seed + 2
            tests = {
                name: write(
                    out / f"test{k}-{seed}", made_set.n_test, directions, first_test_seed + k
                )
                for k, (name, (directions, write)) in enumerate(made_set.tests.items())
            }
            for name, mode in made_set.modes.items():
                data_seed = one_seed if len(mode.directions) == 1 else all_seed
                objects, options = _data_of(made_set, name, seed, data_seed, out)
                model = out / f"{_file_name(name)}{seed}.safetensors"
                arguments: list[object] = ["--sensor", format_size(made_set.sensor)]
                arguments += ["--window-us", made_set.window_us]
                arguments += [*options, "--seed", seed, "--out", model, "--json", *extra]
                records.append(command("train", objects, *arguments).get("motions"))
                row = {}
                for test, test_folder in tests.items():
                    row[test] = command("evaluate", model, test_folder, "--json")["accuracy"]
                results[name].append(row)
                bar.update()

    if made_set.simulated is not None:
        for name, rows in results.items():
            models = [out / f"{_file_name(name)}{seed}.safetensors" for seed in range(seeds)]
            shares = made_set.simulated(models, out / "sim", made_set.n_train or N_IMAGES)
            for row, accuracy_of_model in zip(rows, shares, strict=True):
                row["simulated motions"] = accuracy_of_model

    accuracy: dict[str, dict[str, Any]] = {}
    for name, rows in results.items():
        accuracy[name] = {
            test: {"mean": float(np.mean(values)), "seeds": values}
            for test, values in _columns(rows).items()
        }
    n_classes = len(made_set.classes)
    return {
        "classes": made_set.classes,
        "recordings": {
            "training": None if made_set.n_train is None else made_set.n_train * n_classes,
            "test, each": None if made_set.n_test is None else made_set.n_test * n_classes,
        },
        "seeds": list(range(seeds)),
        "accuracy": accuracy,
        "motions": [record for record in records if record],
        "machine": machine("torch"),
    }


def _file_name(mode: str) -> str:
    """The name of a way to train, as files have it."""
    return mode.replace(",", "").replace(" ", "-")


def _data_of(
    made_set: MadeSet, name: str, seed: int, data_seed: int, out: Path
) -> tuple[Path, list[str]]:
    """The training data of a way to train, which are written, and its options of `train`.

    data_seed : seed of the recordings.
    """
    mode = made_set.modes[name]
    kind = "one" if len(mode.directions) == 1 else "all"
    objects = out / f"{kind}-{seed}"
    made_set.write(objects, made_set.n_train, mode.directions, data_seed)
    options = [*mode.options]
    n_versions = 1
    if mode.versions:
        recorded = objects
        objects = out / f"{_file_name(name)}-{seed}"
        n_versions = write_versions(
            recorded, objects, mode.versions, made_set.sensor, made_set.window_us, data_seed
        )
        options += ["--groups", GROUPS]
    if mode.epochs is not None:
        options += ["--epochs", str(max(1, round(mode.epochs / n_versions)))]
    return objects, options


def _in_simulated_motions(
    models: list[Path], folder: Path, n_images: int, *, nmnist: Path, mnist: Path
) -> list[float]:
    """The accuracy of each model over the windows of the simulated set *sim*."""
    simulated_set = make_set(
        "sim", mnist, folder, RealFolder(nmnist).read(), n_images, available_cores()
    )
    pipelines = [pipeline_of(load_model(path)) for path in models]
    is_right_by_model: list[list[np.ndarray]] = [[] for _ in models]
    for _, windows in simulated_windows(simulated_set):
        for pipeline, is_right in zip(pipelines, is_right_by_model, strict=True):
            is_right.append(class_probabilities(pipeline, windows).argmax(1) == windows.labels)
    return [float(np.concatenate(is_right).mean()) for is_right in is_right_by_model]


def _columns(rows: list[dict[str, float]]) -> dict[str, list[float]]:
    """Test -> its accuracy in each row."""
    return {test: [row[test] for row in rows] for test in rows[0]}


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("unseen_motions", __doc__, "one seed, few recordings and epochs")
    parser.add_argument("--set", choices=SETS, default="hands", help="default: hands")
    add_count(parser, "--seeds", 5, "data and networks")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="data and models (default: unseen_SET)"
    )
    add_folder(
        parser,
        "--nmnist",
        "with Train/<digit>/*.bin and Test, for saccades (default: $TNT_DATA/nmnist)",
    )
    add_folder(parser, "--mnist", "of its four files, for whole (default: $TNT_DATA/mnist)")
    args = parser.parse_args(argv)
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist") if args.set in OF_NMNIST else None
    mnist = data_folder(args.mnist, "mnist", "--mnist") if args.set == "whole" else None
    made_set = sets(nmnist, mnist)[args.set]
    with TemporaryDirectory() as name:
        if args.quick:
            small_set = replace(made_set, n_train=10, n_test=7)
            report = measure(small_set, 1, args.out or Path(name), ("--epochs", "3"))
        else:
            report = measure(made_set, args.seeds, args.out or Path(f"unseen_{args.set}"))
    write_outputs(args, report)
    print_tables(report, f"unseen_{args.set}")
    return 0


if __name__ == "__main__":
    exit_with(main)
