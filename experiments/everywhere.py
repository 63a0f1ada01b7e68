"""How well a map model finds objects on a large sensor, in scenes of several real recordings.

    python -m experiments.everywhere MODEL [MODEL ...] [--nmnist N-MNIST] [--part Test] [--scenes N]
                                     [--json FILE]
    python -m experiments.everywhere --write FOLDER [--nmnist N-MNIST] [--mnist MNIST]

The second command writes the training data of the bundled `digits-everywhere`: N-MNIST's Train, and
10,000 of MNIST's training images. The model is then made by

    async-tnt train FOLDER --everywhere --sensor 34x34 --size 0.5-0.7 --window-us 105000
        --volume representation=volume,bins=2,polarity=split,transform=none --epochs 34

A scene has three recordings of one saccade each on a sensor of 128x96 pixels, or eight on 640x480.
The recordings stand anywhere, moved by whole pixels. They begin within 50 ms of each other, and are
streamed with uniform noise of .3 Hz a pixel. Objects are at least 30 pixels apart. In the scenes
`close` they are at least 16 pixels apart, and may cover each other by up to a third. In the scenes
`overlapping` each object is 16 to 24 pixels from another one.

An object is found if the model names its class within 5 pixels of its middle. The middle of an
object is halfway between the 2nd and the 98th percentile of its events, since some noise is farther
out. Found objects are compared with the scene in order of their probability, the likeliest first.

The report has the F1 score at 105 ms after the start of the first object, and at 30 ms after the
start of the *last* one. It also has the number of objects that are found in a window of noise.

Of a model that says sizes, the report also has COCO's mean average precision at the end, over
overlaps of .5 to .95, of .5 and of .75. The box of an object reaches from the 2nd to the 98th
percentile of its events.

The scenes share no code with `train --everywhere`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from async_tnt import Model, Processor, load_model
from async_tnt.base.progress import progress
from async_tnt.evaluation.box_scores import FoundBoxes
from async_tnt.evaluation.object_tables import ObjectTable
from async_tnt.kernels.decisions.objects import FOUND_SIZE
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.volume.events import structured
from experiments.pictures.symbols import write_mnist
from experiments.scripts.options import (
    add_count,
    add_folder,
    data_folder,
    exit_with,
    script_parser,
    write_outputs,
)
from experiments.speed.moments import made_columns, on_sensor
from experiments.speed.timing import machine

EARLY_US = 30_000
"""Time after the start of the last object at which an early decision is asked for."""

LATEST_START_US = 50_000
"""Time within which all objects of a scene begin."""

NOISE_HZ = 0.3
"""Events of noise a second, of each pixel."""

N_PICTURES = 10_000
"""Training images of MNIST that --write adds."""

SIDE = 34
"""Side of a recording, in pixels. Middles are at least half a side away from the border."""

WITHIN = 5.0
"""Largest distance, in pixels, at which an object counts as found."""

WINDOW_US = 105_000
"""Length of a window, in microseconds."""

Truth = list[tuple[str, float, float, float, float]]
"""Class, middle (x, y), and width and height of the box, in pixels, of each object of a scene."""


class Kind(NamedTuple):
    """A kind of scenes."""

    sensor: tuple[int, int] = (128, 96)
    """Width and height in pixels."""
    n_objects: int = 3
    """Objects in a scene."""
    apart: tuple[float, float] = (30.0, np.inf)
    """Least and largest distance, in pixels, from an object's middle to the nearest middle among
    the objects that were placed before."""


DIGITS = {
    "three": Kind(),
    "close": Kind(apart=(16.0, np.inf)),
    "overlapping": Kind(apart=(16.0, 24.0)),
    "eight": Kind(sensor=(640, 480), n_objects=8),
}
"""Name -> a kind of scenes of N-MNIST's digits."""


def one_window(path: Path, rng: np.random.Generator) -> np.ndarray:
    """The events of one random saccade of a recording, from 0 us on."""
    events = read_nmnist(path)
    first_us = int(rng.integers(3)) * WINDOW_US
    events = events[(events["t"] >= first_us) & (events["t"] < first_us + WINDOW_US)]
    events["t"] -= first_us
    return events


def scene(files: list[Path], kind: Kind, rng: np.random.Generator) -> tuple[np.ndarray, Truth, int]:
    """The events of a scene of recordings, its objects, and the last start in microseconds."""
    sensor = np.array(kind.sensor)
    middles: list[np.ndarray] = []
    while len(middles) < len(files):
        middle = rng.uniform(SIDE / 2, sensor - SIDE / 2)
        distances = [float(np.hypot(*(middle - other))) for other in middles]
        nearest = min(distances, default=kind.apart[0])
        if kind.apart[0] <= nearest <= kind.apart[1]:
            middles.append(middle)
    parts: list[np.ndarray] = []
    truth: Truth = []
    last_start_us = 0
    for path, middle in zip(files, middles, strict=True):
        events = one_window(path, rng)
        # the first object starts at 0
        start_us = int(rng.integers(LATEST_START_US)) if parts else 0
        sides = np.array([np.quantile(events[axis], (0.02, 0.98)) for axis in "xy"])
        centre = sides.mean(axis=1)
        shift = np.rint(middle - centre).astype(int)
        t = events["t"] + start_us
        x = events["x"] + shift[0]
        y = events["y"] + shift[1]
        parts.append(on_sensor(t, x, y, events["p"], kind.sensor))
        size = sides[:, 1] - sides[:, 0] + 1
        truth.append((path.parent.name, *(centre + shift), *size))
        last_start_us = max(last_start_us, start_us)
    parts.append(noise(kind, rng))
    events = np.concatenate(parts)
    events = events[events["t"] < WINDOW_US]
    return events[np.argsort(events["t"], kind="stable")], truth, last_start_us


def noise(kind: Kind, rng: np.random.Generator) -> np.ndarray:
    """Events of noise, uniform over pixels and a window."""
    n = rng.poisson(NOISE_HZ * kind.sensor[0] * kind.sensor[1] * WINDOW_US / 1e6)
    return structured(made_columns(rng, kind.sensor, n, WINDOW_US))


def counts(objects: Any, truth: Truth) -> np.ndarray:
    """Three numbers of objects: found objects that are right, found objects, objects in the scene.

    A found object is right if an object of its class in the scene is at most `WITHIN` pixels away.
    Each object in the scene makes at most one found object right.
    """
    not_found = list(truth)
    for found_object in objects:
        distances = {}
        for true_object in not_found:
            label, x, y, *_ = true_object
            if label == found_object.label:
                distances[true_object] = float(np.hypot(x - found_object.x, y - found_object.y))
        nearest = min(distances, key=lambda true_object: distances[true_object], default=None)
        if nearest is not None and distances[nearest] <= WITHIN:
            not_found.remove(nearest)
    return np.array([len(truth) - len(not_found), len(objects), len(truth)])


def measure(
    model: Model, files: list[Path], n_objects: int, kind: Kind, seed: int = 0
) -> dict[str, float]:
    """The F1 score at the end of the scenes, and early in them.

    All scenes together have `n_objects` objects. No recording is shown again before all recordings
    have been shown.
    """
    rng = np.random.default_rng(seed)
    n_scenes = n_objects // kind.n_objects
    n_rounds = -(-n_objects // len(files))  # rounded up
    order = np.concatenate([rng.permutation(len(files)) for _ in range(n_rounds)])
    processor = Processor(model.for_sensor(kind.sensor), start_us=0)
    boxes = FoundBoxes()
    end_counts = np.zeros(3)
    early_counts = np.zeros(3)
    for indices in order[: n_scenes * kind.n_objects].reshape(n_scenes, -1):
        events, truth, last_us = scene([files[i] for i in indices], kind, rng)
        processor.reset()
        n_early = int(np.searchsorted(events["t"], last_us + EARLY_US))
        processor.push(events[:n_early])
        early_counts += counts(processor.fire().objects, truth)
        processor.push(events[n_early:])
        objects = processor.fire().objects
        end_counts += counts(objects, truth)
        if model.has_sizes:
            add_boxes(boxes, objects, truth, model.classes)
    # F1 = 2 n_right / (n_found + n_in_scene), the three numbers of `counts`
    row = {
        "end": float(2 * end_counts[0] / end_counts[1:].sum()),
        "early": float(2 * early_counts[0] / early_counts[1:].sum()),
    }
    if model.has_sizes:
        scores = boxes.scores(model.classes)
        row |= {name: float(scores[name] or 0.0) for name in ("map", "map_50", "map_75")}
    return row


def add_boxes(boxes: FoundBoxes, objects: Any, truth: Truth, classes: Sequence[str]) -> None:
    """Add the boxes of a scene, and those that were found, at its end."""
    numbers = np.array([true_object[1:] for true_object in truth], float).reshape(-1, 4)
    table = ObjectTable(
        t=np.full(len(truth), WINDOW_US),
        label=np.array([classes.index(true_object[0]) for true_object in truth], np.int64),
        middle=numbers[:, :2],
        reach=numbers[:, 2:] / 2,
        size=numbers[:, 2:],
        unknown={},
    )
    found = [
        (one.x, one.y, one.probability, one.index, one.id, one.width, one.height) for one in objects
    ]
    boxes.add(table, slice(None), np.array(found, float).reshape(-1, FOUND_SIZE))


def objects_in_noise(model: Model, kind: Kind, n: int) -> float:
    """The number of objects that are found in a window of noise, as a mean over `n` windows."""
    rng = np.random.default_rng(0)
    n_found = 0
    processor = Processor(model.for_sensor(kind.sensor), start_us=0)
    for _ in range(n):
        processor.reset()
        processor.push(noise(kind, rng))
        n_found += counts(processor.fire().objects, [])[1]
    return float(n_found / n)


def write_data(folder: Path, nmnist: Path, mnist: Path) -> None:
    """Write the training data of `digits-everywhere`.

    Each digit has a folder, with links to its recordings in N-MNIST and with pictures of MNIST.
    """
    for path in (nmnist / "Train").glob("*/*.bin"):
        link = folder / path.parent.name / path.name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(path.resolve())
    write_mnist(folder, mnist, N_PICTURES)


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("everywhere", __doc__, "ten scenes")
    parser.add_argument("models", nargs="*", metavar="MODEL", help="map models of ten digits")
    parser.add_argument(
        "--write", type=Path, metavar="FOLDER", help="make the data of the bundled model there"
    )
    add_folder(parser, "--nmnist", "with Train and Test/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    add_folder(parser, "--mnist", "with MNIST's IDX files (default: $TNT_DATA/mnist)")
    parser.add_argument(
        "--part", choices=("Test", "Train"), default="Test", help="of N-MNIST (default: Test)"
    )
    add_count(parser, "--scenes", 330, "of three objects each; of other kinds as many objects")
    args = parser.parse_args(argv)
    if bool(args.models) == bool(args.write):
        parser.error("give models to test, or --write FOLDER")
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    if args.write:
        write_data(args.write, nmnist, data_folder(args.mnist, "mnist", "--mnist"))
        return 0
    part = nmnist / args.part
    files = sorted(part.glob("*/*.bin"))
    if not files:
        parser.error(f"{part} has no recordings DIGIT/NAME.bin")
    n = 10 if args.quick else args.scenes
    rows = []
    with progress(len(args.models) * (len(DIGITS) + 1), "scenes") as bar:
        for name in args.models:
            model = load_model(name)
            row: dict[str, Any] = {}
            for kind_name, kind in DIGITS.items():
                # each kind has as many objects as `n` scenes of three
                row[kind_name] = measure(model, files, 3 * n, kind)
                bar.update()
            row["noise"] = objects_in_noise(model, DIGITS["three"], n)
            bar.update()
            rows.append(row)
            print(name, row)
    write_outputs(args, {"part": part.name, "scenes": n, "models": rows, "machine": machine()})
    return 0


if __name__ == "__main__":
    exit_with(main)
