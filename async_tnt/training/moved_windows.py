"""Windows to train on under other motions, as an epoch shows them, and their files. `resynthesis`
makes them.

An .npz file has n consecutive windows:

    moved_0, moved_1, ...   structured (t, x, y, p): events of all n under one random motion each,
                            end to end: those of window i from i * window_us on
    refused                 str, (n,): why its path may not be relied on, empty where it may;
                            without one a window has no events here
    spans                   int64, (n,): of how many windows its path is, see `MotionPath`; 0 where
                            it is refused
    positions               float64, (n, K, 2): its path, see `MotionPath`
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.files import open_regular, replacing
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.training.augment import LATEST, Augmentation
from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import EVENT_DTYPE, EventDecoder

MIN_MOVED = 50
"""Held-out windows under other motions: the accuracy of fewer says nothing, and is not given."""


@dataclass(frozen=True)
class MotionSettings:
    """How windows are re-synthesized, and how many of them are shown.

    Parameters
    ----------
    variations : other motions of each window; epochs take turns.
    recorded : share of the windows that an epoch shows as they were recorded.
    seed : of the motions and the simulation.
    """

    variations: int = 32
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
    files : their other motions, one file after the other.
    training : as recorded.
    refused : str, (N,): why there is no path to rely on, and so no other motions; empty where there
        is.
    spans, paths : int64, (N,), and float64, (N, K, 2): how they moved, see `MotionPath`; a span of
        0 where refused.
    validation : the windows that are held out, under another motion each; those whose path was
        found.
    config : of the volumes; its sensor and the length of its windows are used.
    settings : how they were made.
    record : how many paths were found, what was measured, and how well it matches, for a model's
        record.
    """

    files: list[Path]
    training: Windows
    refused: np.ndarray
    spans: np.ndarray
    paths: np.ndarray
    validation: Windows
    config: TNTConfig
    settings: MotionSettings
    record: dict[str, Any]

    def show(self, epoch: int, order: np.ndarray, rng: np.random.Generator) -> Windows:
        """The windows `order` as an epoch shows them: under another motion, or as they were
        recorded, with the events around them, as augmentation moves their starts."""
        is_moved = (self.spans[order] > 0) & (rng.random(len(order)) >= self.settings.recorded)
        window_us = self.config.window_us
        margin_us = round(LATEST * window_us) + max(
            window_us // 10, round(1e3 * Augmentation().start_ms)
        )
        recorded = self.training[order[~is_moved]].cut(window_us, margin_us)
        variation = epoch % self.settings.variations
        moved = moved_recordings(self.files, variation, self.training.labels, self.config)
        recording, start_us = np.zeros((2, len(order)), np.int64)
        recording[~is_moved], start_us[~is_moved] = recorded.recording, recorded.start_us
        recording[is_moved] = len(recorded.recordings) + order[is_moved]
        return Windows(recorded.recordings + moved, recording, start_us)


def write_moved(
    path: Path, moved: Sequence[Sequence[np.ndarray]], paths: Sequence[MotionPath], window_us: int
) -> None:
    """Write a file: the events of each variation's windows, times from the window's start."""
    times = np.int32 if len(paths) * window_us < 1 << 31 else np.int64
    stored = np.dtype([("t", times), *EVENT_DTYPE.descr[1:]])
    arrays = {
        "refused": np.array([path.refused for path in paths]),
        "spans": np.array([0 if path.refused else path.span for path in paths]),
        "positions": np.array([path.positions for path in paths]),
    }
    for v, windows in enumerate(moved):
        events = np.concatenate(windows)
        events["t"] += np.repeat(window_us * np.arange(len(windows)), [len(one) for one in windows])
        arrays[f"moved_{v}"] = events.astype(stored)
    with replacing(path) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_arrays(path: Path, *names: str) -> list[np.ndarray]:
    """Arrays of a file; a ValueError if it is damaged, which the checksums of the archive tell."""
    try:
        with open_regular(path) as content, np.load(content) as file:
            return [file[name] for name in names]
    except Exception as error:  # a damaged archive surfaces as any of a dozen types
        raise damaged(path, type(error).__name__) from error


def moved_recordings(
    files: Sequence[Path], variation: int, labels: np.ndarray, config: TNTConfig
) -> Recordings:
    """The windows of several files under one of their motions, a recording each.

    Raises
    ------
    ValueError : a damaged file, or not one window for each label.
    """
    decoder = EventDecoder(config.sensor, late="raise")
    parts: dict[str, list[np.ndarray]] = {
        name: [np.empty(0, dtype)] for name, dtype in COLUMNS.items()
    }
    offsets = [np.zeros(1, np.int64)]
    for path in files:
        refused, events = read_arrays(path, "refused", f"moved_{variation}")
        decoder.reset()
        try:
            *columns, n = decoder.decode(events)
        except (ValueError, TypeError) as error:
            raise damaged(path, error) from None
        t = columns[0][:n]
        ends = np.searchsorted(t, config.window_us * np.arange(1, len(refused) + 1))
        t %= config.window_us
        for (name, dtype), column in zip(COLUMNS.items(), columns, strict=True):
            parts[name].append(column[:n].astype(dtype))
        offsets.append(offsets[-1][-1] + ends)
    bounds = np.concatenate(offsets)
    if len(bounds) != len(labels) + 1:
        raise damaged(files[0].parent, f"{len(bounds) - 1} windows, expected {len(labels)}")
    together = {name: np.concatenate(part) for name, part in parts.items()}
    return Recordings(
        **together, offsets=bounds, labels=labels, names=tuple(map(str, range(len(labels))))
    )


def damaged(path: Path, what: object) -> ValueError:
    """The error about a damaged file among these."""
    return ValueError(f"{path}: damaged ({what}). Remove it and give the same command again")
