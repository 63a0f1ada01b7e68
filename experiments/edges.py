"""How the events of real recordings depend on the direction of motion.

Edges along the motion should give no events, and a reversed motion should swap polarity.

    python -m experiments.edges --nmnist N-MNIST --mnist MNIST --json experiments/results/edges.json

A pixel follows log luminance L. For a pattern that moves with velocity v, dL/dt = -v . grad L. The
events of each saccade are moved back along N-MNIST's path, onto the image that was shown. The
gradient of this image is known. The report has:

- by the angle between gradient and motion, the number of events for each unit of gradient, and the
  share of events with the polarity of -v . grad L. The number should fall like the cosine;
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
"""Least gradient of an edge, in log luminance per pixel. A lower gradient is background."""

COMPARED = ("signed", "expected", "unsigned")
"""Images that are correlated between two saccades: the sums of the events' signs, the changes of
light that follow from the gradient, and the numbers of events."""

PATH = nmnist_saccades()
"""Path of the image in N-MNIST's recordings."""

ENDS_US = (0, 92_000, 222_000, 308_000)
"""Times at which the image is at rest; each of the three saccades lies between two of them."""


def directions() -> np.ndarray:
    """The unit vectors (x, y) of the three saccades, (3, 2)."""
    displacements = np.diff(np.stack(PATH.position(ENDS_US), axis=1), axis=0)
    return np.asarray(displacements / np.linalg.norm(displacements, axis=1, keepdims=True))


def moved_back(events: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sum of the events' signs and the number of events at each pixel, each (34, 34).

    Before they are added, events are moved back along N-MNIST's path, as if the image had stayed in
    the sensor's centre.
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
    split, recordings = recordings_by_image(nmnist, "train")
    images, _ = load_mnist(mnist, split)
    places = np.unique(np.linspace(0, len(recordings) - 1, n).astype(int))
    image_indices = np.array(sorted(recordings))[places]
    unit_vectors = directions()
    n_bins = len(ANGLES_DEG) - 1
    # sums over all edges, by the angle between gradient and motion
    event_sums, agreeing_sums, gradient_sums, cosine_sums = np.zeros((4, n_bins))
    correlations: dict[tuple[int, int], list[list[float]]] = {
        pair: [] for pair in combinations(range(3), 2)
    }
    with progress(len(image_indices), "comparing events with images") as bar:
        for i in image_indices:
            slope = gradient(images[i])
            steepness = np.linalg.norm(slope, axis=-1)
            is_edge = steepness > LEAST_GRADIENT
            saccade_images: dict[str, list[np.ndarray]] = {name: [] for name in COMPARED}
            recorded = read_nmnist(recordings[i])
            # the fourth part, which follows the three saccades, is left out
            saccades = np.split(recorded, np.searchsorted(recorded["t"], ENDS_US[1:]))
            for v, saccade in zip(unit_vectors, saccades, strict=False):
                sign, count = moved_back(saccade)
                change = -slope @ v
                # number of events whose sign is that of `change`
                agreeing = (count + sign * np.sign(change)) / 2
                cosine = np.abs(change[is_edge]) / steepness[is_edge]
                angle_deg = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
                bin_indices = np.digitize(angle_deg, ANGLES_DEG[1:-1])
                event_sums += np.bincount(bin_indices, count[is_edge], n_bins)
                agreeing_sums += np.bincount(bin_indices, agreeing[is_edge], n_bins)
                gradient_sums += np.bincount(bin_indices, steepness[is_edge], n_bins)
                cosine_sums += np.bincount(bin_indices, steepness[is_edge] * cosine, n_bins)
                saccade_images["signed"].append(sign.ravel())
                saccade_images["expected"].append(change.ravel())
                saccade_images["unsigned"].append(count.ravel())
            for (a, b), values in correlations.items():
                values.append(
                    [
                        float(np.corrcoef(image[a], image[b])[0, 1])
                        for image in saccade_images.values()
                    ]
                )
            bar.update()

    between = {}
    for (a, b), values in correlations.items():
        between[f"{a + 1}-{b + 1}"] = {
            "angle_deg": float(np.degrees(np.arccos(unit_vectors[a] @ unit_vectors[b]))),
            **dict(zip(COMPARED, np.mean(values, axis=0).tolist(), strict=True)),
        }
    return {
        "recordings": len(image_indices),
        "angles_deg": ANGLES_DEG,
        "events_per_gradient": (event_sums / gradient_sums).tolist(),
        "cosine": (cosine_sums / gradient_sums).tolist(),
        "polarity_as_expected": (agreeing_sums / event_sums).tolist(),
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

    def measure_report(quick: bool) -> dict[str, Any]:
        return measure(nmnist, mnist, 50 if quick else N_RECORDINGS)

    return run_script(parser, argv, measure_report, "edges")


if __name__ == "__main__":
    exit_with(main)
