"""What the reader of a format provides: a source of blocks of events, which starts again at every
pass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from async_tnt.base.checks import short
from async_tnt.kernels.volume.records import MAX_TIME_US
from async_tnt.sources.files.off_sensor import WIDE_DTYPE
from async_tnt.volume.event_forms import Four, check_order
from async_tnt.volume.events import structured
from async_tnt.volume.sensor import Sensor, checked_sensor

BLOCK_EVENTS = 1 << 16
ONLY_ASCII = bytes(range(128)) + b"?" * 128


class DamagedRecording(UserWarning):
    """A recording is damaged: it was read up to the damage, and no further."""


class CorruptData(Exception):
    """Raised by a source that cannot continue, with what is wrong and where: "row 17: expected `t x
    y p`, got 'abc'".

    `Recording` turns it into a warning or a ValueError.
    """


@dataclass(frozen=True)
class ReadOptions:
    """What a caller knows of a file, for formats that do not state it; others do not use it.

    Parameters
    ----------
    sensor : (width, height) of the camera.
    columns : the order of four columns without names, such as "xypt".
    topic : the name of the topic to read, of a file with several.

    Raises
    ------
    ValueError : an impossible sensor; `columns` without each of t, x, y and p; a topic that is no
        name.
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
            raise ValueError(f"`topic` must be the name of a topic, got {short(self.topic)}")


@dataclass(frozen=True)
class Topic:
    """A stream of messages in a file that holds several.

    Parameters
    ----------
    name, type : such as "/event_camera/events" and "event_camera_msgs/msg/EventPacket".
    messages : how many there are.
    is_read : whether the events come from this one.
    """

    name: str
    type: str
    messages: int
    is_read: bool = False


class Source(ABC):
    """The events of one file, block by block. Holds no more than one block in memory.

    Attributes
    ----------
    sensor : (width, height) in pixels, or None where the file does not state it.
    format : the name of the file's format.
    sensor_hint : what may be wrong where many events lie off the sensor, for messages; "" where
        nothing is known.
    topics : all streams of messages in the file; empty for formats that have none.
    """

    sensor: Sensor | None = None
    format: str = ""
    sensor_hint: str = ""
    topics: tuple[Topic, ...] = ()

    @abstractmethod
    def blocks(self) -> Iterator[np.ndarray]:
        """Structured arrays of `EVENT_DTYPE` in the order of the file; the source does not use them
        again.

        Where a pixel of a block does not fit `EVENT_DTYPE`, the block is of `WIDE_DTYPE`. Whether
        pixels lie on the sensor is not the source's business: `Recording` leaves out those that do
        not.

        Raises
        ------
        CorruptData : reading cannot continue. All events before that place have been yielded.
        OSError : the file is missing or not readable.
        """

    def check_first(self) -> None:
        """Raise `CorruptData` if not even one event can be read: the file is then of another
        format."""
        for block in self.blocks():
            if len(block):
                return


class ArraySource(Source):
    """Events that are in memory already."""

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
    """Columns of any integer type as events, up to the first with an impossible time or polarity.

    Returns
    -------
    The events before that one, of `EVENT_DTYPE` or, if a pixel does not fit it, of `WIDE_DTYPE`;
    and what is wrong with that one ("": nothing is wrong with any).
    """
    off = (p == 0) | (p == -1) if p.dtype.kind == "i" else p == 0
    bad = (t < 0) | (t >= MAX_TIME_US) | ~(off | (p == 1))
    n = int(np.argmax(bad)) if bad.any() else len(t)
    problem = (
        ""
        if n == len(t)
        else f"t = {t[n]}, x = {x[n]}, y = {y[n]}, p = {p[n]} is not a valid event"
    )
    if _fits(x[:n]) and _fits(y[:n]):
        return structured((t, x, y, ~off), n), problem
    x, y = (np.minimum(pixel, MAX_TIME_US) for pixel in (x, y))  # a uint64 beyond int64 would wrap
    return structured((t, x, y, ~off), n, WIDE_DTYPE), problem


def _fits(pixel: np.ndarray) -> bool:
    """Whether all of these coordinates fit `EVENT_DTYPE`."""
    if pixel.dtype.kind != "b" and pixel.size:
        return int(pixel.min()) >= 0 and int(pixel.max()) < 1 << 16
    return True


def valid_blocks(blocks: Iterable[Four]) -> Iterator[np.ndarray]:
    """Blocks of columns t, x, y, p as events, up to the first invalid one.

    Raises
    ------
    CorruptData : at that event; or polarity is 0/1 at first, and then -1/+1, or the reverse.
    """
    off: int | None = None  # how this file writes OFF: 0 or -1; None before the first
    n_before = 0
    for columns in blocks:
        events, problem = valid_events(*columns)
        p = columns[3][: len(events)]
        if off is None and (p < 1).any():
            off = int(p[int(np.argmax(p < 1))])
        if off is not None and (mixed := p == -1 - off).any():
            events = events[: int(np.argmax(mixed))]
            problem = f"p = {-1 - off}, and before it {off}: polarity is 0/1 or -1/+1, not both"
        yield events
        n_before += len(events)
        if problem:
            raise CorruptData(f"event {n_before}: {problem}")


def is_text(line: bytes) -> bool:
    """Whether a line of a header is text; binary data that follows hardly is. Programs write in the
    encoding of their system: a few bytes may be anything."""
    if 8 * sum(byte > 0x7F for byte in line) <= len(line):
        line = line.translate(ONLY_ASCII)
    try:
        return line.decode().replace("\t", " ").replace("\xa0", " ").isprintable()
    except UnicodeDecodeError:
        return False


def gathered(blocks: Iterable[np.ndarray], n: int = BLOCK_EVENTS) -> Iterator[np.ndarray]:
    """The same events in blocks of at least `n`, but for the last; what `blocks` raises comes after
    all events."""
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
