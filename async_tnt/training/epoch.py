"""An epoch: in which order it shows the windows, in batches, and how each is changed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.training.augment import Draws
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows


def batches_of(
    config: TNTConfig, windows: Windows, settings: TrainSettings, epoch: int
) -> Iterator[tuple[Windows, Draws | None]]:
    rng = np.random.default_rng((settings.seed, epoch))
    order = balanced_order(windows.labels, rng) if settings.balance else rng.permutation(len(windows))
    for first in range(0, len(order), settings.batch):
        some = windows[order[first : first + settings.batch]]
        augmentation = settings.augmentation
        yield some, None if augmentation is None else augmentation.draw(len(some), config, rng)


def balanced_order(labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As many places as there are labels, every class equally often (to one place), in random order.

    A class with fewer windows than its share is gone through again and again, each time in another order; of one with
    more, each epoch shows others. We sample rather than weigh the loss: a rare class in every batch gives steadier
    steps than one that comes seldom with a large weight, and augmentation makes every showing of a window another.

    Examples
    --------
    >>> labels = np.array([0, 0, 0, 0, 0, 0, 0, 1])
    >>> np.bincount(labels[balanced_order(labels, np.random.default_rng(0))])
    array([4, 4])
    """
    members = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    shares = np.diff(np.linspace(0, len(labels), len(members) + 1).astype(np.int64))
    rng.shuffle(shares)  # whose share is one larger
    chosen = []
    for places, share in zip(members, shares, strict=True):
        rounds = -(-int(share) // len(places))
        chosen.append(np.concatenate([rng.permutation(places) for _ in range(rounds)])[:share])
    return rng.permutation(np.concatenate(chosen))
