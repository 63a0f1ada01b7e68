"""A recording as if it came from a camera: at its own pace."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.sources.files.recording import open_recording
from async_tnt.volume.events import ANY_SENSOR, as_events

LONGEST_S = 1e6
"""Longest sleep in seconds: the system refuses a sleep of some centuries."""


def replay(
    source: Iterable[Any] | np.ndarray | str | os.PathLike[str],
    speed: float = 1.0,
    *,
    packet_us: int = 1000,
) -> Iterator[np.ndarray]:
    """Yield the events of a recording in real time, counted from the first event.

    A packet is yielded when its last event is due, never before. It spans less than `packet_us`,
    which bounds how late its first event is. Deadlines are absolute: oversleeping does not add up,
    and a slow reader gets overdue packets at once.

    Parameters
    ----------
    source : a recording, its path, an array of events, or an iterable of packets in any form that
        `async_tnt.volume.event_forms` lists.
    speed : recorded time per time on the clock: 2 is twice as fast, `math.inf` never sleeps.
    packet_us : the longest recorded time of one packet, in microseconds.

    Raises
    ------
    ParameterValueError : `speed` is not above 0, or `packet_us` below 1.

    Examples
    --------
    >>> import math
    >>> from async_tnt.sources import sample_recordings
    >>> packets = replay(sample_recordings()[7], speed=math.inf, packet_us=5000)
    >>> packet = next(packets)
    >>> bool(packet["t"][-1] - packet["t"][0] < 5000)
    True
    """
    if not speed > 0:  # nan, too
        rule = "must be above 0 (math.inf: as fast as possible)"
        raise ParameterValueError("speed", rule, speed)
    if packet_us < 1:
        raise ParameterValueError("packet_us", "must be at least 1", packet_us)
    if isinstance(source, (str, os.PathLike)):
        source = open_recording(source)
    return _replay([source] if isinstance(source, np.ndarray) else source, speed, int(packet_us))


def _replay(source: Iterable[Any], speed: float, packet_us: int) -> Iterator[np.ndarray]:
    """The packets of `replay`, whose arguments have been checked."""
    started_ns: int | None = None
    first_us: int | None = None
    newest_us: int | None = None
    for given in source:
        packet = given if _has_fields(given) else as_events(given, ANY_SENSOR)
        if len(packet) == 0:
            continue
        # an event out of order is due together with the newest event before it
        due_us = np.maximum.accumulate(packet["t"].astype(np.int64))
        if newest_us is not None:
            np.maximum(due_us, newest_us, out=due_us)
        newest_us = int(due_us[-1])
        if first_us is None:
            first_us = int(due_us[0])
        # events with the same number go into one packet
        packet_number = (due_us - first_us) // packet_us
        cuts = np.flatnonzero(packet_number[1:] != packet_number[:-1]) + 1
        starts = [0, *cuts.tolist()]
        ends = [*cuts.tolist(), len(packet)]
        for start, end in zip(starts, ends, strict=True):
            if started_ns is None:  # the clock starts when the first packet is asked for
                started_ns = time.monotonic_ns()
            wait_until(started_ns + (int(due_us[end - 1]) - first_us) * 1000 / speed)
            yield packet[start:end]


def _has_fields(packet: Any) -> bool:
    """Whether a packet is a structured array with fields t, x, y and p."""
    if not isinstance(packet, np.ndarray) or packet.ndim != 1:
        return False
    return {"t", "x", "y", "p"} <= set(packet.dtype.names or ())


def wait_until(deadline_ns: float) -> None:
    """Sleep until `time.monotonic_ns()` reaches the deadline.

    No core is kept busy, at the price of waking 0.1 ms late.
    """
    left_ns = deadline_ns - time.monotonic_ns()
    while left_ns > 0:
        time.sleep(min(left_ns / 1e9, LONGEST_S))
        left_ns = deadline_ns - time.monotonic_ns()
