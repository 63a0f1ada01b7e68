"""A digit is taught to a network that was trained on the nine others, from a few recordings.

    python -m experiments.teaching [--nmnist N-MNIST] [--digits 4,6,...] [--out FOLDER]
                                   [--again | --fine | --settings] [--recordings 10,50]
                                   [--json FILE] [--quick]
    python -m experiments.teaching [--poker POKER-DVS] [--characters FOLDER] [--hands]
                                   [--out FOLDER] [--json FILE]

Each digit is left out in turn. `async-tnt train` with no option but the sensor's size trains on the
nine others, from Train. Then `Model.with_class` teaches the tenth from 1, 5, 10 or 50 recordings of
Train, five draws each. The networks, and what is taught to them, read Test once.

Three options measure something else instead. --again trains on the nine digits and the same
recordings (the first draw of --recordings), with no other option. --fine trains the network of nine
further on all of them: four epochs, a quarter of the learning rate, the new logit from zero
weights. --settings compares ridges, shares, margins and numbers of components on the recordings
that training held out of Train; Test is not read.

The second command does the same with other data sets, and trains on everything again with the
first draw of the most recordings:

poker       each suit of POKER-DVS, from 1, 5 or 10 recordings; the folder has pips_train and
            pips_test
characters  six of HOTS' characters, from the only recording of each that is not for the test; the
            folder is made by `examples/hots_characters.py`
hands       three of eight objects in made hand motion, from 1, 5 or 10 recordings

Finished trainings in --out are kept, and interrupted trainings resume. FILE keeps the entries of
other digits.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from async_tnt import Model, load_model, open_recording
from async_tnt.networks.layers.graph import CLASSIFIER
from async_tnt.training import dataset_data, fit, settings_for
from experiments.digit_data.small_sets import write_small_nmnist
from experiments.lessons.other_sets import OTHER_SETS, write_hands
from experiments.lessons.place import N_DRAWS, Place, files_of, link, train
from experiments.lessons.readings import (
    Part,
    chosen,
    logits_of,
    read_files,
    read_nothing,
    reader_of,
    sure_share,
)
from experiments.lessons.settings import setting_numbers
from experiments.scripts.options import (
    add_folder,
    data_folder,
    exit_with,
    print_tables,
    script_parser,
    write_part,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine

DIGITS = (4, 6, 2, 7, 3, 5, 9, 0, 8, 1)
"""The digits in the order in which they are left out: `default_rng(0).permutation(10)`."""

COMPARED = (10, 50)
"""Numbers of recordings with which networks are trained again."""

N_OF_NOTHING = 100
"""Windows of each kind that shows no digit."""


# -- the measurements ------------------------------------------------------------------------------


def taught_numbers(place: Place, name: str, n_nothing: int) -> dict[str, Any]:
    """The numbers of one digit: of the network of nine, and of what is taught to it."""
    path = train(place, name, {})
    model = load_model(path)
    reader = reader_of(model)
    order = [*model.classes, name]
    part = read_files(reader, {one: files_of(place.test / one) for one in order}, order)
    # a class with one recording has none that was held out
    sample = place.held_out(model.classes[0]) or place.learned(model.classes[0])
    nothing = read_nothing(reader, model, sample[:10], n_nothing)

    is_old = part.labels < len(model.classes)
    old = Part(chosen(part.readings, is_old), part.labels[is_old], part.recording[is_old])
    base = old.score(old.readings.logits.astype(np.float64), len(model.classes))
    base["sure_of_nothing"] = sure_share(nothing, nothing.logits.astype(np.float64))
    rows: dict[str, list[dict[str, float]]] = {}
    for k in place.per_class:
        rows[str(k)] = []
        for draw in range(N_DRAWS):
            events = [open_recording(file).read() for file in place.drawn(name, k, draw)]
            started = time.process_time()
            taught = model.with_class(name, events)
            seconds = time.process_time() - started
            assert taught.statistics is not None
            row = part.score(logits_of(part.readings, taught.statistics), len(model.classes))
            of_nothing = logits_of(nothing, taught.statistics)
            decided = of_nothing[nothing.is_end].argmax(1)
            entry = taught.record["taught"][name]
            rows[str(k)].append(
                {
                    **row,
                    "sure_of_nothing": sure_share(nothing, of_nothing),
                    "nothing_taken": float((decided == len(model.classes)).mean()),
                    "told": float(np.mean(list(entry["taken"].values()))),
                    "margin": entry["margin"],
                    "seconds": seconds,
                }
            )
    assert model.statistics is not None
    return {
        "digit": name,
        "base": base,
        "taught": rows,
        "streamed": _streamed(place, model, name),
        "statistics_bytes": model.statistics.n_bytes,
        "components": model.statistics.n_components,
        "layer": model.statistics.layer,
        "machine": machine("torch"),
    }


def _streamed(place: Place, model: Model, name: str) -> dict[str, Any]:
    """What `async-tnt evaluate` says of the first draw of ten recordings: the same model, streamed.

    It reads the same part of the data as the readings do, and shows that both agree.
    """
    events = [open_recording(file).read() for file in place.drawn(name, 10, 0)]
    path = model.with_class(name, events).save(place.out / f"taught{name}.safetensors")
    return _evaluated(path, place.test, name)


def _evaluated(model: Path, test: Path, name: str) -> dict[str, Any]:
    """The report of `async-tnt evaluate` in the words of `Part.score`."""
    report = command("evaluate", model, test, "--json")
    new = report["classes"].index(name)
    numbers = {}
    for key, suffix in (("window_confusion", ""), ("confusion", "_recordings")):
        table = np.array(report[key])
        right = np.diag(table)
        others = np.arange(len(table)) != new
        numbers[f"new{suffix}"] = float(right[new] / table[new].sum())
        numbers[f"old{suffix}"] = float(right[others].sum() / table[others].sum())
        numbers[f"mean{suffix}"] = float(np.mean(right / table.sum(1)))
    return {**numbers, "calibration_error": report["calibration_error"]}


def again_numbers(place: Place, name: str, k: int) -> dict[str, Any]:
    """The numbers of a network that is trained on everything, from nothing."""
    files = place.drawn(name, k, 0)
    started = time.monotonic()
    path = train(place, name, {name: files})
    seconds = time.monotonic() - started
    numbers = _evaluated(path, place.test, name)
    return {"digit": name, "k": k, **numbers, "seconds": seconds, "machine": machine("torch")}


def fine_numbers(place: Place, name: str, k: int) -> dict[str, Any]:
    """The numbers of the network of nine that is trained further on everything."""
    base = load_model(train(place, name, {}))
    files = place.drawn(name, k, 0)
    label = f"without{name}-{len(files)}"
    folder = place.out / label
    for other in base.classes:
        link(folder / other, place.train / other)
    for file in files:
        link(folder / name / file.name, file)
    started = time.monotonic()
    data = dataset_data(folder, base.config)
    settings = settings_for(
        data.config, len(data.training), epochs=4, learning_rate=1e-3, logarithm=False
    )
    start = with_empty_class(base, name, data.classes)
    fitted = fit(data, settings, place.out / "runs" / f"fine-{label}", start=start)
    path = fitted.model.save(place.out / f"fine-{label}.safetensors")
    seconds = time.monotonic() - started
    numbers = _evaluated(path, place.test, name)
    return {"digit": name, "k": k, **numbers, "seconds": seconds, "machine": machine("torch")}


def with_empty_class(model: Model, name: str, classes: Sequence[str]) -> Model:
    """A model with one more class, whose logit has no weights yet, and the mean bias.

    classes : all classes, in the order of the logits.
    """
    *_, last = model.network[CLASSIFIER]
    weight = model.weights[last["weights"]["weight"]]
    bias = model.weights[last["weights"]["bias"]]
    weights = dict(model.weights)
    rows = {one: (weight[k], bias[k]) for k, one in enumerate(model.classes)}
    rows[name] = (np.zeros_like(weight[0]), bias.mean())
    weights[last["weights"]["weight"]] = np.stack([rows[one][0] for one in classes])
    weights[last["weights"]["bias"]] = np.array([rows[one][1] for one in classes])
    return replace(model, weights=weights, classes=tuple(classes), statistics=None)


def main(argv: list[str] | None = None) -> int:
    """Train, teach and test, print the tables, and write the report."""
    parser = script_parser("teaching", __doc__, "a made set and one epoch")
    add_folder(parser, "--nmnist", "with Train/<digit>/*.bin and Test (default: $TNT_DATA/nmnist)")
    for name in ("poker", "characters"):
        add_folder(parser, f"--{name}", f"{OTHER_SETS[name].title}, instead of N-MNIST")
    parser.add_argument("--hands", action="store_true", help="made hands, instead of N-MNIST")
    parser.add_argument(
        "--digits",
        type=_digits,
        default=DIGITS,
        metavar="A,B,...",
        help=f"digits to leave out (default: {','.join(map(str, DIGITS))})",
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--again", action="store_true", help="train on everything again instead")
    instead.add_argument("--fine", action="store_true", help="train the network further instead")
    instead.add_argument("--settings", action="store_true", help="compare settings, without Test")
    parser.add_argument(
        "--recordings",
        type=_counts,
        default=COMPARED,
        metavar="A,B,...",
        help="numbers of recordings for --again and --fine (default: 10,50)",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("teaching"), metavar="FOLDER", help="models"
    )
    args = parser.parse_args(argv)
    if args.quick:
        with TemporaryDirectory() as name:
            nmnist = write_small_nmnist(Path(name) / "nmnist", n_train=10, first_number=1)
            options = ("--sensor", "34x34", "--epochs", "1")
            place = Place(nmnist / "Train", nmnist / "Test", Path(name) / "models", options)
            report = _measure(args, place, ["4"], 2)
    elif args.poker or args.characters or args.hands:
        report = _measure_others(args)
    else:
        nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
        place = Place(nmnist / "Train", nmnist / "Test", args.out, ("--sensor", "34x34"))
        report = _measure(args, place, [str(digit) for digit in args.digits], N_OF_NOTHING)
    print_tables(report, "teaching")
    return 0


def _measure(
    args: argparse.Namespace, place: Place, names: Sequence[str], n_nothing: int
) -> dict[str, Any]:
    """Measure what the options ask for. Each entry is written as soon as it is there."""
    place.out.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {}

    def add(key: str, numbers: dict[str, Any]) -> None:
        report[key] = numbers
        write_part(args, key, numbers)

    for name in names:
        if args.settings:
            add(f"settings {name}", setting_numbers(place, name))
        elif args.again or args.fine:
            for k in args.recordings:
                measure = again_numbers if args.again else fine_numbers
                add(f"{'again' if args.again else 'fine'} {name} {k}", measure(place, name, k))
        else:
            add(f"without {name}", taught_numbers(place, name, n_nothing))
    return report


def _measure_others(args: argparse.Namespace) -> dict[str, Any]:
    """Measure the sets that are asked for. They are small, so each is trained again at once."""
    folders = {"poker": args.poker, "characters": args.characters}
    if args.hands:
        folders["hands"] = args.out / "hands" / "data"
        write_hands(folders["hands"])
    report = {}
    for set_name, folder in folders.items():
        if folder is None:
            continue
        other_set = OTHER_SETS[set_name]
        place = other_set.place(folder, args.out / set_name)
        place.out.mkdir(parents=True, exist_ok=True)
        for name in other_set.left_out(place.classes):
            numbers = taught_numbers(place, name, N_OF_NOTHING)
            numbers["again"] = again_numbers(place, name, other_set.per_class[-1])
            numbers["title"] = other_set.title
            report[f"{set_name} {name}"] = numbers
            write_part(args, f"{set_name} {name}", numbers)
    return report


def _counts(text: str) -> tuple[int, ...]:
    """Read numbers that commas separate. This is an argparse type."""
    counts = tuple(int(word) for word in text.split(",") if word.isdigit())
    if not counts or min(counts) < 1:
        raise argparse.ArgumentTypeError(f"must be numbers such as 10,50, got {text!r}")
    return counts


def _digits(text: str) -> tuple[int, ...]:
    """Read digits that commas separate. This is an argparse type."""
    digits = tuple(int(word) for word in text.split(",") if word.isdigit())
    if not digits or any(digit > 9 for digit in digits):
        raise argparse.ArgumentTypeError(f"must be digits such as 4,6, got {text!r}")
    return digits


if __name__ == "__main__":
    exit_with(main)
