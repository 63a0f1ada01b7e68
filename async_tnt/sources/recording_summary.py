"""The summary of a recording. One pass over its file finds its times, and another pass the rest."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from async_tnt.kernels.sources.pixels import count_events
from async_tnt.sources.files.off_sensor import likely_side
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.pixels.hot_pixels import MAX_PIXELS, hot_pixels, listed_pixels
from async_tnt.volume.events import ANY_SENSOR
from async_tnt.volume.sensor import Sensor

PACKET_EVENTS = 1 << 16
"""Number of events that are counted together."""

N_PARTS = 60
"""Number of parts of equal duration of a recording, whose events are counted apart."""


@dataclass(frozen=True)
class RecordingSummary:
    """What `summarize` has found. `async-tnt info` writes these fields as JSON.

    Attributes
    ----------
    recording, format, bytes : the file, the name of its format, and its size.
    sensor : (width, height) as the file or the caller states it; None if neither does.
    sensor_stated : whether the file, or its format, states the sensor.
    extent : the smallest (width, height) that holds all events except strays, see `likely_side`;
        (0, 0) without events.
    reach : the smallest (width, height) that holds all events; (0, 0) without events.
    off_sensor : number of events off the sensor; these are left out of all other numbers.
    events : number of events.
    on : number of ON events.
    unsorted : number of events that are earlier than the event before them in the file.
    first_us, last_us : the earliest and the latest time, in microseconds; 0 without events.
    events_a_second : rate in each of `N_PARTS` equal parts of the recording; empty without events.
    hot_pixels : `x`, `y` and `events` of each hot pixel, busiest first, see
        `pixels/hot_pixels.py`; empty where the sensor is not known.
    topics : `name`, `type`, `messages` and `is_read` of each topic of a ROS bag; empty for other
        files.
    """

    recording: str
    format: str
    bytes: int
    sensor: Sensor | None
    sensor_stated: bool
    extent: tuple[int, int]
    reach: tuple[int, int]
    off_sensor: int
    events: int
    on: int
    unsorted: int
    first_us: int
    last_us: int
    events_a_second: list[float]
    hot_pixels: list[dict[str, int]]
    topics: list[dict[str, Any]]


def summarize(
    path: str | os.PathLike[str], sensor: Sensor | None = None, **reading: Any
) -> RecordingSummary:
    """The summary of a recording, made in little memory.

    Parameters
    ----------
    path : a file of any format that `open_recording` knows.
    sensor : (width, height), where the file does not state it.
    reading : other options of `open_recording`.

    Raises
    ------
    The errors of `open_recording`. A damaged recording is summarized up to the damage.
    """
    recording = open_recording(path, PACKET_EVENTS, sensor=sensor, off_sensor="count", **reading)
    known_sensor = recording.sensor
    has_pixel_counts = False
    pixel_counts = np.zeros((0, 0), np.int64)
    if known_sensor is not None and known_sensor[0] * known_sensor[1] <= MAX_PIXELS:
        has_pixel_counts = True
        pixel_counts = np.zeros((known_sensor[1], known_sensor[0]), np.int64)
    first_us = recording.earliest_us
    duration_us = recording.duration_us
    # One microsecond more, so that each part lasts some time even if all events have one time.
    edges = np.linspace(0, duration_us + 1, N_PARTS + 1)
    part_counts = np.zeros(N_PARTS, np.int64)
    column_counts = np.zeros(ANY_SENSOR[0], np.int64)
    row_counts = np.zeros(ANY_SENSOR[1], np.int64)
    n_on = 0
    n_unsorted = 0
    previous_us = -1
    for packet in recording:
        t = np.ascontiguousarray(packet["t"])
        x = np.ascontiguousarray(packet["x"])
        y = np.ascontiguousarray(packet["y"])
        column_counts += np.bincount(x, minlength=len(column_counts))
        row_counts += np.bincount(y, minlength=len(row_counts))
        if has_pixel_counts:
            count_events(x, y, len(t), pixel_counts)
        n_on += int((packet["p"] > 0).sum())
        n_unsorted += int((np.diff(t, prepend=previous_us) < 0).sum())
        previous_us = int(t[-1])
        part_counts += np.histogram(t - first_us, edges)[0]

    events_a_second: list[float] = []
    if recording.n_events:
        events_a_second = (part_counts / (np.diff(edges) * 1e-6)).tolist()
    hot: list[dict[str, int]] = []
    if has_pixel_counts:
        hot = listed_pixels(pixel_counts, hot_pixels(pixel_counts))
    return RecordingSummary(
        recording=str(path),
        format=recording.format,
        bytes=recording.path.stat().st_size,
        sensor=known_sensor,
        sensor_stated=recording.stated_sensor is not None,
        extent=(likely_side(column_counts), likely_side(row_counts)),
        reach=(_reach(column_counts), _reach(row_counts)),
        off_sensor=recording.counts.off_sensor,
        events=recording.n_events,
        on=n_on,
        unsorted=n_unsorted,
        first_us=first_us,
        last_us=first_us + duration_us,
        events_a_second=events_a_second,
        hot_pixels=hot,
        topics=[asdict(topic) for topic in recording.source.topics],
    )


def _reach(counts: np.ndarray) -> int:
    """The shortest side, in pixels, that holds all events.

    It follows from the number of events at each column (or row).
    """
    return int(np.flatnonzero(counts).max(initial=-1)) + 1
