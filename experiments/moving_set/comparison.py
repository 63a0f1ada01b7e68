"""A simulated set compared with N-MNIST.

The comparison has three columns of the same statistics:

1. real recordings of N-MNIST,
2. simulations of the images that these recordings show, under N-MNIST's own saccades. They tell
   how good the simulator is.
3. recordings of the set, each image under three motions. They tell how the set's motions differ
   from N-MNIST's. They show the same images if the set has them.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.resynthesis.calibration import describe
from async_tnt.sources.files.nmnist import read_nmnist
from experiments.digit_data.mnist import load_mnist
from experiments.motions.kinds import NMNIST_SENSOR
from experiments.motions.simulated_digits import simulate_digit
from experiments.motions.trajectories import nmnist_saccades
from experiments.moving_set.manifest import MovingMnist
from experiments.moving_set.shards import Shard, open_shard

N_RECORDINGS = 200
"""Largest number of recordings that are compared. They are spread evenly over the recordings that
show images of the set's split, or over all recordings if none does."""

SACCADE_CUTS_US = (0, 105_000, 210_000, 315_000)
"""Times at which N-MNIST's saccades begin, and the end of the third (Orchard et al. 2015)."""

OFFICIAL_TRAIN = 60_000
"""Number of recordings in N-MNIST's training set. Recordings with larger numbers are for tests."""


def compare(
    moving_set: MovingMnist, mnist_folder: Path, nmnist_folder: Path | None
) -> dict[str, dict[str, float]]:
    """Title of a column -> its statistics by `describe_motions`. Shows a progress bar.

    Parameters
    ----------
    moving_set : a set with all its shards.
    mnist_folder : MNIST, whose images the second column simulates.
    nmnist_folder : N-MNIST, with Train/<digit>/*.bin or Test/<digit>/*.bin. With None there is no
        real column, and the second column simulates images of the set.

    Raises
    ------
    ValueError : a file is damaged, or a recording's digit is not that of the image with its number.
    OSError : a folder is missing.
    """
    split = moving_set.parameters["split"]
    set_images = moving_set.parameters["images"]
    columns: dict[str, dict[str, float]] = {}
    directions = nmnist_directions()
    if nmnist_folder is None:
        shown_split = split
        shown_images = _spread(set_images)
    else:
        shown_split, recordings = recordings_by_image(nmnist_folder, split)
        shown_images = _spread(sorted(recordings))
    images, labels = load_mnist(mnist_folder, shown_split)
    # the bar counts an image once in each of the first two columns, and three times in the third
    n_steps = 4 if nmnist_folder is None else 5
    with progress(n_steps * len(shown_images), "comparing") as bar:
        if nmnist_folder is not None:
            for image in shown_images:
                if image >= len(labels) or labels[image] != int(recordings[image].parent.name):
                    raise ValueError(
                        f"{recordings[image]}: MNIST's {shown_split} image {image + 1}, which it "
                        "should show, is another digit"
                    )
            real = _counted((read_nmnist(recordings[image]) for image in shown_images), bar)
            columns["N-MNIST"] = describe_motions(real, SACCADE_CUTS_US, directions)
        simulated = (simulate_digit(images[i], np.random.default_rng((0, i))) for i in shown_images)
        columns["simulated"] = describe_motions(
            _counted(simulated, bar), SACCADE_CUTS_US, directions
        )
        shared_images = []
        if shown_split == split:
            shared_images = [i for i in shown_images if i in set(set_images)]
        # with too few shared images, the statistics of the set would be noisy
        described_images = shared_images
        if len(shared_images) < len(shown_images) / 2:
            described_images = _spread(set_images)
        columns["this set"] = _describe_set(moving_set, described_images, bar, directions)
    return columns


def _describe_set(
    moving_set: MovingMnist, images: list[int], bar: Any, saccade_directions: list[float]
) -> dict[str, float]:
    """Statistics of the set by `describe_motions`.

    Each image is shown under three motions, or under the only motion of the set. All motions are
    shown equally often.
    """
    n_motions = len(moving_set.motions)
    pairs_shown: set[tuple[int, int]] = set()
    for k, image in enumerate(images):
        for turn in range(3):
            motion = (k + turn * n_motions // 3) % n_motions
            pairs_shown.add((motion, image))
    pairs = sorted(pairs_shown)
    recordings = _counted(_recordings(moving_set, pairs), bar)
    if moving_set.motions[0].direction_deg is None:
        return describe_motions(recordings, SACCADE_CUTS_US, saccade_directions)
    shown_motions = [moving_set.motions[motion] for motion, _ in pairs]
    directions = [float(motion.direction_deg or 0) for motion in shown_motions]
    return describe_motions(recordings, (0, shown_motions[0].duration_us), directions)


def describe_motions(
    recordings: Iterable[np.ndarray], cuts_us: Sequence[int], directions_deg: Sequence[float]
) -> dict[str, float]:
    """Statistics of all saccades by `describe`, and the mean offset of ON events from OFF events.

    The offset of a saccade is the vector from the centroid of its OFF events to the centroid of its
    ON events. Its mean has a part along the motion and a part across the motion. If the part along
    the motion is negative, ON events trail the motion.

    Parameters
    ----------
    recordings : structured arrays in order of time.
    cuts_us : times at which saccades begin, and the time at which the last saccade ends.
    directions_deg : the direction of motion in each saccade of a recording, the same for all
        recordings. If recordings have one saccade, the direction of motion in each recording. 0 is
        to the right, 90 downwards.
    """
    saccades = [
        events[first:end]
        for events in recordings
        for first, end in pairwise(np.searchsorted(events["t"], cuts_us).tolist())
    ]
    offsets = []
    for saccade, direction in zip(saccades, itertools.cycle(directions_deg), strict=False):
        on = saccade[saccade["p"] == 1]
        off = saccade[saccade["p"] == 0]
        if len(on) and len(off):
            offset = complex(on["x"].mean() - off["x"].mean(), on["y"].mean() - off["y"].mean())
            # a complex number x + iy, turned so that its real part is along the motion
            offsets.append(offset * np.exp(-1j * np.radians(direction)))
    mean_offset = np.mean(offsets) if offsets else complex(np.nan, np.nan)
    return {
        **describe(saccades, NMNIST_SENSOR),
        "ON - OFF centroid, along the motion": float(mean_offset.real),
        "ON - OFF centroid, across the motion": float(mean_offset.imag),
    }


def _recordings(moving_set: MovingMnist, pairs: list[tuple[int, int]]) -> Iterator[np.ndarray]:
    """The recordings of pairs (index of a motion, index of an image)."""
    shard: Shard | None = None
    # pairs are sorted, so each shard is opened once
    for motion, image in pairs:
        path, place = moving_set.locate(motion, image)
        if shard is None or shard.path != path:
            shard = open_shard(path)
        yield shard.recording(place)


def recordings_by_image(folder: Path, split: str) -> tuple[str, dict[int, Path]]:
    """The split of MNIST that the recordings show, and index of an image -> its recording.

    The split is `split` if any recording shows an image of it. Recording n shows image n of the
    same official set, both counted from 1. If n is above 60,000, the recording shows image
    n - 60,000 of the test set.

    Raises
    ------
    FileNotFoundError : no recordings in the folder.
    """
    recordings: dict[str, dict[int, Path]] = {"train": {}, "test": {}}
    for part in ("Train", "Test"):
        for path in (folder / part).glob("[0-9]/*.bin"):
            if not re.fullmatch(r"[0-9]{1,6}", path.stem) or int(path.stem) == 0:
                continue
            number = int(path.stem)
            if number > OFFICIAL_TRAIN:
                recordings["test"][number - OFFICIAL_TRAIN - 1] = path
            else:
                recordings[part.lower()][number - 1] = path
    for shown_split in (split, *recordings):
        if recordings[shown_split]:
            return shown_split, recordings[shown_split]
    raise FileNotFoundError(f"{folder}: no N-MNIST recordings; expected Train/<digit>/<number>.bin")


def nmnist_directions() -> list[float]:
    """Direction of the displacement in each of N-MNIST's saccades, in degrees."""
    dx, dy = nmnist_saccades().position(np.array(SACCADE_CUTS_US))
    return [math.degrees(math.atan2(y, x)) for x, y in zip(np.diff(dx), np.diff(dy), strict=True)]


def _spread(items: list[int]) -> list[int]:
    """At most `N_RECORDINGS` of the items, evenly spread."""
    n = min(N_RECORDINGS, len(items))
    return [items[i * len(items) // n] for i in range(n)]


def _counted(recordings: Iterator[np.ndarray], bar: Any) -> Iterator[np.ndarray]:
    """The recordings, unchanged. The progress bar moves on after each recording."""
    for recording in recordings:
        yield recording
        bar.update()
