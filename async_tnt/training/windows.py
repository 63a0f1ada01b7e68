"""Labelled recordings in memory, and windows of them.

Thousands of recordings are held as four long columns with offsets. A window does not copy its events: it is a recording
and a start. So augmentation can move its start into the neighbouring window, as the windows of a live stream start at
the stream's first event.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

CLASSES = tuple("0123456789")
COLUMNS = {"t": np.int32, "x": np.uint16, "y": np.uint16, "p": np.uint8}
DURATION_US = 315_000
"""Three saccades of 105 ms; the few later events of an N-MNIST recording are left out."""


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
        cls, events: Iterable[np.ndarray], labels: Sequence[int] | np.ndarray, names: Sequence[str] | None = None
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

    def events(self, i: int, window_us: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """t, x, y, p of window `i`; t int64, microseconds since the window's start."""
        some, recordings = self._slice(i, 0, window_us), self.recordings
        t = recordings.t[some].astype(np.int64) - self.start_us[i]
        return t, recordings.x[some], recordings.y[some], recordings.p[some]

    def cut(self, window_us: int, margin_us: int = 0) -> Windows:
        """The same windows, each on a recording of its own: a copy of its events and those in a margin around it."""
        parts = [self._slice(i, -margin_us, window_us + margin_us) for i in range(len(self))]
        columns = {}
        for name in COLUMNS:
            column = getattr(self.recordings, name)
            columns[name] = np.concatenate([column[:0], *(column[part] for part in parts)])
        sizes = np.array([part.stop - part.start for part in parts], np.int64)
        columns["t"] = (columns["t"] - np.repeat(self.start_us - margin_us, sizes)).astype(COLUMNS["t"])
        offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
        names = tuple(self.recordings.names[r] for r in self.recording)
        one_each = Recordings(**columns, offsets=offsets, labels=self.labels, names=names)
        return Windows(one_each, np.arange(len(self)), np.full(len(self), margin_us, np.int64))

    def _slice(self, i: int, from_us: int, until_us: int) -> slice:
        """Events of window `i`'s recording between two times since the window's start."""
        r, t = self.recording[i], self.recordings.t
        first, last = int(self.recordings.offsets[r]), int(self.recordings.offsets[r + 1])
        bounds = np.clip(self.start_us[i] + np.array([from_us, until_us]), 0, np.iinfo(t.dtype).max)
        start, stop = first + np.searchsorted(t[first:last], bounds.astype(t.dtype))  # of its type: else t is copied
        return slice(int(start), int(stop))


def split_recordings(
    recordings: Recordings, fraction: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Hold out a share of each class's recordings, drawn at random.

    Whole recordings: the three saccades of one digit are never on both sides.

    Parameters
    ----------
    fraction : the share, rounded to whole recordings of each class.

    Returns
    -------
    train, held_out : int64 indices, increasing. With a fraction of 0, `held_out` is empty.
    """
    if not 0 <= fraction < 1:
        raise ValueError(f"`fraction` must be in [0, 1), got {fraction}")
    held_out = np.zeros(len(recordings), bool)
    for label in np.unique(recordings.labels):
        members = rng.permutation(np.flatnonzero(recordings.labels == label))
        held_out[members[: round(fraction * len(members))]] = True
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def make_windows(
    recordings: Recordings,
    window_us: int,
    *,
    which: np.ndarray | None = None,
    first_event: bool = False,
    duration_us: int | None = DURATION_US,
) -> Windows:
    """Windows end to end on each recording, as `Processor` opens them, without the empty ones.

    Parameters
    ----------
    window_us : their length; `duration_us // window_us` of them on each recording, at least one.
    which : indices of recordings; all by default.
    first_event : False starts at 0 (N-MNIST's saccades at 105 ms), True at each recording's first event, as
        where a stream is classified without an explicit start.
    duration_us : see `window_us`; None: up to the recording's last event, so the last window may be partial.
    """
    which = np.arange(len(recordings)) if which is None else np.asarray(which)
    windows = []
    for r in which:
        t = recordings.t[recordings.offsets[r] : recordings.offsets[r + 1]].astype(np.int64)
        first_us = int(t[0]) if first_event and len(t) else 0
        index = np.unique((t - first_us) // window_us)  # only windows that hold events: a pause of hours costs nothing
        if duration_us is not None:
            index = index[index < max(1, duration_us // window_us)]
        windows += [(r, first_us + window_us * k) for k in index]
    table = np.array(windows, np.int64).reshape(-1, 2)
    return Windows(recordings, np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1]))
