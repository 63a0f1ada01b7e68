"""Bags of ROS 1 and ROS 2.

The package rosbags writes them from the public definitions of their messages.

Nothing here is taken from the reader, which unpacks messages by itself.
"""

import shutil
import struct
import tempfile
from pathlib import Path

import numpy as np
import pytest

EVENT_PACKET = "event_camera_msgs/msg/EventPacket"
EVENT_ARRAY = "dvs_msgs/msg/EventArray"
DEFINITIONS = {
    EVENT_PACKET: "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\n"
    "uint64 time_base\nstring encoding\nbool is_bigendian\nuint8[] events\n",
    "dvs_msgs/msg/Event": "uint16 x\nuint16 y\n{time} ts\nbool polarity\n",
    EVENT_ARRAY: "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n",
    "std_msgs/msg/Text": "string data\n",
}
"""Type of a message -> its public definition."""

OTHER = "std_msgs/msg/Text"
"""A type of messages without events."""

STAMP_S = 1_700_000_000
"""Stamp of all messages, in seconds, which readers do not use."""


class Bag:
    """Writes one bag, in a `with` statement.

    Parameters
    ----------
    path : a `.bag` is of ROS 1; `.db3` and `.mcap` are of ROS 2, whose folder and metadata are left
        out.
    compressed : compress chunks of ROS 1, or each message of ROS 2.
    is_big : whether the numbers of ROS 2 begin with their highest byte.
    """

    def __init__(self, path, compressed=False, is_big=False):
        pytest.importorskip("rosbags", reason="ROS bags need rosbags")
        from rosbags import rosbag1, rosbag2, typesys

        self.path = path
        self.is_ros_1 = path.suffix == ".bag"
        self.is_big = is_big
        store = typesys.Stores.ROS1_NOETIC if self.is_ros_1 else typesys.Stores.ROS2_HUMBLE
        self.types = typesys.get_typestore(store)
        time = "time" if self.is_ros_1 else "builtin_interfaces/Time"
        for name, text in DEFINITIONS.items():
            self.types.register(typesys.get_types_from_msg(text.format(time=time), name))
        self._folder = Path(tempfile.mkdtemp(dir=path.parent))
        if self.is_ros_1:
            self._writer = rosbag1.Writer(self._folder / "made.bag")
            if compressed:
                self._writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
        else:
            plugin = rosbag2.StoragePlugin.SQLITE3
            if path.suffix == ".mcap":
                plugin = rosbag2.StoragePlugin.MCAP
            self._writer = rosbag2.Writer(self._folder / "made", version=9, storage_plugin=plugin)
            if compressed:
                self._writer.set_compression(
                    rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD
                )
        self._connections = {}
        self._n_written = 0

    def __enter__(self):
        self._writer.open()
        return self

    def __exit__(self, *error):
        self._writer.close()
        files = self._folder.rglob("*")
        (made,) = [path for path in files if path.suffix in (".bag", ".db3", ".mcap")]
        made.replace(self.path)
        shutil.rmtree(self._folder)

    def header(self, frame="camera"):
        stamp = self.types.types["builtin_interfaces/msg/Time"](STAMP_S, 5)
        number = [7] if self.is_ros_1 else []
        return self.types.types["std_msgs/msg/Header"](*number, stamp, frame)

    def connect(self, topic, kind, **who):
        """Begin a connection, by which the messages of this topic and type are sent from now on."""
        self._connections[topic, kind] = self._writer.add_connection(
            topic, kind, typestore=self.types, **who
        )

    def send(self, topic, kind, *fields):
        """Write one message, of these fields in the order of its definition."""
        key = topic, kind
        if key not in self._connections:
            self.connect(topic, kind)
        self._write(self._connections[key], self.data_of(kind, *fields))

    def data_of(self, kind, *fields):
        """The bytes of a message of these fields."""
        message = self.types.types[kind](*fields)
        if self.is_ros_1:
            return bytes(self.types.serialize_ros1(message, kind))
        return bytes(self.types.serialize_cdr(message, kind, little_endian=not self.is_big))

    def send_bytes(self, data):
        """Write these bytes as a message of the only topic so far."""
        (connection,) = self._connections.values()
        self._write(connection, data)

    def _write(self, connection, data):
        self._n_written += 1
        self._writer.write(connection, STAMP_S * 10**9 + self._n_written, data)

    def packet(
        self,
        words,
        sensor,
        *,
        topic="/camera/events",
        encoding="evt3",
        time_base=12_345,
        order="<",
        frame="c",
    ):
        """An EventPacket of 16-bit words."""
        data = np.frombuffer(np.array(words, f"{order}u2").tobytes(), np.uint8)
        width, height = sensor
        is_big = order == ">"
        fields = (self.header(frame), height, width, 3, time_base, encoding, is_big, data)
        self.send(topic, EVENT_PACKET, *fields)

    def array(self, events, sensor, *, topic="/camera/events", frame="c"):
        """An EventArray of events as `made_events` makes them."""
        time = self.types.types["builtin_interfaces/msg/Time"]
        event = self.types.types["dvs_msgs/msg/Event"]
        rows = [
            event(x, y, time(t // 10**6, t % 10**6 * 1_000), bool(p))
            for t, x, y, p in events.tolist()
        ]
        self.send(topic, EVENT_ARRAY, self.header(frame), sensor[1], sensor[0], rows)


def parts_of(values, n=7):
    """Cut into messages of unequal sizes, at least one; some are empty."""
    ends = np.sort(np.random.default_rng(0).integers(0, len(values) + 1, n))
    return np.split(np.asarray(values), [*ends, ends[-1]])


def evt3_bag(path, words, sensor):
    """Words of EVT3, cut anywhere."""
    with Bag(path) as bag:
        for k, part in enumerate(parts_of(words)):
            bag.packet(part, sensor, order="<>"[k % 2], frame="c" * k)


def array_bag(path, events, sensor):
    with Bag(path) as bag:
        for k, part in enumerate(parts_of(events)):
            bag.array(part, sensor, frame="c" * k)


def libcaer_words(events):
    """Words of one message, whose time base is 0; every third event as a vector of one."""
    words = []
    high = None
    low = None
    column = None
    for i, (t, x, y, p) in enumerate(events.tolist()):
        if t >> 12 != high:
            high = t >> 12
            words.append(high)
        if t & 4095 != low:
            low = t & 4095
            words.append(1 << 12 | low)
        if x != column:
            column = x
            words.append(2 << 12 | x)
        # Every third event has a base and empty vectors before it.
        if i % 3 == 0:
            n_before = min(y // 8, 2)
            base = max(0, y - 8 * n_before - 7)
            words += [
                4 << 12 | p << 11 | base,
                *([5 << 12] * n_before),
                5 << 12 | 1 << (y - base - 8 * n_before),
            ]
        else:
            words.append(3 << 12 | p << 11 | y)
    return words


def libcaer_bag(path, events, sensor):
    """Each message has a time base of its own."""
    with Bag(path) as bag:
        for part in parts_of(events):
            base_us = int(part["t"][0]) if len(part) else 0
            part = part.copy()
            part["t"] -= base_us
            time_base = base_us * 1_000 + 999  # nanoseconds, which are rounded down
            bag.packet(libcaer_words(part), sensor, encoding="libcaer_cmp", time_base=time_base)


def unpacked(words):
    """16-bit words of a file's bytes."""
    return struct.unpack(f"<{len(words) // 2}H", words)
