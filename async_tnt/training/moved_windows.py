"""Training windows under other motions: their files, and how an epoch shows them.

A window under another motion has the events that its object would have given if it had moved on
another path. `training.resynthesis` makes these windows. An .npz file has n consecutive windows:

    moved_0, moved_1, ...   structured (t, x, y, p): the events of all n windows. In each of these
                            arrays every window has another random motion. Window i begins at the
                            time i * window_us
    refused                 str, (n,): why a window's path cannot be relied on; empty if it can.
                            A refused window has no events in moved_0, moved_1, ...
    spans                   int64, (n,): `MotionPath.span` of each window; 0 if it is refused
    positions               float64, (n, K, 2): `MotionPath.positions` of each window
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.files import open_regular, replacing
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.training.augment import LATEST, Augmentation
from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import EVENT_DTYPE, EventDecoder

MIN_MOVED = 50
"""Fewest held-out windows under other motions on which accuracy is measured. The accuracy on fewer
windows would say nothing."""


@dataclass(frozen=True)
class MotionSettings:
    """How windows are re-synthesized, and how many of them are shown.

    Parameters
    ----------
    variations : number of other motions of each window. Each epoch shows one of them, and the next
        epoch shows the next one.
    recorded : share of the windows that an epoch shows as they were recorded.
    seed : decides the motions and the simulation.

    Raises
    ------
    ValueError : `variations` is below 1, or `recorded` is outside of [0, 1].
    """

    variations: int = 32
    recorded: float = 0.25
    seed: int = 0

    def __post_init__(self) -> None:
        if self.variations < 1:
            raise ParameterValueError("variations", "must be at least 1", self.variations)
        if not 0 <= self.recorded <= 1:
            raise ParameterValueError("recorded", "must be in [0, 1]", self.recorded)

    def for_epochs(self, n: int) -> MotionSettings:
        """The same settings with at most `n` variations, because `n` epochs show no more."""
        return replace(self, variations=min(self.variations, n))


@dataclass(frozen=True)
class Motions:
    """Windows to train on, as recorded and under other motions. `resynthesize` returns them.

    Parameters
    ----------
    files : the files of the training windows under other motions, in the order of the windows.
    training : the windows to train on, as recorded.
    refused : str, (N,): why a window's path cannot be relied on, so that the window has no other
        motions; empty if the path can be relied on.
    spans, paths : int64, (N,), and float64, (N, K, 2): `span` and `positions` of each window's
        `MotionPath`. The span is 0 if the path is refused.
    validation : the held-out windows whose path was found, each under one other motion.
    config : how events become volumes; only its sensor and the length of its windows are used.
    settings : how the motions were made.
    record : for a model's record: how many paths were found, how the pixels were simulated, and how
        well re-synthesized events match the recorded ones.
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
        """The windows that an epoch shows, each under another motion or as recorded.

        A recorded window also has the events before and after it, because augmentation may move the
        window's start.

        Parameters
        ----------
        epoch : number of the epoch, from 0 on.
        order : indices of the windows, in the order in which they are shown.
        rng : draws which windows are shown as recorded.
        """
        is_moved = (self.spans[order] > 0) & (rng.random(len(order)) >= self.settings.recorded)
        window_us = self.config.window_us
        # at least the shift of the start that augmentation draws by default
        shift_us = max(window_us // 10, round(1e3 * Augmentation().start_ms))
        margin_us = round(LATEST * window_us) + shift_us
        recorded = self.training[order[~is_moved]].cut(window_us, margin_us)
        variation = epoch % self.settings.variations
        other_motion = moved_recordings(self.files, variation, self.training.labels, self.config)
        recording = np.zeros(len(order), np.int64)
        start_us = np.zeros(len(order), np.int64)
        recording[~is_moved] = recorded.recording
        start_us[~is_moved] = recorded.start_us
        # after the recorded windows, `Recordings` has all windows of the variation
        recording[is_moved] = len(recorded.recordings) + order[is_moved]
        return Windows(recorded.recordings + other_motion, recording, start_us)


def write_moved(
    file: Path,
    variations: Sequence[Sequence[np.ndarray]],
    paths: Sequence[MotionPath],
    window_us: int,
) -> None:
    """Write a file of windows under other motions.

    Parameters
    ----------
    file : the file.
    variations : for each variation the events of each window, with times from the window's start.
    paths : how each window moved when it was recorded.
    window_us : length of a window.
    """
    # 32 bits are enough for the times of most files
    time_type = np.int32 if len(paths) * window_us < 1 << 31 else np.int64
    stored_type = np.dtype([("t", time_type), *EVENT_DTYPE.descr[1:]])
    arrays = {
        "refused": np.array([path.refused for path in paths]),
        "spans": np.array([0 if path.refused else path.span for path in paths]),
        "positions": np.array([path.positions for path in paths]),
    }
    for v, windows in enumerate(variations):
        events = np.concatenate(windows)
        starts_us = window_us * np.arange(len(windows))
        events["t"] += np.repeat(starts_us, [len(window) for window in windows])
        arrays[f"moved_{v}"] = events.astype(stored_type)
    with replacing(file) as part, part.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def read_arrays(path: Path, *names: str) -> list[np.ndarray]:
    """Read arrays of a file, by their names.

    Raises
    ------
    ValueError : the file is damaged, or lacks an array.
    """
    try:
        with open_regular(path) as content, np.load(content) as file:
            return [file[name] for name in names]
    except Exception as error:  # a damaged archive raises one of a dozen types of errors
        raise damaged(path, type(error).__name__) from error


def moved_recordings(
    files: Sequence[Path], variation: int, labels: np.ndarray, config: TNTConfig
) -> Recordings:
    """Read the windows of several files under one of their motions. Each becomes a recording.

    Parameters
    ----------
    files : the files, in the order of the windows.
    variation : number of the motion, from 0 on.
    labels : int64, the label of each window.
    config : its sensor and the length of its windows are used.

    Raises
    ------
    ValueError : a file is damaged, or the files do not have one window for each label.
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
        # Divide the events into windows, and let times count from each window's start. `t` is a
        # view of `columns[0]`, which therefore changes, too.
        ends = np.searchsorted(t, config.window_us * np.arange(1, len(refused) + 1))
        t %= config.window_us
        for (name, dtype), column in zip(COLUMNS.items(), columns, strict=True):
            parts[name].append(column[:n].astype(dtype))
        offsets.append(offsets[-1][-1] + ends)
    bounds = np.concatenate(offsets)
    if len(bounds) != len(labels) + 1:
        raise damaged(files[0].parent, f"{len(bounds) - 1} windows, expected {len(labels)}")
    all_events = {name: np.concatenate(part) for name, part in parts.items()}
    names = tuple(str(i) for i in range(len(labels)))
    return Recordings(**all_events, offsets=bounds, labels=labels, names=names)


def damaged(path: Path, problem: object) -> ValueError:
    """The error to raise for a damaged file of windows under other motions."""
    return ValueError(f"{path}: damaged ({problem}). Remove it and give the same command again")
