"""How the events of real recordings depend on the direction of motion.

Edges along the motion should give no events, and a reversed motion should swap polarity.

    python -m experiments.edges --nmnist N-MNIST --mnist MNIST --json experiments/results/edges.json

A pixel follows log luminance L. For a pattern that moves with velocity v, dL/dt = -v . grad L. The
events of each saccade are moved back along N-MNIST's path, onto the image that was shown. The
gradient of this image is known. The report has:

- by the angle between gradient and motion, the number of events for each unit of gradient, which
  should fall like the cosine, and the share of events with the polarity of -v . grad L;
- between two saccades, the correlation over pixels of the images of signed events, of the images of
  -v . grad L, and of the images of unsigned events.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.sources.files.nmnist import read_nmnist
from experiments.digit_data.mnist import load_mnist
from experiments.motions.scene import render
from experiments.motions.trajectories import nmnist_saccades
from experiments.moving_set.comparison import recordings_by_image
from experiments.scripts.options import (
    add_folder,
    data_folder,
    exit_with,
    run_script,
    script_parser,
)
from experiments.speed.timing import machine

N_RECORDINGS = 1_000
"""Number of recordings that are compared with their images."""

ANGLES_DEG = (0, 15, 30, 45, 60, 75, 90)
"""Limits of the bins of the angle between gradient and motion."""

LEAST_GRADIENT = 0.1
"""Least gradient of an edge, in log luminance per pixel; less is background."""

COMPARED = ("signed", "expected", "unsigned")
"""Images that are correlated between two saccades: the sum of the events' signs, the change of
light that the gradient lets expect, and the number of events."""

PATH = nmnist_saccades()
"""Path of the image in N-MNIST's recordings."""

ENDS_US = (0, 92_000, 222_000, 308_000)
"""Times at which the image is at rest; each of the three saccades lies between two of them."""


def directions() -> np.ndarray:
    """The unit vectors (x, y) of the three saccades, (3, 2)."""
    moved = np.diff(np.stack(PATH.position(ENDS_US), axis=1), axis=0)
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def moved_back(events: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sum of the events' signs and the number of events at each pixel, each (34, 34).

    Events are first moved back along N-MNIST's path, as if the image had stayed in the sensor's
    centre.
    """
    dx, dy = PATH.position(events["t"])
    # (3, 3) centres a 28 x 28 image on a 34 x 34 sensor
    x = np.rint(events["x"] - dx + 3.0).astype(int)
    y = np.rint(events["y"] - dy + 3.0).astype(int)
    inside = (x >= 0) & (x < 34) & (y >= 0) & (y < 34)
    place = (34 * y + x)[inside]
    sign = 2.0 * events["p"][inside] - 1.0
    signed = np.bincount(place, sign, minlength=34 * 34)
    unsigned = np.bincount(place, minlength=34 * 34).astype(np.float64)
    return signed.reshape(34, 34), unsigned.reshape(34, 34)


def gradient(image: np.ndarray) -> np.ndarray:
    """The gradient (d/dx, d/dy) of an image's log luminance, (34, 34, 2).

    The image is in the sensor's centre.
    """
    light = render(image, np.array([3.0]), np.array([3.0]))[0]
    return np.stack(np.gradient(light)[::-1], axis=-1)


def measure(nmnist: Path, mnist: Path, n: int) -> dict[str, Any]:
    """The report on `n` recordings, spread evenly over all recordings."""
    split, found = recordings_by_image(nmnist, "train")
    images, _ = load_mnist(mnist, split)
    shown = np.array(sorted(found))[np.unique(np.linspace(0, len(found) - 1, n).astype(int))]
    towards = directions()
    bins = len(ANGLES_DEG) - 1
    events_of, right_of, gradient_of, cosine_of = np.zeros((4, bins))
    correlations: dict[tuple[int, int], list[list[float]]] = {
        pair: [] for pair in combinations(range(3), 2)
    }
    with progress(len(shown), "comparing events with images") as bar:
        for i in shown:
            slope = gradient(images[i])
            steepness = np.linalg.norm(slope, axis=-1)
            edges = steepness > LEAST_GRADIENT
            images_of: dict[str, list[np.ndarray]] = {name: [] for name in COMPARED}
            recorded = read_nmnist(found[i])
            # the fourth part, which follows the three saccades, is left out
            saccades = np.split(recorded, np.searchsorted(recorded["t"], ENDS_US[1:]))
            for v, saccade in zip(towards, saccades, strict=False):
                sign, count = moved_back(saccade)
                change = -slope @ v
                # number of events whose sign is that of `change`
                agreeing = (count + sign * np.sign(change)) / 2
                cosine = np.abs(change[edges]) / steepness[edges]
                angle_deg = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
                bin_of = np.digitize(angle_deg, ANGLES_DEG[1:-1])
                events_of += np.bincount(bin_of, count[edges], bins)
                right_of += np.bincount(bin_of, agreeing[edges], bins)
                gradient_of += np.bincount(bin_of, steepness[edges], bins)
                cosine_of += np.bincount(bin_of, steepness[edges] * cosine, bins)
                images_of["signed"].append(sign.ravel())
                images_of["expected"].append(change.ravel())
                images_of["unsigned"].append(count.ravel())
            for (a, b), values in correlations.items():
                values.append(
                    [float(np.corrcoef(image[a], image[b])[0, 1]) for image in images_of.values()]
                )
            bar.update()

    between = {}
    for (a, b), values in correlations.items():
        between[f"{a + 1}-{b + 1}"] = {
            "angle_deg": float(np.degrees(np.arccos(towards[a] @ towards[b]))),
            **dict(zip(COMPARED, np.mean(values, axis=0).tolist(), strict=True)),
        }
    return {
        "recordings": len(shown),
        "angles_deg": ANGLES_DEG,
        "events_per_gradient": (events_of / gradient_of).tolist(),
        "cosine": (cosine_of / gradient_of).tolist(),
        "polarity_as_expected": (right_of / events_of).tolist(),
        "between_saccades": between,
        "machine": machine(),
    }


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("edges", __doc__, "50 recordings")
    add_folder(parser, "--nmnist", "with Train/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    add_folder(parser, "--mnist", "MNIST's IDX files (default: $TNT_DATA/mnist)")
    args = parser.parse_args(argv)
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    mnist = data_folder(args.mnist, "mnist", "--mnist")

    def measured(quick: bool) -> dict[str, Any]:
        return measure(nmnist, mnist, 50 if quick else N_RECORDINGS)

    return run_script(parser, argv, measured, "edges")


if __name__ == "__main__":
    exit_with(main)
