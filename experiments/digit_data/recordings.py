"""Recordings of digits, real ones of N-MNIST and simulated ones, and the windows of `digits`."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import TNTConfig
from async_tnt.base.progress import Bar
from async_tnt.sources.files.labelled_recordings import find_recordings
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.training.recordings import Recordings
from async_tnt.training.training_data import TrainingData
from async_tnt.training.windows import Windows, make_windows
from experiments.digit_data.mnist import load_mnist
from experiments.motions.simulated_digits import simulate_digit

CLASSES = tuple("0123456789")
"""The digits."""

SACCADE_US = 105_000
"""Duration of one of the three saccades of an N-MNIST recording, in microseconds."""

DURATION_US = 3 * SACCADE_US
"""Duration of an N-MNIST recording, in microseconds; its few later events are left out."""

FIRST_INDEX = 5_000
"""Index of the first MNIST image that is simulated. Earlier images are shown elsewhere: N-MNIST's
recordings 1 to 1,000, some of which are held out for validation, show the first 1,000 images, and
the bundled samples show images 2,000 to 2,100."""


def read_nmnist_folder(
    folder: str | os.PathLike[str],
    *,
    per_digit: int | None = None,
    progress: Callable[..., Bar] = Bar,
) -> Recordings:
    """Read a folder in N-MNIST's layout: `<digit>/<number>.bin`.

    Parameters
    ----------
    folder : the folder that holds the digits' folders, such as N-MNIST's Train.
    per_digit : read only the first `per_digit` recordings of each digit, by name.

    Raises
    ------
    ValueError : a damaged file, or no recordings at all.
    FileNotFoundError : no such folder.
    """
    recordings = []
    labels = []
    for digit, digit_recordings in find_recordings(folder).items():
        recordings += digit_recordings[:per_digit]
        labels += [int(digit)] * len(digit_recordings[:per_digit])
    events = []
    with progress(len(recordings), "reading") as bar:
        for recording in recordings:
            bar.update()
            events.append(read_nmnist(recording.path))
    return Recordings.from_events(events, labels, [recording.name for recording in recordings])


def simulate_recordings(
    mnist_folder: str | os.PathLike[str],
    n: int,
    seed: int,
    *,
    leave_out: Collection[int] = (),
    progress: Callable[..., Bar] = Bar,
) -> Recordings:
    """Simulate `n` recordings of different MNIST training images.

    The images are drawn from index `FIRST_INDEX` on. Each recording has its own random generator,
    seeded by (seed, index of the image).

    Parameters
    ----------
    leave_out : indices of images that are not drawn.

    Raises
    ------
    ValueError : more recordings than there are images, or damaged MNIST files.
    OSError : no such files.
    """
    images, labels = load_mnist(mnist_folder, "train")
    drawn = FIRST_INDEX + np.random.default_rng(seed).permutation(max(0, len(images) - FIRST_INDEX))
    drawn = drawn[~np.isin(drawn, list(leave_out))]
    if not 0 <= n <= len(drawn):
        raise ValueError(
            f"the number of simulated recordings must be in [0, {len(drawn)}], got {n}"
        )
    indices = drawn[:n]
    events = []
    with progress(n, "simulating") as bar:
        for i in indices:
            events.append(simulate_digit(images[i], np.random.default_rng((seed, int(i)))))
            bar.update()
    return Recordings.from_events(events, labels[indices], [f"simulated {i}" for i in indices])


def recording_numbers(names: Iterable[str]) -> list[int]:
    """The numbers in names of N-MNIST's recordings: `3/00001.bin` is number 1.

    Names without a number are left out.
    """
    stems = [Path(name).stem for name in names]
    return [int(stem) for stem in stems if stem.isdigit()]


def saccade(windows: Windows) -> np.ndarray:
    """The number of the saccade, 0, 1 or 2, in which each window of N-MNIST starts; shape (N,)."""
    return windows.start_us // SACCADE_US


def split_recordings(
    recordings: Recordings, fraction: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Hold out a share of each class's recordings, drawn at random.

    Recordings are held out whole, so the three saccades of one digit are never on both sides.

    Parameters
    ----------
    fraction : the share, rounded to whole recordings of each class.

    Returns
    -------
    train, held_out : int64 indices, increasing. With a fraction of 0, `held_out` is empty.
    """
    if not 0 <= fraction < 1:
        raise ValueError(f"`fraction` must be in [0, 1), got {fraction}")
    held_out = np.zeros(len(recordings), bool)
    for label in np.unique(recordings.labels):
        members = rng.permutation(np.flatnonzero(recordings.labels == label))
        held_out[members[: round(fraction * len(members))]] = True
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def digits_data(
    folder: Path,
    mnist: Path,
    config: TNTConfig,
    *,
    simulated: int,
    seed: int = 0,
    progress: Callable[..., Bar],
) -> TrainingData:
    """The data of `digits`: windows of N-MNIST's Train and Test, and of simulated recordings.

    A tenth of Train's recordings is held out. All simulated recordings are for training.

    Parameters
    ----------
    folder : folder of N-MNIST.
    mnist : folder of MNIST.
    simulated : how many of MNIST's images to simulate.
    seed : seed of the split and of the simulation.
    """
    recordings = read_nmnist_folder(folder / "Train", progress=progress)
    n_real = len(recordings)
    training_indices, held_out = split_recordings(recordings, 0.1, np.random.default_rng(seed))
    # Recording n shows the image with index n - 1. Images of held-out recordings are not simulated.
    held_out_images = [n - 1 for n in recording_numbers(recordings.names[i] for i in held_out)]
    recordings += simulate_recordings(
        mnist, simulated, seed, leave_out=held_out_images, progress=progress
    )
    training_indices = np.concatenate([training_indices, np.arange(n_real, len(recordings))])
    record = {
        "source": (
            "N-MNIST recordings (Train), held out by recording, and simulated ones of MNIST "
            "training images"
        ),
        "real_recordings": n_real - len(held_out),
        "simulated_recordings": simulated,
        "held_out_recordings": len(held_out),
    }
    testing = read_nmnist_folder(folder / "Test", progress=progress)

    cut = partial(make_windows, window_us=config.window_us, duration_us=DURATION_US)
    tests: dict[str, tuple[Windows, dict[str, Any]]] = {
        "test": (cut(testing), {}),
        "test_windows_from_first_event": (cut(testing, first_event=True), {}),
    }
    training = cut(recordings, which=training_indices)
    validation = cut(recordings, which=held_out)
    return TrainingData(config, CLASSES, training, validation, record, tests)
