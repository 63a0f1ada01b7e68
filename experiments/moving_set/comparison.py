"""A simulated set compared with N-MNIST.

The same statistics are computed of real recordings, of their simulations, and of the set.

The second column simulates the images that the real recordings show, under N-MNIST's own saccades:
it shows how good the simulator is. The third shows how the set's motions differ from N-MNIST's,
with the same images, if the set has them, each under three of its motions.
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
"""Recordings to compare, spread evenly over those that show images of the set's split (over all if
none do)."""

SACCADE_CUTS_US = (0, 105_000, 210_000, 315_000)
"""Where N-MNIST's saccades begin, and where the third ends (Orchard et al. 2015)."""
OFFICIAL_TRAIN = 60_000
"""Recordings in N-MNIST's training set; larger numbers are test recordings."""


def compare(
    made: MovingMnist, mnist_folder: Path, nmnist_folder: Path | None
) -> dict[str, dict[str, float]]:
    """Descriptions by `describe_motions`: column title -> name -> value. Shows a progress bar.

    Parameters
    ----------
    made : a set with all its shards.
    mnist_folder : MNIST, to simulate the images of the second column.
    nmnist_folder : N-MNIST, with Train/<digit>/*.bin or Test/<digit>/*.bin; None omits the real
        column, and the second shows the set's first images.

    Raises
    ------
    ValueError : damaged files, or recordings whose digit is not that of the image with their
        number.
    OSError : missing folders.
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
    with progress((4 if nmnist_folder is None else 5) * len(shown), "comparing") as bar:
        if nmnist_folder is not None:
            for image in shown:
                if image >= len(labels) or labels[image] != int(found[image].parent.name):
                    raise ValueError(
                        f"{found[image]}: MNIST's {shown_split} image {image + 1}, which it should "
                        "show, "
                        "is another digit"
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
    """Each image under three motions (or the only one), all motions equally often."""
    n_motions = len(made.motions)
    pairs = sorted(
        {
            ((k + turn * n_motions // 3) % n_motions, image)
            for k, image in enumerate(images)
            for turn in range(3)
        }
    )
    recordings = _counted(_recordings(made, pairs), bar)
    if made.motions[0].direction_deg is None:
        return describe_motions(recordings, SACCADE_CUTS_US, nmnist_directions)
    moving = [made.motions[motion] for motion, _ in pairs]
    directions = [float(motion.direction_deg or 0) for motion in moving]
    return describe_motions(recordings, (0, moving[0].duration_us), directions)


def describe_motions(
    recordings: Iterable[np.ndarray], cuts_us: Sequence[int], directions_deg: Sequence[float]
) -> dict[str, float]:
    """`describe` over all saccades, and how far ON events are from OFF events, on average.

    Parameters
    ----------
    recordings : structured arrays in order of time.
    cuts_us : where saccades begin, and where the last one ends.
    directions_deg : direction of the motion in each saccade of a recording or, where recordings
        have one saccade, in each recording; 0 to the right, 90 downwards. ON events trail the
        motion where their centroid is behind that of the OFF events.
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
            offsets.append(apart * np.exp(-1j * np.radians(direction)))
    mean = np.mean(offsets) if offsets else complex(np.nan, np.nan)
    return {
        **describe(saccades, NMNIST_SENSOR),
        "ON - OFF centroid, along the motion": float(mean.real),
        "ON - OFF centroid, across the motion": float(mean.imag),
    }


def _recordings(made: MovingMnist, pairs: list[tuple[int, int]]) -> Iterator[np.ndarray]:
    shard: Shard | None = None
    # pairs are sorted, so each shard is opened once
    for motion, image in pairs:
        path, place = made.locate(motion, image)
        if shard is None or shard.path != path:
            shard = open_shard(path)
        yield shard.recording(place)


def recordings_by_image(folder: Path, split: str) -> tuple[str, dict[int, Path]]:
    """The split of MNIST that the recordings show, and the recordings by image index.

    The split is `split` if any recording shows it.

    Recording n shows image n, counted from 1, of the same official set. Recordings above 60,000
    show image n - 60,000 of the test set.

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
    for recording in recordings:
        yield recording
        bar.update()
