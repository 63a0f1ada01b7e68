"""A simulated set compared with N-MNIST.

The comparison has three columns of the same statistics:

1. real recordings of N-MNIST,
2. simulations of the images that they show, under N-MNIST's own saccades, which tell how good the
   simulator is,
3. recordings of the set, each image under three motions, which tell how the set's motions differ
   from N-MNIST's. These are the same images, if the set has them.
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
"""Times at which N-MNIST's saccades begin, and at which the third ends (Orchard et al. 2015)."""

OFFICIAL_TRAIN = 60_000
"""Number of recordings in N-MNIST's training set. Recordings with larger numbers are for tests."""


def compare(
    made: MovingMnist, mnist_folder: Path, nmnist_folder: Path | None
) -> dict[str, dict[str, float]]:
    """Title of a column -> its statistics by `describe_motions`. Shows a progress bar.

    Parameters
    ----------
    made : a set with all its shards.
    mnist_folder : MNIST, whose images the second column simulates.
    nmnist_folder : N-MNIST, with Train/<digit>/*.bin or Test/<digit>/*.bin. With None there is no
        real column, and the second column simulates images of the set.

    Raises
    ------
    ValueError : a file is damaged, or a recording's digit is not that of the image with its number.
    OSError : a folder is missing.
    """
    split = made.parameters["split"]
    of_set = made.parameters["images"]
    columns: dict[str, dict[str, float]] = {}
    directions = _nmnist_directions()
    if nmnist_folder is None:
        shown_split = split
        shown = _spread(of_set)
    else:
        shown_split, found = recordings_by_image(nmnist_folder, split)
        shown = _spread(sorted(found))
    images, labels = load_mnist(mnist_folder, shown_split)
    # an image counts once in each of the first two columns, and three times in the third
    n_steps = 4 if nmnist_folder is None else 5
    with progress(n_steps * len(shown), "comparing") as bar:
        if nmnist_folder is not None:
            for image in shown:
                if image >= len(labels) or labels[image] != int(found[image].parent.name):
                    raise ValueError(
                        f"{found[image]}: MNIST's {shown_split} image {image + 1}, which it should "
                        "show, is another digit"
                    )
            real = _counted((read_nmnist(found[image]) for image in shown), bar)
            columns["N-MNIST"] = describe_motions(real, SACCADE_CUTS_US, directions)
        simulated = (simulate_digit(images[i], np.random.default_rng((0, i))) for i in shown)
        columns["simulated"] = describe_motions(
            _counted(simulated, bar), SACCADE_CUTS_US, directions
        )
        same = [i for i in shown if i in set(of_set)] if shown_split == split else []
        described = same if len(same) >= len(shown) / 2 else _spread(of_set)
        columns["this set"] = _describe_set(made, described, bar, directions)
    return columns


def _describe_set(
    made: MovingMnist, images: list[int], bar: Any, nmnist_directions: list[float]
) -> dict[str, float]:
    """Statistics of the set by `describe_motions`.

    Each image is shown under three motions, or under the only motion of the set. All motions are
    shown equally often.
    """
    n_motions = len(made.motions)
    shown: set[tuple[int, int]] = set()
    for k, image in enumerate(images):
        for turn in range(3):
            motion = (k + turn * n_motions // 3) % n_motions
            shown.add((motion, image))
    pairs = sorted(shown)
    recordings = _counted(_recordings(made, pairs), bar)
    if made.motions[0].direction_deg is None:
        return describe_motions(recordings, SACCADE_CUTS_US, nmnist_directions)
    moving = [made.motions[motion] for motion, _ in pairs]
    directions = [float(motion.direction_deg or 0) for motion in moving]
    return describe_motions(recordings, (0, moving[0].duration_us), directions)


def describe_motions(
    recordings: Iterable[np.ndarray], cuts_us: Sequence[int], directions_deg: Sequence[float]
) -> dict[str, float]:
    """Statistics of all saccades by `describe`, and the mean way from OFF events to ON events.

    Parameters
    ----------
    recordings : structured arrays in order of time.
    cuts_us : times at which saccades begin, and at which the last one ends.
    directions_deg : direction of the motion in each saccade of a recording. If recordings have one
        saccade, the direction in each recording. 0 is to the right, 90 downwards. If the number
        along the motion is negative, ON events trail the motion.
    """
    saccades = [
        events[a:b]
        for events in recordings
        for a, b in pairwise(np.searchsorted(events["t"], cuts_us).tolist())
    ]
    offsets = []
    for saccade, direction in zip(saccades, itertools.cycle(directions_deg), strict=False):
        on = saccade[saccade["p"] == 1]
        off = saccade[saccade["p"] == 0]
        if len(on) and len(off):
            apart = complex(on["x"].mean() - off["x"].mean(), on["y"].mean() - off["y"].mean())
            # turned, so that the real part is along the motion
            offsets.append(apart * np.exp(-1j * np.radians(direction)))
    mean = np.mean(offsets) if offsets else complex(np.nan, np.nan)
    return {
        **describe(saccades, NMNIST_SENSOR),
        "ON - OFF centroid, along the motion": float(mean.real),
        "ON - OFF centroid, across the motion": float(mean.imag),
    }


def _recordings(made: MovingMnist, pairs: list[tuple[int, int]]) -> Iterator[np.ndarray]:
    """The recordings of pairs (index of a motion, index of an image)."""
    shard: Shard | None = None
    # pairs are sorted, so each shard is opened once
    for motion, image in pairs:
        path, place = made.locate(motion, image)
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
    found: dict[str, dict[int, Path]] = {"train": {}, "test": {}}
    for part in ("Train", "Test"):
        for path in (folder / part).glob("[0-9]/*.bin"):
            if not re.fullmatch(r"[0-9]{1,6}", path.stem) or int(path.stem) == 0:
                continue
            number = int(path.stem)
            if number > OFFICIAL_TRAIN:
                found["test"][number - OFFICIAL_TRAIN - 1] = path
            else:
                found[part.lower()][number - 1] = path
    for shown in (split, *found):
        if found[shown]:
            return shown, found[shown]
    raise FileNotFoundError(f"{folder}: no N-MNIST recordings; expected Train/<digit>/<number>.bin")


def _nmnist_directions() -> list[float]:
    """Direction of the displacement in each of N-MNIST's saccades, in degrees."""
    dx, dy = nmnist_saccades().position(np.array(SACCADE_CUTS_US))
    return [math.degrees(math.atan2(y, x)) for x, y in zip(np.diff(dx), np.diff(dy), strict=True)]


def _spread(items: list[int]) -> list[int]:
    """At most `N_RECORDINGS` of the items, evenly spread."""
    n = min(N_RECORDINGS, len(items))
    return [items[i * len(items) // n] for i in range(n)]


def _counted(recordings: Iterator[np.ndarray], bar: Any) -> Iterator[np.ndarray]:
    """The recordings as they are given. The progress bar moves after each recording."""
    for recording in recordings:
        yield recording
        bar.update()
