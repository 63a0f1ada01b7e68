"""Labelled recordings in memory, and the windows that lie on them.

Thousands of recordings are held as four long columns with offsets. A window is not a copy of its events but a
place: a recording and a start. So its start can be moved into the neighbouring window's events, as a live
stream's windows are, which start at the stream's first event.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.sources.files.nmnist import read_nmnist

CLASSES = tuple("0123456789")
COLUMNS = {"t": np.int32, "x": np.uint16, "y": np.uint16, "p": np.uint8}
DURATION_US = 315_000
"""Three saccades of 105 ms; the few later events of an N-MNIST recording are left out."""

Progress = Callable[[Iterable[Any], str, int], Iterator[Any]]


def no_progress(items: Iterable[Any], title: str, total: int) -> Iterator[Any]:
    """Shows nothing."""
    return iter(items)


@dataclass(frozen=True)
class Recordings:
    """R recordings, one after the other.

    Parameters
    ----------
    t : int32, shape (E,), microseconds since the recording's start, never decreasing within a recording.
    x, y : uint16, shape (E,). p : uint8, shape (E,), 0 or 1.
    offsets : int64, shape (R + 1,). Recording r has the events `offsets[r] <= i < offsets[r + 1]`.
    labels : int64, shape (R,).
    names : R names, such as file paths relative to their folder.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray
    offsets: np.ndarray
    labels: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.labels)

    def __add__(self, other: Recordings) -> Recordings:
        return Recordings(
            np.concatenate([self.t, other.t]),
            np.concatenate([self.x, other.x]),
            np.concatenate([self.y, other.y]),
            np.concatenate([self.p, other.p]),
            np.concatenate([self.offsets, self.offsets[-1] + other.offsets[1:]]),
            np.concatenate([self.labels, other.labels]),
            self.names + other.names,
        )

    @classmethod
    def from_events(
        cls,
        events: Iterable[np.ndarray],
        labels: Sequence[int] | np.ndarray,
        names: Sequence[str] | None = None,
    ) -> Recordings:
        """From structured arrays with fields t, x, y, p.

        Raises
        ------
        ValueError : times decrease or do not fit 31 bits (36 minutes), or the lengths differ.
        """
        names = tuple(str(i) for i in range(len(labels))) if names is None else tuple(names)
        if len(labels) != len(names):
            raise ValueError(f"`labels` must have one per recording, got {len(labels)} for {len(names)}")
        parts: dict[str, list[np.ndarray]] = {name: [np.empty(0, COLUMNS[name])] for name in COLUMNS}
        sizes = [0]
        for name, recording in zip(names, events, strict=True):
            t = recording["t"]
            if len(t) and not (t[0] >= 0 and t[-1] < 1 << 31 and (np.diff(t) >= 0).all()):
                raise ValueError(f"{name}: times must be in order and in [0, 2**31) us, got {t[0]} to {t[-1]}")
            for field, dtype in COLUMNS.items():
                parts[field].append(recording[field].astype(dtype))
            sizes.append(len(t))
        t, x, y, p = (np.concatenate(parts[field]) for field in COLUMNS)
        return cls(t, x, y, p, np.cumsum(sizes, dtype=np.int64), np.asarray(labels, np.int64), names)


@dataclass(frozen=True)
class Windows:
    """N windows on recordings: window i is recording `recording[i]` from `start_us[i]` on, int64, (N,)."""

    recordings: Recordings
    recording: np.ndarray
    start_us: np.ndarray

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, indices: np.ndarray | slice) -> Windows:
        return Windows(self.recordings, self.recording[indices], self.start_us[indices])

    @property
    def labels(self) -> np.ndarray:
        """int64, shape (N,)."""
        return self.recordings.labels[self.recording]


def read_folder(
    folder: str | os.PathLike[str],
    *,
    skip_damaged: bool = False,
    per_digit: int | None = None,
    progress: Progress = no_progress,
) -> Recordings:
    """Read a folder in N-MNIST's layout: `<digit>/<number>.bin`.

    Parameters
    ----------
    folder : the folder with the digits' folders, such as N-MNIST's Train.
    skip_damaged : False refuses a damaged file with an error that names it; True leaves it out with a warning
        that names it.
    per_digit : read only the first so many of each digit, by name.

    Raises
    ------
    ValueError : a damaged file, or no recordings at all.
    FileNotFoundError : no such folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {folder}; expected N-MNIST's layout <digit>/<number>.bin in it")
    paths = []
    for digit in sorted(d for d in folder.iterdir() if d.is_dir() and re.fullmatch("[0-9]", d.name)):
        paths += [(int(digit.name), path) for path in sorted(digit.glob("*.bin"))[:per_digit]]
    if not paths:
        raise ValueError(f"{folder}: no recordings; expected N-MNIST's layout <digit>/<number>.bin")
    events, labels, names = [], [], []
    for label, path in progress(paths, "reading", len(paths)):
        try:
            events.append(read_nmnist(path))
        except ValueError as error:
            if not skip_damaged:
                raise ValueError(f"{error} Or leave damaged files out with --skip-damaged.") from None
            warnings.warn(f"left out: {error}", stacklevel=2)
            continue
        labels.append(label)
        names.append(f"{path.parent.name}/{path.name}")
    return Recordings.from_events(events, labels, names)


def split_recordings(
    recordings: Recordings, fraction: float, rng: np.random.Generator, *, at_least: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Hold out a share of each class's recordings, drawn at random.

    Whole recordings: the three saccades of one digit never lie on both sides.

    Parameters
    ----------
    fraction : the share, rounded to whole recordings of each class.
    at_least : of each class hold out so many all the same, and leave one to train on, where it has as many; no effect
        with a fraction of 0.

    Returns
    -------
    train, held_out : int64 indices, increasing. With a fraction of 0, `held_out` is empty.
    """
    if not 0 <= fraction < 1:
        raise ValueError(f"`fraction` must be in [0, 1), got {fraction}")
    held_out = np.zeros(len(recordings), bool)
    for label in np.unique(recordings.labels):
        members = rng.permutation(np.flatnonzero(recordings.labels == label))
        n = round(fraction * len(members))
        if fraction and at_least:
            n = min(max(n, at_least), len(members) - 1)
        held_out[members[:n]] = True
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def lay_windows(
    recordings: Recordings,
    window_us: int,
    *,
    which: np.ndarray | None = None,
    first_event: bool = False,
    duration_us: int | None = DURATION_US,
) -> Windows:
    """Windows laid end to end on each recording, as `Processor` lays them; empty ones are left out.

    Parameters
    ----------
    window_us : their length; `duration_us // window_us` of them on each recording, at least one.
    which : indices of recordings; all by default.
    first_event : False starts at 0 (N-MNIST's saccades at 105 ms), True at each recording's first event, as
        where a stream is classified without an explicit start.
    duration_us : see `window_us`; None: as many as it takes to the recording's last event, the last one perhaps
        cut short by the recording's end.
    """
    which = np.arange(len(recordings)) if which is None else np.asarray(which)
    places = []
    for r in which:
        t = recordings.t[recordings.offsets[r] : recordings.offsets[r + 1]]
        first_us = int(t[0]) if first_event and len(t) else 0
        if duration_us is None:  # only those that hold events: a pause of hours costs nothing
            starts = first_us + window_us * np.unique((t.astype(np.int64) - first_us) // window_us)
            places += [(r, start) for start in starts]
            continue
        starts = first_us + window_us * np.arange(max(1, duration_us // window_us) + 1)
        occupied = np.diff(np.searchsorted(t, starts)) > 0
        places += [(r, start) for start in starts[:-1][occupied]]
    table = np.array(places, np.int64).reshape(-1, 2)
    return Windows(recordings, np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1]))
