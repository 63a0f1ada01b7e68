"""The source of blocks of events that the reader of a format provides.

A source starts again at every pass.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.kernels.volume.records import MAX_TIME_US
from async_tnt.sources.files.off_sensor import WIDE_DTYPE
from async_tnt.volume.event_forms import Four, check_order
from async_tnt.volume.events import structured
from async_tnt.volume.sensor import Sensor, checked_sensor

BLOCK_EVENTS = 1 << 16
"""Number of events that are read together."""

MAX_SIDE = 1 << 16
"""Pixels of the longest side that a file may state."""

ONLY_ASCII = bytes(range(128)) + b"?" * 128
"""Table for `bytes.translate` that replaces bytes that are not ASCII."""


class DamagedRecording(UserWarning):
    """A recording is damaged: it was read up to the damage, and no further."""


class CorruptData(Exception):
    """The error of a source that cannot continue.

    Its message says what is wrong and where, such as "row 17: expected `t x y p`, got 'abc'".
    `Recording` turns it into a warning or a ValueError.
    """


@dataclass(frozen=True)
class ReadOptions:
    """Facts about a file that the caller states. They are not used if the file states them.

    Parameters
    ----------
    sensor : (width, height) of the camera.
    columns : order of four columns without names, such as "xypt".
    topic : name of the topic to read from a file with several.

    Raises
    ------
    ParameterValueError : `sensor` is impossible; `columns` does not have each of t, x, y and p; or
        `topic` is no name.
    """

    sensor: Sensor | None = None
    columns: str | None = None
    topic: str | None = None

    def __post_init__(self) -> None:
        if self.sensor is not None:
            object.__setattr__(self, "sensor", checked_sensor(self.sensor))
        if self.columns is not None:
            check_order("columns", self.columns)
        if self.topic is not None and (not isinstance(self.topic, str) or not self.topic):
            raise ParameterValueError("topic", "must be the name of a topic", short(self.topic))


@dataclass(frozen=True)
class Topic:
    """A stream of messages in a file that holds several.

    Parameters
    ----------
    name : name of the topic, such as "/event_camera/events".
    type : type of its messages, such as "event_camera_msgs/msg/EventPacket".
    messages : number of its messages.
    is_read : whether the events come from this topic.
    """

    name: str
    type: str
    messages: int
    is_read: bool = False


class Source(ABC):
    """The events of one file, block by block. Holds no more than one block in memory.

    The function that opens a file, mostly the class itself called with (path, options), reads only
    the header. If the file cannot be understood, the function raises a ValueError of one line,
    `path: what is wrong`. Such a file does not begin as the format does, its header is missing or
    cut off, or its sensor does not have 1 to `MAX_SIDE` pixels a side. The error is never a
    `ParameterError`, which is about the caller's parameters. For damage behind the header, `blocks`
    raises a `CorruptData`.

    Attributes
    ----------
    sensor : (width, height) in pixels, or None where the file does not state it.
    format : the name of the file's format.
    sensor_hint : what may be wrong if events lie off the sensor: the end of a message, in which
        names of parameters stand in braces. "" if nothing is known.
    topics : all streams of messages in the file; empty for formats that have none.
    """

    sensor: Sensor | None = None
    format: str = ""
    sensor_hint: str = ""
    topics: tuple[Topic, ...] = ()

    @abstractmethod
    def blocks(self) -> Iterator[np.ndarray]:
        """The events of the file, in its order, as structured arrays of `EVENT_DTYPE`.

        A block is of `WIDE_DTYPE` if one of its pixels does not fit `EVENT_DTYPE`. The source need
        not check whether pixels lie on the sensor: `Recording` leaves out the events off it. The
        source does not use a block again.

        Raises
        ------
        CorruptData : reading cannot continue. All events before that place have been yielded.
        OSError : the file is missing or not readable.
        """

    def check_first(self) -> None:
        """Read the first event.

        Raises
        ------
        CorruptData : not even one event can be read; the file has another format.
        """
        for block in self.blocks():
            if len(block):
                return


class ArraySource(Source):
    """The source of events that are in memory already."""

    def __init__(self, events: np.ndarray, sensor: Sensor | None, format: str) -> None:
        self.events = events
        self.sensor = sensor
        self.format = format

    def blocks(self) -> Iterator[np.ndarray]:
        for start in range(0, len(self.events), BLOCK_EVENTS):
            yield self.events[start : start + BLOCK_EVENTS]


def valid_events(
    t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, str]:
    """Columns of any integer type as events, up to the first invalid event.

    An event is invalid if its time or its polarity is impossible. Any pixel is valid here.

    Returns
    -------
    The events before the first invalid event, of `EVENT_DTYPE` or, if a pixel does not fit it, of
    `WIDE_DTYPE`; and a text that says what is wrong with the invalid event, "" if all are valid.
    """
    is_off = p == 0
    if p.dtype.kind == "i":
        is_off |= p == -1
    is_invalid = (t < 0) | (t >= MAX_TIME_US) | ~(is_off | (p == 1))
    n = len(t)
    problem = ""
    if is_invalid.any():
        n = int(np.argmax(is_invalid))
        problem = f"t = {t[n]}, x = {x[n]}, y = {y[n]}, p = {p[n]} is not a valid event"
    if _fits(x[:n]) and _fits(y[:n]):
        return structured((t, x, y, ~is_off), n), problem

    return structured((t, _within_int64(x), _within_int64(y), ~is_off), n, WIDE_DTYPE), problem


def _fits(pixel: np.ndarray) -> bool:
    """Whether all of these coordinates fit `EVENT_DTYPE`."""
    if pixel.dtype.kind != "b" and pixel.size:
        return int(pixel.min()) >= 0 and int(pixel.max()) < 1 << 16
    return True


def _within_int64(pixel: np.ndarray) -> np.ndarray:
    """Coordinates that int64 can hold: larger coordinates, which would wrap, become 2**62."""
    return np.minimum(pixel, MAX_TIME_US) if pixel.dtype == np.uint64 else pixel


def valid_blocks(blocks: Iterable[Four]) -> Iterator[np.ndarray]:
    """Blocks of columns t, x, y, p as events, up to the first invalid event.

    Raises
    ------
    CorruptData : an event is invalid; or polarity changes from 0/1 to -1/+1, or the reverse.
    """
    # the number that this file writes for OFF, 0 or -1; None before the first OFF event
    off: int | None = None
    n_before = 0
    for columns in blocks:
        events, problem = valid_events(*columns)
        p = columns[3][: len(events)]
        if off is None and (p < 1).any():
            off = int(p[int(np.argmax(p < 1))])
        if off is not None:
            other_off = -1 - off  # -1 for 0, and 0 for -1
            is_other_off = p == other_off
            if is_other_off.any():
                events = events[: int(np.argmax(is_other_off))]
                problem = (
                    f"p = {other_off}, and before it {off}: polarity is 0/1 or -1/+1, not both"
                )
        yield events
        n_before += len(events)
        if problem:
            raise CorruptData(f"event {n_before}: {problem}")


def is_text(line: bytes) -> bool:
    """Whether a line of a header is text. Binary data that follows a header is hardly ever text.

    Programs write in the encoding of their system. So up to one byte in eight may lie outside
    ASCII, and its meaning does not matter. A line with more such bytes must be valid UTF-8.
    """
    if 8 * sum(byte > 0x7F for byte in line) <= len(line):
        line = line.translate(ONLY_ASCII)
    try:
        return line.decode().replace("\t", " ").replace("\xa0", " ").isprintable()
    except UnicodeDecodeError:
        return False


def gathered(blocks: Iterable[np.ndarray], n: int = BLOCK_EVENTS) -> Iterator[np.ndarray]:
    """The same events in larger blocks: each has at least `n` events, except the last one.

    If `blocks` raises a `CorruptData`, it is raised here after all events that came before it.
    """
    waiting: list[np.ndarray] = []
    n_waiting = 0
    damage: CorruptData | None = None
    try:
        for block in blocks:
            waiting.append(block)
            n_waiting += len(block)
            if n_waiting >= n:
                yield waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
                waiting = []
                n_waiting = 0
    except CorruptData as error:
        damage = error
    if n_waiting:
        yield np.concatenate(waiting)
    if damage is not None:
        raise damage
