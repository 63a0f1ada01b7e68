"""Simulated recordings of digits, as N-MNIST's camera would have made them; and the bundled samples."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from async_tnt.simulation.mnist import load_mnist
from async_tnt.simulation.scene import Scene, render
from async_tnt.simulation.simulator import PixelModel, simulate
from async_tnt.simulation.trajectories import Trajectory, nmnist_saccades
from async_tnt.sources.files.nmnist import write_nmnist

FIRST_SAMPLE = 2_000
"""Index of the first MNIST training image for samples: beyond those that N-MNIST's first recordings show."""


def simulate_digit(
    image: np.ndarray,
    rng: np.random.Generator,
    *,
    trajectory: Trajectory | None = None,
    scene: Scene | None = None,
    pixels: PixelModel | None = None,
    sensor: tuple[int, int] = (34, 34),
    frame_us: float = 1_000.0,
) -> np.ndarray:
    """Simulate one recording of an image that moves over the sensor.

    Parameters
    ----------
    image : shape (28, 28) for MNIST, or any other; uint8 in 0-255 or floating in [0, 1]; 0 is the background.
    rng : source of all randomness. The same state and arguments give the same events.
    trajectory : the motion; N-MNIST's three saccades, a little delayed at random, by default.
    scene : contrast, blur and polarity; `Scene()` by default: dark on bright, ON events trail.
    pixels : thresholds, mismatch, refractory time and noise; `PixelModel()` by default.
    sensor : (width, height) in pixels.
    frame_us : time between rendered frames; the light is interpolated linearly between them.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, sorted by (t, y, x); times from 0 to `trajectory.duration_us`.

    Raises
    ------
    ValueError : an argument out of its range.
    """
    trajectory = nmnist_saccades(rng) if trajectory is None else trajectory
    if not 0 < frame_us <= trajectory.duration_us:
        raise ValueError(f"`frame_us` must be in (0, {trajectory.duration_us}], the duration, got {frame_us}")
    n_frames = 1 + round(trajectory.duration_us / frame_us)
    times_us = np.linspace(0.0, trajectory.duration_us, n_frames)
    dx, dy = trajectory.position(times_us)
    return simulate(render(image, dx, dy, scene=scene, sensor=sensor), times_us, rng, pixels)


def sample_indices(labels: np.ndarray, first_index: int = FIRST_SAMPLE) -> dict[int, int]:
    """Digit -> index of its first image at `first_index` or later.

    Raises
    ------
    ValueError : a digit does not occur there.
    """
    indices = {}
    for digit in range(10):
        found = np.flatnonzero(labels[first_index:] == digit)
        if len(found) == 0:
            raise ValueError(f"no image of a {digit} from index {first_index} on, in {len(labels)} images")
        indices[digit] = first_index + int(found[0])
    return indices


def write_samples(mnist_folder: str | os.PathLike[str], out_folder: str | os.PathLike[str], seed: int) -> list[Path]:
    """Simulate and write `<out_folder>/<digit>.bin` for the ten digits; returns their paths.

    Each digit has its own random generator, seeded by (seed, digit). The bundled samples are those of seed 0:

        python -c 'from async_tnt.simulation import write_samples; write_samples("MNIST", "samples", seed=0)'

    Raises
    ------
    ValueError : damaged MNIST files.
    OSError : MNIST files missing, or the folder cannot be written.
    """
    images, labels = load_mnist(mnist_folder, "train")
    indices = sample_indices(labels)
    out_folder = Path(out_folder)
    out_folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for digit, index in indices.items():
        events = simulate_digit(images[index], np.random.default_rng((seed, digit)))
        paths.append(out_folder / f"{digit}.bin")
        write_nmnist(paths[-1], events)
    return paths
