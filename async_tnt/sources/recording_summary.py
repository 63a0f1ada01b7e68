"""What a recording holds, found in one pass over its file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.pixel_masks import hot_pixels
from async_tnt.sources.sensor import Sensor

PACKET_EVENTS = 1 << 16
MOST_PARTS, FIRST_PART_US = 4_096, 1_000


@dataclass(frozen=True)
class RecordingSummary:
    """Made by `summarize`.

    Attributes
    ----------
    path, format, n_bytes : the file, the name of its format, and its size.
    sensor : (width, height) as the file states it or the caller does; None: neither does.
    states_sensor : whether the file states it.
    extent : the smallest (width, height) that holds all events; (0, 0) without events.
    n_events, n_on, n_unsorted : events, those that are ON, and those earlier than the one before them in the file.
    first_us, last_us : the earliest and the latest time, in microseconds; 0 without events.
    part_us, counts : int64, (n,): events of each part of `part_us` since the earliest event of the file's first packet.
    hot : (x, y, events) of each hot pixel, busiest first, see `pixel_masks`; empty where the sensor is not known.
    """

    path: Path
    format: str
    n_bytes: int
    sensor: Sensor | None
    states_sensor: bool
    extent: tuple[int, int]
    n_events: int
    n_on: int
    n_unsorted: int
    first_us: int
    last_us: int
    part_us: int
    counts: np.ndarray
    hot: list[tuple[int, int, int]]

    def rates(self, n_parts: int) -> np.ndarray:
        """Events a second in each of so many equal parts of the recording, float64, (n_parts,)."""
        edges = np.linspace(0, max(1, self.last_us - self.first_us + 1) / self.part_us, n_parts + 1)
        so_far = np.interp(edges, np.arange(len(self.counts) + 1), np.concatenate([[0], np.cumsum(self.counts)]))
        return np.asarray(np.diff(so_far) / (np.diff(edges) * self.part_us * 1e-6))


def summarize(path: str | os.PathLike[str], sensor: Sensor | None = None) -> RecordingSummary:
    """Read a recording once, in little memory.

    Parameters
    ----------
    path : of any format that `open_recording` knows.
    sensor : (width, height), where the file does not state it.

    Raises
    ------
    As `open_recording`; ValueError also for events off the sensor. A damaged recording is summarized up to the damage.
    """
    recording = open_recording(path, PACKET_EVENTS, sensor=sensor)
    known = recording.sensor
    pixels = np.zeros(0 if known is None else known[0] * known[1], np.int64)
    parts = _Parts()
    extent, n_on, n_unsorted, newest_us = (0, 0), 0, 0, -1
    for packet in recording:
        t, x, y = (packet[name].astype(np.int64) for name in "txy")
        extent = max(extent[0], int(x.max()) + 1), max(extent[1], int(y.max()) + 1)
        if known is not None:
            if extent[0] > known[0] or extent[1] > known[1]:
                raise ValueError(f"{path}: events reach {extent[0]}x{extent[1]}, off `sensor` {known[0]}x{known[1]}")
            pixels += np.bincount(y * known[0] + x, minlength=len(pixels))
        n_on += int((packet["p"] > 0).sum())
        n_unsorted += int((np.diff(t, prepend=newest_us) < 0).sum())
        newest_us = int(t[-1])
        parts.add(t)
    found = []
    if known is not None and recording.n_events:
        counts = pixels.reshape(known[1], known[0])
        found = [(int(x), int(y), int(counts[y, x])) for y, x in np.argwhere(hot_pixels(counts))]
    first_us = recording.earliest_us
    return RecordingSummary(
        path=recording.path,
        format=recording.format,
        n_bytes=recording.path.stat().st_size,
        sensor=known,
        states_sensor=recording.stated_sensor is not None,
        extent=extent,
        n_events=recording.n_events,
        n_on=n_on,
        n_unsorted=n_unsorted,
        first_us=first_us,
        last_us=first_us + recording.duration_us,
        part_us=parts.part_us,
        counts=parts.counts,
        hot=sorted(found, key=lambda pixel: -pixel[2]),
    )


class _Parts:
    """Counts of equal parts of a recording, whose length is not known: when they are too many, each two become one."""

    def __init__(self) -> None:
        self.part_us, self.start_us = FIRST_PART_US, 0
        self.counts = np.zeros(0, np.int64)

    def add(self, t: np.ndarray) -> None:
        if not len(self.counts):
            self.start_us = int(t.min())
        since = np.maximum(t - self.start_us, 0)  # unsorted events before the first packet's count as its first
        while since.max() >= self.part_us * MOST_PARTS:
            self.part_us *= 2
            self.counts = np.pad(self.counts, (0, len(self.counts) % 2)).reshape(-1, 2).sum(1)
        found = np.bincount(since // self.part_us)
        longer = max(len(found), len(self.counts))
        self.counts = np.pad(self.counts, (0, longer - len(self.counts))) + np.pad(found, (0, longer - len(found)))
