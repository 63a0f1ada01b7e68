"""Windows to train on under other motions, as an epoch shows them. `resynthesis` makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.simulation.shards import open_shard
from async_tnt.training.augment import Augmentation
from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.training.windows import Windows


@dataclass(frozen=True)
class MotionSettings:
    """How windows are re-synthesized, and how many of them are shown.

    Parameters
    ----------
    variations : other motions of each window; epochs take turns.
    shared_path : windows that start at the same time of their recordings moved alike, and share one path.
    recorded : share of the windows that an epoch shows as they were recorded.
    seed : of the motions and the simulation.
    """

    variations: int = 32
    shared_path: bool = False
    recorded: float = 0.25
    seed: int = 0

    def __post_init__(self) -> None:
        if self.variations < 1:
            raise ValueError(f"`variations` must be at least 1, got {self.variations}")
        if not 0 <= self.recorded <= 1:
            raise ValueError(f"`recorded` must be in [0, 1], got {self.recorded}")

    def for_epochs(self, n: int) -> MotionSettings:
        """The same without variations that `n` epochs do not show."""
        return replace(self, variations=min(self.variations, n))


@dataclass(frozen=True)
class Motions:
    """Windows to train on, and the same under other motions. Made by `resynthesize`.

    Parameters
    ----------
    shards : of each variation.
    training : as recorded.
    found : bool, (N,): which of them have other motions.
    paths : float64, (N, K, 2): how they moved, see `MotionPath.positions`.
    validation : the windows that are held out, under another motion each; those whose path was found.
    window_us : length of the windows.
    settings : how they were made.
    record : how many paths were found, what was measured, and how well it matches, for a model's record.
    """

    shards: list[list[Path]]
    training: Windows
    found: np.ndarray
    paths: np.ndarray
    validation: Windows
    window_us: int
    settings: MotionSettings
    record: dict[str, Any]

    def show(self, epoch: int, order: np.ndarray, rng: np.random.Generator) -> Windows:
        """The windows `order` as an epoch shows them: under another motion, or as they were recorded."""
        is_moved = self.found[order] & (rng.random(len(order)) >= self.settings.recorded)
        margin_us = max(self.window_us // 10, round(1e3 * Augmentation().start_ms))  # augmentation moves their starts
        recorded = self.training[order[~is_moved]].cut(self.window_us, margin_us)
        moved = read_shards(self.shards[epoch % self.settings.variations], self.training.labels)
        recording, start_us = np.zeros((2, len(order)), np.int64)
        recording[~is_moved], start_us[~is_moved] = recorded.recording, recorded.start_us
        recording[is_moved] = len(recorded.recordings) + order[is_moved]
        return Windows(recorded.recordings + moved, recording, start_us)


def read_shards(paths: Sequence[Path], labels: np.ndarray) -> Recordings:
    """The recordings of several shards, one after the other.

    Raises
    ------
    ValueError : a damaged shard, or not one recording for each label.
    """
    parts, offsets = [], [np.zeros(1, np.int64)]
    for path in paths:
        try:
            shard = open_shard(path)
        except ValueError as error:
            raise ValueError(f"{error}. Remove it and give the same command again") from None
        parts.append(shard)
        offsets.append(offsets[-1][-1] + shard.offsets[1:])
    if sum(map(len, parts)) != len(labels):
        raise ValueError(f"{paths[0].parent}: its shards hold {sum(map(len, parts))} windows, expected {len(labels)}")
    columns = {
        name: np.concatenate([np.empty(0, dtype), *(getattr(shard, name) for shard in parts)]).astype(dtype, copy=False)
        for name, dtype in COLUMNS.items()
    }
    return Recordings(
        **columns, offsets=np.concatenate(offsets), labels=labels, names=tuple(map(str, range(len(labels))))
    )
