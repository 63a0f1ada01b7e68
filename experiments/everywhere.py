"""Objects on a large sensor: how well a map model finds digits in scenes of several real recordings.

    python -m experiments.everywhere MODEL [MODEL ...] [--nmnist N-MNIST] [--part Test] [--scenes N] [--json FILE]
    python -m experiments.everywhere --write FOLDER [--nmnist N-MNIST] [--mnist MNIST]

The second makes what the bundled `digits-everywhere` is trained on by `async-tnt train FOLDER --everywhere`: N-MNIST's
Train, and 10,000 of MNIST's training images.

Three recordings of one saccade each (eight on 640x480) stand anywhere on a sensor of 128x96, in whole pixels, begin
within 50 ms of each other, and are streamed with uniform noise of .3 Hz a pixel. An object is found where one of its
class is named within 5 pixels of its middle, halfway between the 2nd and 98th percentile of its events (some noise is
farther out), the likeliest one first. Objects are apart by at least 30 pixels; in `close` by at least 16, where they
may cover each other by up to a third; in `overlapping` each is 16 to 24 from another one. Shares no code with
`train --everywhere`.

F1 at 105 ms after the first object's start, and after 30 ms of the *last* one; objects in noise alone, a window.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import EVENT_DTYPE, Model, Processor, load_model
from async_tnt.progress import progress
from async_tnt.sources.files.nmnist import read_nmnist
from experiments.bench_timing import machine
from experiments.drawn_pictures import write_mnist
from experiments.script_options import add_folder, data_folder, exit_with, script_parser, write_outputs

SENSOR, LARGE = (128, 96), (640, 480)
WINDOW_US, EARLY_US, STARTS_US = 105_000, 30_000, 50_000
NOISE_HZ, WITHIN_PX, SIDE = 0.3, 5.0, 34
N_PICTURES = 10_000
APART, CLOSE, OVERLAPPING = (30.0, np.inf), (16.0, np.inf), (16.0, 24.0)
Truth = list[tuple[str, float, float]]


def scene(
    files: list[Path], sensor: tuple[int, int], apart: tuple[float, float], rng: np.random.Generator
) -> tuple[np.ndarray, Truth, int]:
    """Events of these recordings in one scene, what stands where, and when the last one begins."""
    width, height = sensor
    middles: list[np.ndarray] = []
    while len(middles) < len(files):
        middle = rng.uniform(SIDE / 2, np.array(sensor) - SIDE / 2)
        distances = [float(np.hypot(*(middle - other))) for other in middles]
        nearest = min(distances, default=apart[0])
        if apart[0] <= nearest <= apart[1]:
            middles.append(middle)
    parts: list[np.ndarray] = []
    truth: Truth = []
    last_us = 0
    for path, middle in zip(files, middles, strict=True):
        events = read_nmnist(path)
        saccade = int(rng.integers(3)) * WINDOW_US
        events = events[(events["t"] >= saccade) & (events["t"] < saccade + WINDOW_US)]
        start_us = int(rng.integers(STARTS_US)) if parts else 0
        centre = np.array([np.quantile(events[a], (0.02, 0.98)).mean() for a in "xy"])
        shift = np.rint(middle - centre).astype(int)
        moved = np.zeros(len(events), events.dtype)
        moved["t"] = events["t"] - saccade + start_us
        moved["x"], moved["y"], moved["p"] = events["x"] + shift[0], events["y"] + shift[1], events["p"]
        parts.append(moved)
        truth.append((path.parent.name, *(centre + shift)))
        last_us = max(last_us, start_us)
    parts.append(noise(sensor, rng))
    events = np.concatenate(parts)
    events = events[(events["t"] < WINDOW_US) & (events["x"] < width) & (events["y"] < height)]
    return events[np.argsort(events["t"], kind="stable")], truth, last_us


def noise(sensor: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Uniform over pixels and a window."""
    n = rng.poisson(NOISE_HZ * sensor[0] * sensor[1] * WINDOW_US / 1e6)
    events = np.zeros(n, EVENT_DTYPE)
    events["t"] = np.sort(rng.integers(WINDOW_US, size=n))
    events["x"], events["y"] = rng.integers(sensor[0], size=n), rng.integers(sensor[1], size=n)
    events["p"] = rng.integers(2, size=n)
    return events


def counts(objects: Any, truth: Truth) -> np.ndarray:
    """Right, found, there."""
    left = list(truth)
    for found in objects:
        near = [one for one in left if one[0] == found.label]
        near.sort(key=lambda one: np.hypot(one[1] - found.x, one[2] - found.y))
        if near and np.hypot(near[0][1] - found.x, near[0][2] - found.y) <= WITHIN_PX:
            left.remove(near[0])
    return np.array([len(truth) - len(left), len(objects), len(truth)])


def measure(
    model: Model, files: list[Path], n_scenes: int, n_objects: int, apart: tuple[float, float], seed: int
) -> dict[str, float]:
    """F1 at the end and early, of scenes that hold each recording at most once, where there are enough."""
    rng = np.random.default_rng(seed)
    order = np.concatenate([rng.permutation(len(files)) for _ in range(-(-n_scenes * n_objects // len(files)))])
    sensor = model.config.sensor
    total, early = np.zeros(3), np.zeros(3)
    for k in range(n_scenes):
        some = [files[i] for i in order[k * n_objects : (k + 1) * n_objects]]
        events, truth, last_us = scene(some, sensor, apart, rng)
        processor = Processor(model, start_us=0)
        n_early = int(np.searchsorted(events["t"], last_us + EARLY_US))
        processor.push(events[:n_early])
        early += counts(processor.fire().objects, truth)
        processor.push(events[n_early:])
        total += counts(processor.fire().objects, truth)
    return {"end": float(2 * total[0] / total[1:].sum()), "early": float(2 * early[0] / early[1:].sum())}


def objects_in_noise(model: Model, n: int) -> float:
    """A window, in the mean."""
    rng, found = np.random.default_rng(0), 0
    for _ in range(n):
        processor = Processor(model, start_us=0)
        processor.push(noise(model.config.sensor, rng))
        found += len(processor.fire().objects or ())
    return found / n


def write_data(folder: Path, nmnist: Path, mnist: Path) -> None:
    """`folder/<digit>`: links to recordings, and pictures."""
    for path in (nmnist / "Train").glob("*/*.bin"):
        link = folder / path.parent.name / path.name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(path.resolve())
    write_mnist(folder, mnist, N_PICTURES)


def main(argv: list[str] | None = None) -> int:
    """Measure, print and write."""
    parser = script_parser("everywhere", __doc__, "ten scenes")
    parser.add_argument("models", nargs="*", metavar="MODEL", help="map models of ten digits")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="make the data of the bundled model there")
    add_folder(parser, "--nmnist", "with Train and Test/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    add_folder(parser, "--mnist", "with MNIST's IDX files (default: $TNT_DATA/mnist)")
    parser.add_argument("--part", default="Test", metavar="NAME", help="Test or Train (default: Test)")
    parser.add_argument("--scenes", type=int, default=330, metavar="N", help="of each kind (default: 330)")
    args: argparse.Namespace = parser.parse_args(argv)
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    if bool(args.models) == bool(args.write):
        parser.error("give models to test, or --write FOLDER")
    if args.write:
        write_data(args.write, nmnist, data_folder(args.mnist, "mnist", "--mnist"))
        return 0
    files = sorted((nmnist / args.part).glob("*/*.bin"))
    n = 10 if args.quick else args.scenes
    kinds = {"three": (SENSOR, 3, APART), "close": (SENSOR, 3, CLOSE), "overlapping": (SENSOR, 3, OVERLAPPING)}
    kinds["eight"] = LARGE, 8, APART
    rows = []
    with progress(len(args.models) * (len(kinds) + 1), "scenes") as bar:
        for name in args.models:
            model = load_model(name)
            row: dict[str, Any] = {}
            for kind, (sensor, n_objects, apart) in kinds.items():
                row[kind] = measure(model.for_sensor(sensor), files, n * 3 // n_objects, n_objects, apart, 0)
                bar.update()
            row["noise"] = objects_in_noise(model.for_sensor(SENSOR), n)
            bar.update()
            rows.append(row)
            print(name, row)
    write_outputs(args, {"part": args.part, "scenes": n, "models": rows, "machine": machine()})
    return 0


if __name__ == "__main__":
    exit_with(main)
