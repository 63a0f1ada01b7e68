"""The reader of ROS bags in a worker process: their topics, and the messages of one of them.

The library rosbags opens the bag. The worker imports this module, which must import nothing that
takes time. A bag is of ROS 1 (`.bag`), or a storage file of ROS 2 (`.db3`, `.mcap`), which is read
without the `metadata.yaml` beside it. Two types of messages hold events:

event_camera_msgs/EventPacket   bytes in an encoding that the message names: `evt3`, of Prophesee's
                                cameras, or `libcaer_cmp`, of iniVation's; others are refused
dvs_msgs/EventArray             an array of x, y, ts, polarity

Messages are unpacked here, by these two layouts, rather than by code that rosbags makes from the
bag's own text. All numbers of ROS 1 follow one another in little-endian order. ROS 2 has CDR, in
which each number begins at a multiple of its own size, and the first bytes name the order.

    Header         ROS 1: seq u32, sec u32, nsec u32, frame_id; ROS 2: sec i32, nanosec u32,
                   frame_id
    EventPacket    Header, height u32, width u32, seq u64, time_base u64, encoding,
                   is_bigendian u8, events: bytes
    EventArray     Header, height u32, width u32, events: x u16, y u16, sec, nsec, polarity u8

Texts and arrays begin with their length, u32. `libcaer_cmp` has words of 16 bits, in each message
from its start:

    bits 15-12     bits 11-0
    0 TIME_HIGH    bits 23-12 of the time in microseconds since `time_base`, which is in nanoseconds
    1 TIME_LOW     bits 11-0 of this time
    2 ADDR_X       x (11 bits) of the events that follow
    3 ADDR_Y       one event: polarity (bit 11), y (11 bits)
    4 VECT_BASE_Y  polarity (bit 11), y (11 bits) of the vectors that follow
    5 VECT_8       bits 7-0: eight pixels, bit 0 is the one at the base; then the base is 8 higher

References
----------
ros-event-camera/event_camera_msgs: EventPacket.msg; event_camera_codecs: libcaer_cmp_types.h.
uzh-rpg/rpg_dvs_ros: dvs_msgs, Event.msg and EventArray.msg.
Object Management Group, Common Object Request Broker Architecture: CDR transfer syntax.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from async_tnt.sources.files.source_error import SourceError

EVENT_PACKET = "event_camera_msgs/msg/EventPacket"
EVENT_ARRAY = "dvs_msgs/msg/EventArray"
MESSAGE_TYPES = (EVENT_PACKET, EVENT_ARRAY)
"""Types of messages that hold events."""

BAG_1 = b"#ROSBAG V"
"""First bytes of a bag of ROS 1."""

MCAP = b"\x89MCAP0\r\n"
"""First bytes of an MCAP file."""

SQLITE = b"SQLite format 3\0"
"""First bytes of an SQLite file."""

ZSTANDARD = b"\x28\xb5\x2f\xfd"
"""First bytes of a message that was compressed by itself; CDR begins with zeros."""

BLOCK_BYTES = 1 << 17
"""Bytes of events after which the messages so far are sent together."""

BLOCK_MESSAGES = 1_000
"""The most messages that are sent together. Messages without events never reach BLOCK_BYTES."""

MAX_SIDE = 1 << 16
"""Pixels of the longest side that a message may state."""

MAX_TIME_NS = 1 << 62
"""Nanoseconds below which `time_base` must be."""

# Kinds of words in `libcaer_cmp`.
TIME_HIGH = 0
TIME_LOW = 1
ADDR_X = 2
ADDR_Y = 3
VECT_BASE_Y = 4
VECT_8 = 5

CDR_HEADER_BYTES = 4
"""Bytes before the first field of a message in CDR."""

CDR_PADDING_BYTES = 3
"""The most bytes without a meaning at the end of a message in CDR."""

CDR_EVENT_BYTES = 16
"""Bytes from the start of an event of an EventArray in CDR to the start of the next event."""

ROS_1_EVENT = np.dtype([("x", "<u2"), ("y", "<u2"), ("sec", "<u4"), ("nsec", "<u4"), ("p", "u1")])
"""An event of an EventArray in ROS 1."""

Block = tuple[int, list[np.ndarray]]
"""Number of messages, and their events: four columns t, x, y, p, or one array of EVT3 words."""

Message = tuple[tuple[int, int] | None, list[np.ndarray]]
"""The sensor, (width, height) or None, and the events, as in a `Block`."""


def read_bag(path: str, topic: str | None) -> Iterator[Any]:
    """The sensor and the topics of a bag, then the messages of one topic.

    Parameters
    ----------
    topic : name of the topic to read; None: the only topic that has events.

    Yields
    ------
    First the sensor, (width, height) or None, and all topics as (name, type, messages, whether it
    is read); then `Block` values.
    """
    bag, is_ros_1 = _open(path)
    try:
        counts = _message_counts(bag.connections)
        wanted = _chosen_topic(counts, topic)
        topics = [
            (name, kind, n, name == wanted and kind in MESSAGE_TYPES)
            for (name, kind), n in sorted(counts.items())
        ]
        connections = [
            connection
            for connection in bag.connections
            if connection.topic == wanted and connection.msgtype in MESSAGE_TYPES
        ]
        messages = _messages(bag, connections, is_ros_1)
        first = next(messages, None)
        yield None if first is None else first[0], topics
        if first is not None:
            yield from _blocks(first, messages)
    finally:
        bag.close()


def _open(path: str) -> tuple[Any, bool]:
    """The opened bag, and whether it is of ROS 1."""
    with open(path, "rb") as file:
        first_bytes = file.read(len(SQLITE))
    if first_bytes.startswith(BAG_1):
        from rosbags.rosbag1 import Reader as Reader1

        bag: Any = Reader1(path)
    else:
        from rosbags.rosbag2 import Reader as Reader2

        if first_bytes == SQLITE:
            # quoted, as the path becomes a part of a URI
            bag = Reader2.STORAGE_PLUGINS[".db3"](Path(quote(path)))
        elif first_bytes.startswith(MCAP):
            bag = Reader2.STORAGE_PLUGINS[".mcap"](Path(path))
        else:
            raise ValueError(
                "it must begin as a bag of ROS 1, an SQLite or an MCAP file does, got "
                f"{first_bytes!r}"
            )
    bag.open()
    return bag, first_bytes.startswith(BAG_1)


def _message_counts(connections: list[Any]) -> dict[tuple[str, str], int]:
    """The number of messages of each topic, by its name and type."""
    counts: dict[tuple[str, str], int] = {}
    for connection in connections:
        key = (connection.topic, connection.msgtype)
        counts[key] = counts.get(key, 0) + connection.msgcount
    return counts


def _chosen_topic(counts: dict[tuple[str, str], int], topic: str | None) -> str:
    """The name of the topic to read.

    Parameters
    ----------
    counts : name and type of each topic -> the number of its messages.
    topic : see `read_bag`.

    Raises
    ------
    ValueError : no topic has events.
    SourceError : several topics have events and none is chosen, or the chosen topic has no events.
        The message lists the topics.
    """
    with_events = [name for name, kind in sorted(counts) if kind in MESSAGE_TYPES]
    descriptions = [f"{name} ({kind}, {n} messages)" for (name, kind), n in sorted(counts.items())]
    topic_list = ", ".join(descriptions) or "none"
    if not with_events:
        raise ValueError(
            f"it must have a topic of {' or '.join(MESSAGE_TYPES)}; its topics are: {topic_list}"
        )
    if topic is None and len(with_events) > 1:
        rule = f"several topics have events, choose one by {{topic}}: {', '.join(with_events)}"
        raise SourceError("", rule)
    wanted = with_events[0] if topic is None else topic
    if wanted not in with_events:
        raise SourceError(
            "",
            f"{{topic}} must be one of {', '.join(with_events)}, got {wanted!r}; all topics: "
            f"{topic_list}",
        )
    return wanted


def _messages(bag: Any, connections: list[Any], is_ros_1: bool) -> Iterator[Message]:
    """The messages in the order of their recording."""
    for number, (connection, _, data) in enumerate(bag.messages(connections)):
        unpack = _event_packet if connection.msgtype == EVENT_PACKET else _event_array
        try:
            if not is_ros_1 and bytes(data[:4]) == ZSTANDARD:
                data = _decompressed(data)
            yield unpack(_Cursor(data, is_ros_1))
        except (ValueError, struct.error) as error:
            raise ValueError(f"message {number}: {error}") from None


def _blocks(first: Message, others: Iterator[Message]) -> Iterator[Block]:
    """Blocks of several messages. After an error, the messages before it are sent first."""
    sensor, events = first
    waiting = [events]
    n_bytes = sum(column.nbytes for column in events)
    try:
        for number, (other_sensor, events) in enumerate(others, 1):
            if other_sensor != sensor:
                raise ValueError(
                    f"message {number}: of {other_sensor} pixels, but those before of {sensor}"
                )
            is_full = n_bytes >= BLOCK_BYTES or len(waiting) >= BLOCK_MESSAGES
            is_other_encoding = len(events) != len(waiting[0])
            if is_full or is_other_encoding:
                yield _joined(waiting)
                waiting = []
                n_bytes = 0
            waiting.append(events)
            n_bytes += sum(column.nbytes for column in events)
    except BaseException:
        yield _joined(waiting)
        raise
    yield _joined(waiting)


def _joined(messages: list[list[np.ndarray]]) -> Block:
    """The events of several messages, end to end."""
    return len(messages), [np.concatenate(columns) for columns in zip(*messages, strict=True)]


def _decompressed(data: bytes) -> bytes:
    """A message that Zstandard has compressed."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    try:
        return bytes(zstd.decompress(data))
    except zstd.ZstdError as error:
        raise ValueError(str(error)) from None


class _Cursor:
    """Reads the fields of a message, one after another."""

    def __init__(self, data: bytes, is_ros_1: bool) -> None:
        self.is_ros_1 = is_ros_1
        self.order = "<"
        self._start = 0
        if not is_ros_1:
            if len(data) < CDR_HEADER_BYTES or data[0] or data[1] > 1:
                raise ValueError(
                    f"it must begin as CDR, with two bytes of 0, 0 or 0, 1, got {list(data[:2])}"
                )
            self.order = "<" if data[1] else ">"
            self._start = CDR_HEADER_BYTES
        self._data = data
        self.place = self._start

    def align(self, size: int) -> None:
        """Go to the next multiple of `size`, where a number of this size begins in CDR."""
        if not self.is_ros_1:
            self.place += (self._start - self.place) % size

    def number(self, code: str) -> int:
        """A whole number, by its letter in `struct`."""
        size = struct.calcsize(f"<{code}")
        self.align(size)
        (value,) = struct.unpack_from(self.order + code, self._data, self.place)
        self.place += size
        return int(value)

    def bytes(self, n: int) -> bytes:
        """The next `n` bytes."""
        data = bytes(self._data[self.place : self.place + n])
        if len(data) < n:
            raise ValueError(
                f"it has {len(self._data)} bytes, {n - len(data)} too few for its arrays"
            )
        self.place += n
        return data

    def end(self) -> None:
        """Refuse bytes after the last field. CDR may end with up to three."""
        n_left = len(self._data) - self.place
        n_allowed = 0 if self.is_ros_1 else CDR_PADDING_BYTES
        if n_left > n_allowed:
            raise ValueError(
                f"it has {n_left} bytes more than its fields; its type has been changed"
            )


def _read_sensor(cursor: _Cursor) -> tuple[int, int] | None:
    """Read a message up to the end of its sides, and return them: (width, height).

    None if both are 0, which means that they are not known.
    """
    if cursor.is_ros_1:
        cursor.number("I")  # seq
    cursor.number("I")  # seconds and nanoseconds of the message
    cursor.number("I")
    cursor.bytes(cursor.number("I"))  # frame_id
    height = cursor.number("I")
    width = cursor.number("I")
    if not width and not height:
        return None
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ValueError(
            f"a sensor must have 1 to {MAX_SIDE} pixels a side, got {width} x {height}"
        )
    return width, height


def _event_packet(cursor: _Cursor) -> Message:
    """The sensor and the events of an EventPacket: the words of EVT3, or columns.

    `time_base` does not change the times of EVT3.
    """
    sensor = _read_sensor(cursor)
    cursor.number("Q")  # seq
    time_base_ns = cursor.number("Q")
    encoding = cursor.bytes(cursor.number("I")).rstrip(b"\0").decode("utf-8", "backslashreplace")
    order = ">" if cursor.number("B") else "<"
    data = cursor.bytes(cursor.number("I"))
    cursor.end()
    if encoding not in ("evt3", "libcaer_cmp"):
        raise ValueError(f"events must be encoded as evt3 or libcaer_cmp, got {encoding[:40]!r}")
    if encoding == "libcaer_cmp" and time_base_ns >= MAX_TIME_NS:
        raise ValueError(f"`time_base` must be below 2**62 ns, got {time_base_ns}")
    if len(data) % 2:
        raise ValueError(f"{encoding} has words of two bytes, got {len(data)} bytes")
    words = np.frombuffer(data, f"{order}u2").astype("<u2")
    if encoding == "evt3":
        return sensor, [words]
    return sensor, _libcaer_events(words.astype(np.int64), time_base_ns)


def _libcaer_events(words: np.ndarray, time_base_ns: int) -> list[np.ndarray]:
    """The columns t, x, y, p of one message in `libcaer_cmp`.

    Events before the first ADDR_X, and vectors before the first VECT_BASE_Y, have no place and are
    left out.
    """
    kind = words >> 12
    value = words & 0xFFF
    is_event = kind == ADDR_Y
    is_vector = kind == VECT_8
    # has_pixel[i, k]: whether word i has an event k pixels above its y
    has_pixel = np.zeros((len(words), 8), bool)
    has_pixel[is_event, 0] = True
    has_pixel[is_vector] = value[is_vector, None] >> np.arange(8) & 1
    time_us = _latest(value, kind == TIME_HIGH) << 12 | _latest(value, kind == TIME_LOW)

    # Each vector after a base moves the base by 8 pixels. So a vector lies 8 pixels above its base
    # for each vector between the two. The word itself does not count.
    n_vectors_before = np.cumsum(is_vector) - is_vector
    is_base = kind == VECT_BASE_Y
    base_value = _latest(value, is_base)
    y = np.where(is_event, value, base_value) & 0x7FF
    n_since_base = n_vectors_before - _latest(n_vectors_before, is_base)
    y += np.where(is_vector, 8 * n_since_base, 0)
    polarity = np.where(is_event, value, base_value) >> 11

    # events without a place, before the first ADDR_X or the first base
    has_pixel &= (np.cumsum(kind == ADDR_X) > 0)[:, None]
    has_pixel[is_vector] &= (np.cumsum(is_base) > 0)[is_vector, None]
    row, pixel = np.nonzero(has_pixel)
    x = _latest(value, kind == ADDR_X) & 0x7FF
    return [time_base_ns // 1_000 + time_us[row], x[row], y[row] + pixel, polarity[row]]


def _latest(values: np.ndarray, is_new: np.ndarray) -> np.ndarray:
    """For each place, the value at the latest place, up to this one, where `is_new` is True.

    It is 0 before the first such place.
    """
    place = np.maximum.accumulate(np.where(is_new, np.arange(len(values)), -1))
    return np.where(place >= 0, values[place], 0)


def _event_array(cursor: _Cursor) -> Message:
    """The sensor and the columns t, x, y, p of an EventArray.

    Times in nanoseconds become microseconds, to the nearest one.
    """
    sensor = _read_sensor(cursor)
    n_events = cursor.number("I")
    columns = _ros_1_events(cursor, n_events) if cursor.is_ros_1 else _cdr_events(cursor, n_events)
    cursor.end()
    sec, nsec, x, y, p = [column.astype(np.int64) for column in columns]
    return sensor, [sec * 1_000_000 + (nsec + 500) // 1_000, x, y, p]


def _ros_1_events(cursor: _Cursor, n_events: int) -> list[np.ndarray]:
    """Columns sec, nsec, x, y, p of events of 13 bytes."""
    table = np.frombuffer(cursor.bytes(n_events * ROS_1_EVENT.itemsize), ROS_1_EVENT)
    return [table[name] for name in ("sec", "nsec", "x", "y", "p")]


def _cdr_events(cursor: _Cursor, n_events: int) -> list[np.ndarray]:
    """Columns sec, nsec, x, y, p of events in CDR, which begin at a multiple of 4.

    Bytes 0 to 3 of the first event are x and y; 4 to 12 are sec, nsec and p. As p has one byte, the
    second event's x begins at the next even place, 14, and its y at 16. Its sec must begin at a
    multiple of 4, which is 20. So the events are rows of 16 bytes, and each x except the first is
    in the row before.
    """
    if n_events == 0:
        return [np.zeros(0, np.int64)] * 5
    cursor.align(4)
    # the last event ends with p, three bytes before the end of its row
    data = cursor.bytes(n_events * CDR_EVENT_BYTES - 3)
    order = cursor.order
    row = np.dtype(
        {
            "names": ["y", "first y", "sec", "nsec", "p", "next x"],
            "formats": [f"{order}u2", f"{order}u2", f"{order}i4", f"{order}u4", "u1", f"{order}u2"],
            "offsets": [0, 2, 4, 8, 12, 14],
            "itemsize": CDR_EVENT_BYTES,
        }
    )
    table = np.frombuffer(data + bytes(3), row)
    # the first row has x and y at the places of "y" and "first y"
    x = np.concatenate([table["y"][:1], table["next x"][:-1]])
    y = np.concatenate([table["first y"][:1], table["y"][1:]])
    return [table["sec"], table["nsec"], x, y, table["p"]]
