"""Windows of N-MNIST, one saccade each.

A window has all of its events, or a fifth of them. In a saccade of N-MNIST, a pixel with events has
five of them on average. In a recording of an object that a hand moves, it has about two. So windows
with a fifth of the events are like recordings of hand motion.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from async_tnt.sources.files.nmnist import read_nmnist
from experiments.digit_data.recordings import CLASSES, SACCADE_US

SENSOR = (34, 34)
"""N-MNIST's sensor, width and height in pixels."""

KEPT = 0.2
"""Share of the events that are kept."""


def write(
    folder: Path,
    n: int | None,
    saccades: tuple[int, ...],
    seed: int,
    source: Path,
    share: float = KEPT,
) -> Path:
    """Write windows of N-MNIST as `folder/<digit>/<number>.npz`.

    Parameters
    ----------
    n : number of recordings of each digit. Each of these recordings gives one window, and the
        windows take the `saccades` in turn. None: all recordings give a window of each of
        `saccades`.
    source : N-MNIST's Train or Test, with `<digit>/*.bin`.
    share : share of the events that is kept.
    """
    rng = np.random.default_rng(seed)
    for digit in CLASSES:
        files = sorted((source / digit).glob("*.bin"))
        if len(files) < (n or 1):
            raise ValueError(
                f"{source / digit} must hold at least {n or 1} recordings, got {len(files)}"
            )
        # The order is drawn even if all recordings are shown, because later random numbers depend
        # on it.
        file_order = rng.permutation(len(files))[:n]
        if n is None:
            windows = [(k, saccade) for saccade in saccades for k in range(len(files))]
        else:
            windows = [(k, saccades[i % len(saccades)]) for i, k in enumerate(file_order)]
        (folder / digit).mkdir(parents=True, exist_ok=True)
        for i, (k, saccade) in enumerate(windows):
            events = read_nmnist(files[k])
            t = events["t"] - saccade * SACCADE_US
            kept = (t >= 0) & (t < SACCADE_US) & (rng.random(len(t)) < share)
            np.savez(
                folder / digit / f"{i:03}.npz",
                t=t[kept],
                x=events["x"][kept],
                y=events["y"][kept],
                p=events["p"][kept],
            )
    return folder
