"""Would N-MNIST's official training recordings alone give the constants of the simulated pixels?

    python -m experiments.fit_pixels [--nmnist N-MNIST] [--mnist MNIST] [--recordings N]
                                     [--json FILE]

`Scene` and `PixelModel` have constants that were fitted to N-MNIST. The program of that fit was not
kept. This command compares constants with recordings again. It reads the official training
recordings with the lowest numbers, at most number 1,000, and no test recording. It simulates the
images that they show in N-MNIST's own motion: with the present constants, and with each of eight
constants divided and multiplied by 1.2. All simulations have the same random numbers.

The report has the same statistics for the recordings and for each simulation, and the deviation of
each simulation. The deviation is the mean, over the statistics, of |log(simulated / recorded)|.
So .05 means that the statistics differ by a twentieth. If the recordings alone would give the
present constants, no changed constant has a clearly smaller deviation. Not every constant shows:
events tell contrast only in units of the thresholds, so a higher contrast and higher thresholds
give nearly the same events.

The command changes no constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.resynthesis.calibration import side_by_side
from async_tnt.simulation.measured_pixels import measure_pixels
from async_tnt.simulation.simulator import PixelModel
from async_tnt.sources.files.nmnist import read_nmnist
from experiments.digit_data.mnist import load_mnist
from experiments.motions.kinds import NMNIST_SENSOR
from experiments.motions.scene import Scene
from experiments.motions.simulated_digits import simulate_digit
from experiments.moving_set.comparison import (
    SACCADE_CUTS_US,
    describe_motions,
    nmnist_directions,
)
from experiments.scripts.options import (
    add_count,
    add_folder,
    data_folder,
    exit_with,
    script_parser,
    write_outputs,
)
from experiments.speed.timing import machine

LAST = 1_000
"""Highest number of an official training recording that is read."""

FACTOR = 1.2
"""Factor by which a constant is made larger and smaller."""

SCENE = ("contrast", "gamma", "blur_px")
"""Constants of `Scene`."""

PIXELS = ("threshold_on", "threshold_off", "mismatch", "refractory_us", "noise_hz")
"""Constants of `PixelModel`."""

NOT_COMPARED = ("ON - OFF centroid, across the motion",)
"""Statistics that are about 0, so that their ratio says nothing."""


def training_recordings(nmnist: Path, n: int) -> dict[int, Path]:
    """The first `n` official training recordings at hand: number -> file.

    Numbers above `LAST` are left out. Test is not looked into.

    Raises
    ------
    FileNotFoundError : there are fewer recordings.
    """
    numbered = {
        int(path.stem): path
        for path in nmnist.glob("Train/[0-9]/*.bin")
        if path.stem.isdecimal() and 1 <= int(path.stem) <= LAST
    }
    if len(numbered) < n:
        raise FileNotFoundError(
            f"{nmnist}: expected at least {n:,} official training recordings with numbers up to "
            f"{LAST:,} in Train, got {len(numbered):,}"
        )
    return {number: numbered[number] for number in sorted(numbered)[:n]}


def statistics(recordings: Sequence[np.ndarray]) -> dict[str, float]:
    """Statistics of N-MNIST's recordings, or of simulated ones, by saccade."""
    numbers = describe_motions(recordings, SACCADE_CUTS_US, nmnist_directions())
    windows = []
    for events in recordings:
        for first, end in pairwise(np.searchsorted(events["t"], SACCADE_CUTS_US).tolist()):
            t, x, y, p = [np.ascontiguousarray(events[name][first:end]) for name in "txyp"]
            windows.append((t.astype(np.int64), x, y, p))
    pixels = measure_pixels(windows, NMNIST_SENSOR, SACCADE_CUTS_US[1])
    return {
        **numbers,
        "noise of quiet pixels [Hz]": pixels.noise_hz,
        "refractory time, upper bound [ms]": pixels.refractory_us * 1e-3,
        "ON / OFF threshold": pixels.step_on / pixels.step_off,
    }


def candidates() -> dict[str, tuple[Scene, PixelModel]]:
    """Name -> constants: the present ones, and each constant changed by `FACTOR`."""
    scene = Scene()
    pixels = PixelModel()
    constants = {"present": (scene, pixels)}
    for name in (*SCENE, *PIXELS):
        value = getattr(scene if name in SCENE else pixels, name)
        for factor in (1 / FACTOR, FACTOR):
            change: dict[str, Any] = {name: float(f"{value * factor:.3g}")}
            if name in SCENE:
                changed = replace(scene, **change), pixels
            else:
                changed = scene, replace(pixels, **change)
            constants[f"{name} {change[name]:g}"] = changed
    return constants


def deviation(simulated: dict[str, float], recorded: dict[str, float]) -> float:
    """The mean of |log(simulated / recorded)| over the statistics."""
    ratios = [simulated[name] / recorded[name] for name in recorded if name not in NOT_COMPARED]
    return float(np.mean(np.abs(np.log(ratios))))


def measure(nmnist: Path, mnist: Path, n: int) -> dict[str, Any]:
    """The report on the first `n` official training recordings."""
    files = training_recordings(nmnist, n)
    images, labels = load_mnist(mnist, "train")
    for number, path in files.items():
        if number > len(labels) or labels[number - 1] != int(path.parent.name):
            raise ValueError(
                f"{path}: MNIST's training image {number}, which it should show, is another digit"
            )
    constants = candidates()
    with progress(len(files) * (1 + len(constants)), "comparing") as bar:
        recordings = []
        for path in files.values():
            recordings.append(read_nmnist(path))
            bar.update()
        recorded = statistics(recordings)
        columns = {}
        for name, (scene, pixels) in constants.items():
            simulated = []
            for number in files:
                # the same random numbers for all candidates
                rng = np.random.default_rng((0, number))
                simulated.append(
                    simulate_digit(images[number - 1], rng, scene=scene, pixels=pixels)
                )
                bar.update()
            columns[name] = statistics(simulated)
    return {
        "official_training_recordings": [min(files), max(files), len(files)],
        "recorded": recorded,
        "simulated": columns,
        "deviations": {name: deviation(column, recorded) for name, column in columns.items()},
        "machine": machine(),
    }


def lines_of(report: dict[str, Any]) -> list[str]:
    """The report as lines of text."""
    first, last, n = report["official_training_recordings"]
    columns = {"recorded": report["recorded"], "present": report["simulated"]["present"]}
    lines = [
        f"{n:,} official training recordings, numbers {first} to {last}; no test recording was "
        "read",
        "",
        *side_by_side(columns).splitlines(),
        "",
        "deviation  constants",
    ]
    ranked = sorted(report["deviations"].items(), key=lambda item: item[1])
    lines += [f"{value:9.4f}  {name}" for name, value in ranked]
    return lines


def main(argv: list[str] | None = None) -> int:
    """Measure the report, write it, and print it."""
    parser = script_parser("fit_pixels", __doc__, "20 recordings")
    add_folder(parser, "--nmnist", "with Train/<digit>/<number>.bin (default: $TNT_DATA/nmnist)")
    add_folder(parser, "--mnist", "MNIST's IDX files (default: $TNT_DATA/mnist)")
    add_count(parser, "--recordings", LAST, f"official training recordings, at most {LAST:,}")
    args = parser.parse_args(argv)
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    mnist = data_folder(args.mnist, "mnist", "--mnist")
    report = measure(nmnist, mnist, 20 if args.quick else args.recordings)
    write_outputs(args, report)
    print(*lines_of(report), sep="\n")
    return 0


if __name__ == "__main__":
    exit_with(main)
