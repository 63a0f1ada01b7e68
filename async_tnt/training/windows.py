"""Windows on labelled recordings.

A window has no copy of its events. It has the number of a recording, and a start. So augmentation
can move the start of a window into a neighbouring window. Training needs this, because the first
window of a live stream starts at the stream's first event, which may be at any time of a motion.

A window that slides is seen at all moments of a stream. So `Windows.slid` gives each window another
moment in every epoch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.volume.config import TNTConfig

JUDGED = 500
"""Most windows whose events `Windows.events_a_pixel` counts."""

FARTHEST = 0.95
"""How far `Windows.slid` moves a window at most, as a share of its length. So a window at the
beginning of a recording keeps at least a twentieth of its length."""


@dataclass(frozen=True)
class Windows:
    """N windows on recordings.

    Parameters
    ----------
    recordings : the recordings that the windows are parts of.
    recording, start_us : int64, shape (N,). Window i is a part of recording `recording[i]`, from
        `start_us[i]` on.
    stop : int64, shape (N,), of windows of a number of events: window i has the `n_events` events
        before the one with this index in the columns of `recordings`, or fewer at the beginning of
        its recording. `start_us` is the time of the first of them. None: windows of a duration.
    n_events : the number of events of a window with `stop`.
    """

    recordings: Recordings
    recording: np.ndarray
    start_us: np.ndarray
    stop: np.ndarray | None = None
    n_events: int = 0

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, indices: np.ndarray | slice) -> Windows:
        stop = None if self.stop is None else self.stop[indices]
        return replace(
            self,
            recording=self.recording[indices],
            start_us=self.start_us[indices],
            stop=stop,
        )

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The events that windows may have: the first, and the one after the last.

        int64, (N,) each.

        They are those of the whole recording, unless windows have a number of events.
        """
        first = self.recordings.offsets[self.recording]
        if self.stop is None:
            return first, self.recordings.offsets[self.recording + 1]
        return np.maximum(first, self.stop - self.n_events), self.stop

    def ends_us(self, window_us: int) -> np.ndarray:
        """The end of each window, which the window does not include: int64, (N,).

        A window of a number of events ends a microsecond after its last event. Otherwise it ends
        `window_us`, its duration, after its start.
        """
        if self.stop is None:
            return self.start_us + window_us
        ends: np.ndarray = self.recordings.t[self.stop - 1].astype(np.int64) + 1
        return ends

    def joined(self, others: Windows) -> Windows:
        """These windows, and then others of the same recordings."""
        stop = None
        if self.stop is not None and others.stop is not None:
            stop = np.concatenate([self.stop, others.stop])
        return replace(
            self,
            recording=np.concatenate([self.recording, others.recording]),
            start_us=np.concatenate([self.start_us, others.start_us]),
            stop=stop,
        )

    def slid(self, window_us: int, rng: np.random.Generator) -> Windows:
        """Windows that end earlier than these, each by a random share of a window's length.

        If these windows lie end to end, the new ones end at any moment of a recording. A window
        that begins before its recording has fewer events, as in a stream that has just begun.

        window_us : a window's duration; not used if windows have a number of events.
        """
        share = rng.uniform(0.0, FARTHEST, len(self))
        if self.stop is None:
            return replace(self, start_us=self.start_us - np.int64(share * window_us))
        first = self.recordings.offsets[self.recording]
        stop = np.maximum(first + 1, self.stop - np.int64(share * self.n_events))
        begin = np.maximum(first, stop - self.n_events)
        start_us = self.recordings.t[begin].astype(np.int64)
        return replace(self, stop=stop, start_us=start_us)

    @property
    def labels(self) -> np.ndarray:
        """The label of each window: int64, shape (N,)."""
        labels: np.ndarray = self.recordings.labels[self.recording]
        return labels

    def events(
        self, i: int, window_us: int, around_us: Sequence[int] = (0, 0)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Columns t, x, y, p of the events of window `i`.

        t is int64, in microseconds since the window's start.

        Parameters
        ----------
        i : number of the window.
        window_us : length of the window.
        around_us : the durations before and after the window from which events are returned, too.
        """
        before_us, after_us = around_us
        part = self._slice(i, -before_us, window_us + after_us)
        recordings = self.recordings
        t = recordings.t[part].astype(np.int64) - self.start_us[i]
        return t, recordings.x[part], recordings.y[part], recordings.p[part]

    def neighbours(self, window_us: int) -> np.ndarray:
        """Whether the windows before and after each window are among these N windows.

        int64, shape (N, 2), 0 or 1.
        """
        starts = list(zip(self.recording.tolist(), self.start_us.tolist(), strict=True))
        all_starts = set(starts)
        has_neighbours = []
        for recording, start_us in starts:
            before = recording, start_us - window_us
            after = recording, start_us + window_us
            has_neighbours.append((before in all_starts, after in all_starts))
        return np.array(has_neighbours, np.int64).reshape(-1, 2)

    def events_a_pixel(self, window_us: int) -> float:
        """The number of events of one polarity that an active pixel has in a window of `window_us`.

        It is the mean over the active pixels of a window, and the median over at most `JUDGED`
        windows. An edge that passes a pixel once leaves one or two events; an edge that passes it
        again and again leaves more.
        """
        means = []
        for i in np.linspace(0, len(self) - 1, min(JUDGED, len(self))).astype(int):
            _, x, y, p = self.events(i, window_us)
            if len(x):
                # one number for each pixel and polarity
                pixels = (y.astype(np.int64) << 17) | (x.astype(np.int64) << 1) | (p > 0)
                means.append(len(x) / len(np.unique(pixels)))
        return float(np.median(means)) if means else 0.0

    def cut(self, window_us: int, margin_us: int = 0) -> Windows:
        """The same windows of `window_us`, each on a recording of its own.

        The recording holds copies of the window's events, and of the events in the `margin_us`
        before and after it.
        """
        parts = [self._slice(i, -margin_us, window_us + margin_us) for i in range(len(self))]
        columns = {}
        for name in COLUMNS:
            column = getattr(self.recordings, name)
            columns[name] = np.concatenate([column[:0], *(column[part] for part in parts)])
        sizes = np.array([part.stop - part.start for part in parts], np.int64)
        columns["t"] = (columns["t"] - np.repeat(self.start_us - margin_us, sizes)).astype(
            COLUMNS["t"]
        )
        offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
        names = tuple(self.recordings.names[r] for r in self.recording)
        one_each = Recordings(**columns, offsets=offsets, labels=self.labels, names=names)
        return Windows(one_each, np.arange(len(self)), np.full(len(self), margin_us, np.int64))

    def _slice(self, i: int, from_us: int, until_us: int) -> slice:
        """The slice of events between two times since the start of window `i`, in its recording.

        The times do not matter if windows have a number of events.
        """
        if self.stop is not None:
            firsts, stops = self[i : i + 1].bounds
            return slice(int(firsts[0]), int(stops[0]))
        r = self.recording[i]
        t = self.recordings.t
        first = int(self.recordings.offsets[r])
        end = int(self.recordings.offsets[r + 1])
        # With bounds of another type than t, `searchsorted` would copy t. But a bound may be one
        # more than this type holds. So the search is for the last microsecond before each bound.
        limits = np.iinfo(t.dtype)
        before_us = self.start_us[i] + np.array([from_us, until_us]) - 1
        before_us = np.clip(before_us, limits.min, limits.max).astype(t.dtype)
        start, stop = first + np.searchsorted(t[first:end], before_us, side="right")
        return slice(int(start), int(stop))


def make_windows(
    recordings: Recordings,
    window_us: int,
    *,
    which: np.ndarray | None = None,
    first_event: bool = False,
    duration_us: int | None = None,
) -> Windows:
    """Divide recordings into windows end to end, as `Processor` does. Empty windows are left out.

    Parameters
    ----------
    recordings : the recordings to divide.
    window_us : length of a window.
    which : indices of the recordings to divide; all by default.
    first_event : False: the first window starts at 0. True: it starts at each recording's first
        event, as in a stream that is classified without an explicit start.
    duration_us : a recording is divided up to this time: into `duration_us // window_us` windows,
        but at least one. None: up to its last event, so the last window may be partial.
    """
    which = np.arange(len(recordings)) if which is None else np.asarray(which)
    windows = []
    for r in which:
        t = recordings.t[recordings.offsets[r] : recordings.offsets[r + 1]].astype(np.int64)
        first_us = int(t[0]) if first_event and len(t) else 0
        # only windows that hold events, so that a pause of hours costs nothing
        numbers = np.unique((t - first_us) // window_us)
        if duration_us is not None:
            numbers = numbers[numbers < max(1, duration_us // window_us)]
        windows += [(r, first_us + window_us * k) for k in numbers]
    table = np.array(windows, np.int64).reshape(-1, 2)
    return Windows(recordings, np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1]))


def windows_of(
    recordings: Recordings,
    config: TNTConfig,
    *,
    which: np.ndarray | None = None,
    moments: int = 1,
) -> Windows:
    """The windows of a configuration on recordings, the first from a recording's first event on.

    Windows lie end to end, see `make_windows`. Windows that slide do so, too, but the last one ends
    at the recording's last event, and may overlap the one before. In a recording that is shorter
    than a window, it is the only one.

    Parameters
    ----------
    recordings : the recordings to divide.
    config : says how long windows are, and whether they slide.
    which : indices of the recordings to divide; all by default.
    moments : how many windows that slide end within the length of one window. With more than 1,
        windows overlap, and those at the beginning of a recording have fewer events.
    """
    if not config.slides:
        return make_windows(recordings, config.window_us, which=which, first_event=True)
    which = np.arange(len(recordings)) if which is None else np.asarray(which)
    parts = [np.empty((0, 3), np.int64)]
    for r in which:
        first, end = recordings.offsets[r : r + 2].tolist()
        if first == end:
            continue
        t = recordings.t[first:end].astype(np.int64)
        if config.last_events is not None:
            n = config.last_events
            stops = first + _moments(n, moments, end - first)
            starts_us = t[np.maximum(stops - n, first) - first]
        else:
            n = config.window_us
            ends_us = t[0] + _moments(n, moments, int(t[-1] - t[0]) + 1)
            starts_us = ends_us - n
            stops = first + np.searchsorted(t, ends_us)
            # only windows with events, so that a pause of hours costs nothing
            has_events = stops > first + np.searchsorted(t, starts_us)
            starts_us = starts_us[has_events]
            stops = stops[has_events]
        parts.append(np.stack([np.full(len(stops), r), starts_us, stops], axis=1))
    recording, start_us, stop = np.ascontiguousarray(np.concatenate(parts).T)
    if config.last_events is None:
        return Windows(recordings, recording, start_us)
    return Windows(recordings, recording, start_us, stop, config.last_events)


def _moments(length: int, moments: int, whole: int) -> np.ndarray:
    """The ends of windows that slide over a whole recording: int64, the last one is its end.

    Examples
    --------
    >>> _moments(100, 1, 250), _moments(100, 2, 80)
    (array([100, 200, 250]), array([50, 80]))
    """
    step = max(1, length // moments)
    return np.append(np.arange(step, whole, step), whole)
