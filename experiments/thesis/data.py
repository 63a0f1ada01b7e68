"""The windows that the thesis' table trains and tests on: N-MNIST's, and simulated ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.training.windows import Windows, make_windows
from experiments.digit_data.mnist import load_mnist
from experiments.digit_data.recordings import (
    DURATION_US,
    SACCADE_US,
    read_nmnist_folder,
    recording_numbers,
    saccade,
    split_recordings,
)
from experiments.motions.scene import Scene
from experiments.moving_set.build import build
from experiments.moving_set.foreign_pixels import build_foreign
from experiments.moving_set.manifest import MovingMnist
from experiments.thesis.rows import SETS

OFFICIAL = (60_000, 10_000)
"""Numbers of recordings in N-MNIST's official Train and Test. Recording n of Train shows the image
with index n - 1 of MNIST's training set."""

VALIDATION_SEED = 0
"""Seed of the split. The same recordings are held out in every row and for every seed."""


@dataclass(frozen=True)
class RealData:
    """N-MNIST's recordings.

    Parameters
    ----------
    training, held_out : windows of the training recordings, all three saccades; split by recording.
    test : windows of the test recordings.
    seen_images : indices of MNIST's test images that a training recording shows, held out or not.
        Empty with the official split, see `shown_test_images`.
    description : description of the data in words and numbers, for the results.
    """

    training: Windows
    held_out: Windows
    test: Windows
    seen_images: np.ndarray
    description: dict[str, Any]


@dataclass(frozen=True)
class RealFolder:
    """The folder of N-MNIST, and the part of it that is used.

    Parameters
    ----------
    folder : the folder that has Train/<digit>/*.bin and Test/<digit>/*.bin.
    validation : share of the training recordings that is held out.
    per_digit : only the first `per_digit` recordings of each digit in each folder; None for all.
    """

    folder: Path
    validation: float = 0.1
    per_digit: int | None = None

    @lru_cache(maxsize=1)  # noqa: B019  (the class is frozen, and one folder is enough)
    def read(self) -> RealData:
        """Read both folders, once in a process.

        Raises
        ------
        FileNotFoundError : a folder is missing.
        ValueError : a damaged file; the message names it.
        """
        train = read_nmnist_folder(self.folder / "Train", per_digit=self.per_digit)
        test = read_nmnist_folder(self.folder / "Test", per_digit=self.per_digit)
        rng = np.random.default_rng(VALIDATION_SEED)
        training_indices, held_out = split_recordings(train, self.validation, rng)
        if (len(train), len(test)) == OFFICIAL:
            split = "the official one"
        else:
            split = "not the official one (60,000 and 10,000 recordings)"
        return RealData(
            make_windows(train, SACCADE_US, which=training_indices, duration_us=DURATION_US),
            make_windows(train, SACCADE_US, which=held_out, duration_us=DURATION_US),
            make_windows(test, SACCADE_US, duration_us=DURATION_US),
            shown_test_images(train.names),
            {
                "training_recordings": len(training_indices),
                "held_out_recordings": len(held_out),
                "test_recordings": len(test),
                "split": split,
            },
        )


def shown_test_images(names: Sequence[str]) -> np.ndarray:
    """The indices of MNIST's test images that recordings show, int64, increasing.

    The indices follow from the numbers in the recordings' names, such as `3/60026.bin`. Numbers up
    to 60,000 are of the official Train, and show images of MNIST's training set. Sets that are
    split differently number the official test recording n as 60,000 + n. It shows the image with
    index n - 1 of MNIST's test set.
    """
    numbers = np.array(recording_numbers(names), np.int64)
    test_numbers = numbers[(numbers > OFFICIAL[0]) & (numbers <= sum(OFFICIAL))]
    images: np.ndarray = np.unique(test_numbers) - OFFICIAL[0] - 1
    return images


def trained_on(windows: Windows, name: str) -> Windows:
    """The windows for a network that is trained on `name`.

    name : "all", all windows; or "1", those of the first saccade.
    """
    return windows[saccade(windows) == 0] if name == "1" else windows


def scaled(windows: Windows) -> Windows:
    """The windows in recordings of their own, with scaled times.

    The first event of a window is at 0, and its last event at the end of the window, as in the
    thesis.
    """
    # each begins with an empty part, because there may be no windows
    columns = {name: [np.empty(0, dtype)] for name, dtype in COLUMNS.items()}
    for i in range(len(windows)):
        t, *others = windows.events(i, SACCADE_US)
        if len(t):
            t = (t - t[0]) * (SACCADE_US - 1) // max(1, t[-1] - t[0])
        for name, values in zip(COLUMNS, (t, *others), strict=True):
            columns[name].append(values.astype(COLUMNS[name]))
    recordings = Recordings(
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        offsets=np.cumsum([len(part) for part in columns["t"]]),
        labels=windows.labels,
        names=tuple(windows.recordings.names[r] for r in windows.recording),
    )
    return Windows(recordings, np.arange(len(windows)), np.zeros(len(windows), np.int64))


def make_set(
    name: str, mnist: Path, folder: Path, data: RealData, n_images: int, workers: int
) -> MovingMnist:
    """A simulated set of `SETS`.

    It has the first `n_images` of MNIST's test images that no training recording shows.

    Raises
    ------
    ValueError : there are fewer than `n_images` such images.
    """
    kind, is_dark = SETS[name]
    which = unseen_images(mnist, data, n_images)
    scene = Scene(dark_on_bright=is_dark)
    return build(mnist, folder, kind=kind, which=which, scene=scene, workers=workers)


def make_foreign_set(
    v2e: Path, mnist: Path, folder: Path, data: RealData, n_images: int
) -> MovingMnist:
    """The set `FOREIGN`, of the same images and motions as "sim".

    v2e : a checkout of v2e.

    Raises
    ------
    FileNotFoundError : the checkout has no simulator.
    ValueError : as `make_set`.
    """
    kind, is_dark = SETS["sim"]
    which = unseen_images(mnist, data, n_images)
    scene = Scene(dark_on_bright=is_dark)
    return build_foreign(v2e, mnist, folder, which=which, kind=kind, scene=scene)


def unseen_images(mnist: Path, data: RealData, n_images: int) -> list[int]:
    """The indices of the first `n_images` of MNIST's test images that no training recording shows.

    Raises
    ------
    ValueError : there are fewer such images.
    """
    unseen = np.setdiff1d(np.arange(len(load_mnist(mnist, "test")[1])), data.seen_images)
    if len(unseen) < n_images:
        raise ValueError(
            f"{mnist}: {len(unseen)} test images are not shown by training recordings, not "
            f"{n_images}"
        )
    indices: list[int] = unseen[:n_images].tolist()
    return indices


def simulated_windows(simulated_set: MovingMnist) -> Iterator[tuple[str, Windows]]:
    """For each shard of a set, the name of its motion and its windows.

    The name of a recording is the index of its image.

    Raises
    ------
    ValueError : a shard is damaged.
    FileNotFoundError : a shard is missing.
    """
    for shard in simulated_set:
        columns = {name: getattr(shard, name).astype(dtype) for name, dtype in COLUMNS.items()}
        recordings = Recordings(
            **columns,
            offsets=shard.offsets.astype(np.int64),
            labels=shard.labels.astype(np.int64),
            names=tuple(map(str, shard.image)),
        )
        yield (
            shard.metadata["motion"]["name"],
            make_windows(recordings, SACCADE_US, duration_us=SACCADE_US),
        )
