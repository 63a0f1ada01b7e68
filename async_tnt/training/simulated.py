"""Simulated recordings as additional training data."""

from __future__ import annotations

import os

import numpy as np

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import sample_recordings
from async_tnt.training.windows import Progress, Recordings, no_progress

FIRST_INDEX = 5_000
"""Images from here on. N-MNIST's recordings 1-1,000 show the first 1,000, some of which are held out for
validation; the bundled samples show images 2,000 to 2,100 (see `simulation.samples`)."""


def simulate_recordings(
    mnist_folder: str | os.PathLike[str], n: int, seed: int, *, progress: Progress = no_progress
) -> Recordings:
    """Simulate `n` recordings of different MNIST training images, drawn from index `FIRST_INDEX` on.

    Each has a random generator of its own, seeded by (seed, index of the image).

    Raises
    ------
    ValueError : more recordings than there are images, or damaged MNIST files.
    OSError : no such files.
    """
    images, labels = load_mnist(mnist_folder, "train")
    n_images = max(0, len(images) - FIRST_INDEX)
    if not 0 <= n <= n_images:
        raise ValueError(f"the number of simulated recordings must be in [0, {n_images}], got {n}")
    indices = FIRST_INDEX + np.random.default_rng(seed).permutation(n_images)[:n]
    events = (
        simulate_digit(images[i], np.random.default_rng((seed, int(i)))) for i in progress(indices, "simulating", n)
    )
    return Recordings.from_events(events, labels[indices], [f"simulated {i}" for i in indices])


def read_samples() -> Recordings:
    """The ten bundled sample recordings."""
    paths = sample_recordings()
    return Recordings.from_events(
        (read_nmnist(path) for path in paths.values()), list(paths), [path.name for path in paths.values()]
    )
