"""Bags of ROS: messages by hand, which topic is read, what is refused.

The laws of all formats hold for them, too.
"""

import re

import numpy as np
import pytest
from made import events_of
from sources.files.ros_written import EVENT_ARRAY, EVENT_PACKET, OTHER, Bag
from sources.files.written import made_events, written

from async_tnt.sources.files import ros_reader
from async_tnt.sources.files.off_sensor import EventsOffSensor
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording, Topic

SENSOR = (320, 240)
EVENTS = made_events(40)
# EVT3: TIME_HIGH 1, TIME_LOW 5, row 9, then x = 5 OFF and x = 6 ON
WORDS = [0x8001, 0x6005, 0x0009, 0x2005, 0x2806]
IN_TIME = [(4101, 5, 9, 0), (4101, 6, 9, 1)]
every_bag = pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])


def plainly_decoded(words):
    """The events of EVT3, word by word as its description says.

    The stream begins with its time and row.
    """
    events = []
    overflows = 0
    high = 0
    low = 0
    y = 0
    base = 0
    base_polarity = 0
    for word in words:
        kind = word >> 12
        value = word & 0xFFF
        if kind == 0x0:
            y = value & 0x7FF
        elif kind == 0x2:
            events.append((overflows << 24 | high << 12 | low, value & 0x7FF, y, value >> 11))
        elif kind == 0x3:
            base = value & 0x7FF
            base_polarity = value >> 11
        elif kind in (0x4, 0x5):
            length = 12 if kind == 0x4 else 8
            time = overflows << 24 | high << 12 | low
            events += [
                (time, base + bit, y, base_polarity) for bit in range(length) if value >> bit & 1
            ]
            base += length
        elif kind == 0x6:
            low = value
        elif kind == 0x8:
            overflows += value < high
            high = value
    return events


@every_bag
def test_messages_by_hand(tmp_path, name):
    """The words of a topic go on from message to message; `time_base` changes nothing."""
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS[:2], SENSOR)
        bag.packet(WORDS[2:3], SENSOR, time_base=1 << 63)
        bag.packet(WORDS[3:], SENSOR, order=">")
    recording = open_recording(tmp_path / name)
    assert recording.read().tolist() == IN_TIME
    assert recording.sensor == recording.stated_sensor == SENSOR and recording.format == "ROS bag"
    (topic,) = recording.source.topics
    assert (topic.name, topic.type, topic.messages, topic.is_read) == (
        "/camera/events",
        EVENT_PACKET,
        3,
        True,
    )


def test_a_topic_may_have_thousands_of_messages_and_change_its_encoding(tmp_path):
    """Most messages have no events.

    The words of EVT3 go on from message to message, whatever messages come between them.
    """
    with Bag(tmp_path / "a.mcap") as bag:
        bag.packet(WORDS[:3], SENSOR)
        for _ in range(2_500):
            bag.packet([], SENSOR)
        bag.packet(WORDS[3:4], SENSOR)
        bag.packet([0x2007, 0x3805], SENSOR, encoding="libcaer_cmp", time_base=8_000_000)
        bag.packet(WORDS[4:], SENSOR)
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.read().tolist() == [IN_TIME[0], (8_000, 7, 5, 1), IN_TIME[1]]
    assert recording.source.topics[0].messages == 2_504


@every_bag
def test_libcaer_words_by_hand(tmp_path, name):
    """Each message has a time of its own: 2 us and 999 ns are 2 us."""
    words = [
        0x3805,  # before the first x, an event has no place
        0x2807,  # x = 7; bit 11 says nothing
        0x3805,  # y = 5, ON, at the time base
        0x0001,  # TIME_HIGH 1
        0x1003,  # TIME_LOW 3
        0x5001,  # before the first base, a vector has no place
        0x4009,  # base 9, OFF
        0x5081,  # y = 9 and 16
        0x5001,  # y = 17: the base has moved by 8
        0x4864,  # base 100, ON
        0x5002,  # y = 101
    ]
    with Bag(tmp_path / name) as bag:
        bag.packet(words, SENSOR, encoding="libcaer_cmp", time_base=2_999)
        bag.packet([0x2001, 0x3002], SENSOR, encoding="libcaer_cmp", time_base=9_000_000)
    t = 2 + (1 << 12 | 3)
    expected = [
        (2, 7, 5, 1),
        (t, 7, 9, 0),
        (t, 7, 16, 0),
        (t, 7, 17, 0),
        (t, 7, 101, 1),
        (9_000, 1, 2, 0),
    ]
    assert open_recording(tmp_path / name).read().tolist() == expected


@pytest.mark.parametrize("kind", [EVENT_PACKET, EVENT_ARRAY])
def test_numbers_of_ros_2_may_begin_with_their_highest_byte(tmp_path, kind):
    with Bag(tmp_path / "a.mcap", is_big=True) as bag:
        if kind == EVENT_PACKET:
            bag.packet(WORDS, SENSOR)
        else:
            bag.array(events_of(*zip(*IN_TIME, strict=True)), SENSOR)
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.read().tolist() == IN_TIME and recording.sensor == SENSOR


@pytest.mark.parametrize("first", [(0, 2), (1, 1), (0,), ()])
def test_a_message_that_does_not_begin_as_cdr_is_damage(tmp_path, first):
    with Bag(tmp_path / "a.mcap") as bag:
        bag.packet(WORDS, SENSOR)
        fields = bag.header(), 240, 320, 0, 0, "evt3", False, np.zeros(0, np.uint8)
        data = bag.data_of(EVENT_PACKET, *fields)
        bag.send_bytes(bytes(first) + (data[2:] if len(first) == 2 else b""))
    recording = open_recording(tmp_path / "a.mcap")
    message = f"message 1: it must begin as CDR, .* got {re.escape(str(list(first)))}"
    with pytest.warns(DamagedRecording, match=message):
        assert recording.read().tolist() == IN_TIME


@every_bag
def test_the_stamps_of_an_event_array_become_the_nearest_microsecond(tmp_path, name):
    with Bag(tmp_path / name) as bag:
        time = bag.types.types["builtin_interfaces/msg/Time"]
        event = bag.types.types["dvs_msgs/msg/Event"]
        stamps = [
            (0, 1_499),
            (0, 1_500),
            (0, 999_999_499),
            (0, 999_999_500),
            (1_700_000_000, 5_000),
        ]
        rows = [event(3, 4, time(*stamp), True) for stamp in stamps]
        bag.send("/dvs/events", EVENT_ARRAY, bag.header(), 240, 320, rows)
    assert open_recording(tmp_path / name).read()["t"].tolist() == [
        1,
        2,
        999_999,
        1_000_000,
        1_700_000_000_000_005,
    ]


@every_bag
def test_the_only_topic_of_events_is_read_and_of_several_the_one_that_is_named(tmp_path, name):
    with Bag(tmp_path / name) as bag:
        bag.send("/chatter", OTHER, "hello")
        bag.packet(WORDS, SENSOR, topic="/left/events")
    recording = open_recording(tmp_path / name)
    assert recording.read().tolist() == IN_TIME
    assert [(topic.name, topic.is_read) for topic in recording.source.topics] == [
        ("/chatter", False),
        ("/left/events", True),
    ]
    other = tmp_path / f"two{name[1:]}"
    with Bag(other) as bag:
        bag.packet(WORDS, SENSOR, topic="/left/events")
        bag.send("/chatter", OTHER, "hello")
        bag.array(EVENTS, (400, 300), topic="/right/events")
        bag.packet(WORDS[3:4], SENSOR, topic="/left/events")
    with pytest.raises(
        ValueError, match=r"several topics .* choose one by `topic`: /left/events, /right/events"
    ):
        open_recording(other)
    assert open_recording(other, topic="/left/events").read().tolist() == [*IN_TIME, IN_TIME[0]]
    right = open_recording(other, topic="/right/events")
    np.testing.assert_array_equal(right.read(), EVENTS)
    assert right.sensor == (400, 300)
    assert [topic.name for topic in right.source.topics if topic.is_read] == ["/right/events"]
    for wrong in ("/chatter", "/middle"):
        message = (
            rf"`topic` must be one of /left/events, /right/events, got '{wrong}'; all topics: "
            r"/chatter \(std_msgs"
        )
        with pytest.raises(ValueError, match=message):
            open_recording(other, topic=wrong)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_messages_of_other_types_under_the_name_of_the_topic_are_not_read(tmp_path, name):
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS[:3], SENSOR)
        bag.send("/camera/events", OTHER, "hello")
        bag.packet(WORDS[3:], SENSOR)
    recording = open_recording(tmp_path / name, strict=True)
    assert recording.read().tolist() == IN_TIME
    assert recording.source.topics == (
        Topic("/camera/events", EVENT_PACKET, 2, True),
        Topic("/camera/events", OTHER, 1, False),
    )


def test_a_topic_that_two_programs_have_sent_is_one(tmp_path):
    """A bag of ROS 1 has a connection for each of them."""
    with Bag(tmp_path / "a.bag") as bag:
        bag.packet(WORDS[:3], SENSOR)
        bag.packet(WORDS[3:4], SENSOR)
        bag.connect("/camera/events", EVENT_PACKET, callerid="/other")
        bag.packet(WORDS[4:], SENSOR)
    recording = open_recording(tmp_path / "a.bag", strict=True)
    assert recording.read().tolist() == IN_TIME
    assert recording.source.topics == (Topic("/camera/events", EVENT_PACKET, 3, True),)


@every_bag
def test_a_bag_without_events_is_refused_and_its_topics_are_listed(tmp_path, name):
    with Bag(tmp_path / name) as bag:
        bag.send("/chatter", OTHER, "hello")
    with pytest.raises(
        ValueError, match=rf"{name}: .*its topics are: /chatter \({OTHER}, 1 messages\)"
    ):
        open_recording(tmp_path / name)


@every_bag
@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"encoding": "mono"}, "events must be encoded as evt3 or libcaer_cmp, got 'mono'"),
        (
            {"encoding": "libcaer_cmp", "time_base": 1 << 62},
            r"`time_base` must be below 2\*\*62 ns, got 4611",
        ),
        ({"sensor": (0, 240)}, "a sensor must have 1 to 65536 pixels a side, got 0 x 240"),
        ({"sensor": (320, 0)}, "a sensor must have 1 to 65536 pixels a side, got 320 x 0"),
        ({"sensor": (640, 480)}, r"of \(640, 480\) pixels, but those before of \(320, 240\)"),
        ({"words": np.frombuffer(b"odd", "u1")}, "evt3 has words of two bytes, got 3 bytes"),
    ],
)
def test_messages_up_to_one_that_cannot_be_read(tmp_path, name, how, message):
    """If it is the first message, no event can be read.

    A message with a sensor of its own is then no fault.
    """
    how = {"sensor": SENSOR, "words": WORDS} | how
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS, SENSOR)
        write(bag, **how)
        bag.packet(WORDS, SENSOR)
    recording = open_recording(tmp_path / name)
    with pytest.warns(
        DamagedRecording,
        match=f"{name}: damaged recording: after message 1: .*message 1: {message}",
    ):
        assert recording.read().tolist() == IN_TIME
    if how["sensor"] == (640, 480):
        return
    with Bag(tmp_path / f"first{name[1:]}") as bag:
        write(bag, **how)
        bag.packet(WORDS, SENSOR)
    with pytest.raises(
        ValueError, match=rf"first.*: not a readable ROS bag file: .*message 0: {message}"
    ):
        open_recording(tmp_path / f"first{name[1:]}")


def write(bag, sensor, words, encoding="evt3", time_base=0):
    """One EventPacket; a word is one byte where `words` are."""
    data = (
        np.asarray(words)
        if isinstance(words, np.ndarray)
        else np.frombuffer(np.array(words, "<u2").tobytes(), "u1")
    )
    size = sensor[1], sensor[0]
    bag.send(
        "/camera/events", EVENT_PACKET, bag.header(), *size, 0, time_base, encoding, False, data
    )


@every_bag
def test_words_that_no_sensor_has_are_left_out_and_words_without_a_time_are_no_format(
    tmp_path, name
):
    beyond = [0x3000 | 2037, 0x4800]
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS, SENSOR)
        bag.packet(beyond, SENSOR)
    with pytest.warns(
        EventsOffSensor, match="1 of 3 events lies off the .*; it is event 2 at x = 2048, y = 9"
    ):
        assert open_recording(tmp_path / name).read().tolist() == IN_TIME
    with Bag(tmp_path / f"first{name[1:]}") as bag:
        bag.packet(WORDS[3:], SENSOR)
    with pytest.raises(
        ValueError, match="not one event can be read: 2 words of events have no time or no row"
    ):
        open_recording(tmp_path / f"first{name[1:]}")


@every_bag
def test_a_sensor_of_no_pixels_is_one_that_is_not_stated(tmp_path, name):
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS, (0, 0))
    recording = open_recording(tmp_path / name, sensor=(34, 34))
    assert (recording.sensor, recording.stated_sensor) == ((34, 34), None)
    assert recording.read().tolist() == IN_TIME


@every_bag
def test_compressed_bags(tmp_path, name):
    """Bags are compressed as `ros2 bag record` does, without metadata beside the file.

    ROS 1 compresses chunks, and ROS 2 compresses each message.
    """
    with Bag(tmp_path / name, compressed=True) as bag:
        for part in np.split(EVENTS, 4):
            bag.array(part, SENSOR)
    np.testing.assert_array_equal(open_recording(tmp_path / name).read(), EVENTS)


@every_bag
def test_any_path_will_do(tmp_path, name):
    """SQLite reads a path as a part of an URI."""
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS, SENSOR)
    odd = (tmp_path / name).rename(tmp_path / f"100%41 #1?x=y &z{name[1:]}")
    assert open_recording(odd).read().tolist() == IN_TIME


@pytest.mark.parametrize(
    ("name", "n_more", "is_refused"),
    [("a.bag", 1, True), ("a.mcap", 3, False), ("a.mcap", 4, True)],
)
@pytest.mark.parametrize("kind", [EVENT_PACKET, EVENT_ARRAY])
def test_a_message_of_another_definition_is_refused(tmp_path, kind, name, n_more, is_refused):
    """Numbers in another order would be read as others; more bytes than fields show it. CDR may end
    with three bytes that say nothing."""
    with Bag(tmp_path / name) as bag:
        if kind == EVENT_PACKET:
            bag.packet(WORDS, SENSOR)
            fields = (0, 0, "evt3", False, np.zeros(0, np.uint8))
        else:
            bag.array(events_of(*zip(*IN_TIME, strict=True)), SENSOR)
            fields = ([],)
        bag.send_bytes(bag.data_of(kind, bag.header(), 240, 320, *fields) + bytes(n_more))
    recording = open_recording(tmp_path / name)
    if not is_refused:
        assert recording.read().tolist() == IN_TIME
        return
    with pytest.warns(
        DamagedRecording,
        match=f"message 1: it has {n_more} bytes more than its fields; its type has been changed",
    ):
        assert recording.read().tolist() == IN_TIME


REAL = "test_events_1.bag", "test_events_1/test_events_1.db3", "test_events_2/test_events_2_0.mcap"


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
@pytest.mark.parametrize("share", [0, 0.1, 0.5, 0.9])
def test_a_message_that_is_cut_off_is_damage(tmp_path, name, share):
    """In its header, its numbers, or its words."""
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS, SENSOR)
        fields = bag.header(), 240, 320, 0, 0, "evt3", False, np.zeros(90, np.uint8)
        data = bag.data_of(EVENT_PACKET, *fields)
        bag.send_bytes(data[: int(share * len(data))])
    recording = open_recording(tmp_path / name)
    with pytest.warns(DamagedRecording, match="after message 1: .*message 1: "):
        assert recording.read().tolist() == IN_TIME


@pytest.fixture(scope="session")
def bags(data):
    """The folder with the real bags, or skip."""
    if not all((data / "ros" / name).is_file() for name in REAL):
        pytest.skip(f"no bags in {data / 'ros'}")
    return data / "ros"


def payloads_of(path):
    """The events' bytes of each EventPacket, by rosbags' own unpacking."""
    rosbags = pytest.importorskip("rosbags.highlevel", reason="ROS bags need rosbags")
    from rosbags.typesys import Stores, get_typestore

    with rosbags.AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, raw in reader.messages():
            yield bytes(reader.deserialize(raw, connection.msgtype).events)


# events that the authors' own decoder counts in these files (event_camera_py, tests)
@pytest.mark.parametrize(
    ("name", "n_off", "n_on", "sensor"),
    [
        (REAL[0], 218_291, 125_183, (640, 480)),
        (REAL[1], 218_291, 125_183, (640, 480)),
        (REAL[2], 360_223, 211_043, (346, 260)),
    ],
)
def test_real_bags_have_the_events_that_their_authors_count(bags, name, n_off, n_on, sensor):
    recording = open_recording(bags / name, strict=True)
    polarity = recording.read()["p"]
    assert recording.sensor == sensor
    assert [topic.name for topic in recording.source.topics] == ["/event_camera/events"]
    assert ((polarity == 0).sum(), (polarity == 1).sum()) == (n_off, n_on)


def test_real_words_are_decoded_as_their_description_says(bags):
    words = np.frombuffer(b"".join(payloads_of(bags / REAL[0])), "<u2")
    start = int(np.flatnonzero(words >> 12 == 8)[0])
    expected = plainly_decoded(words[start:].tolist())
    found = open_recording(bags / REAL[0]).read()
    np.testing.assert_array_equal(found, events_of(*zip(*expected, strict=True)))
    np.testing.assert_array_equal(found, open_recording(bags / REAL[1]).read())


def test_made_words_are_decoded_as_their_description_says(tmp_path):
    """The same without the real bags, with vectors and wraps."""
    events = made_events(500, step_us=1 << 17)
    path = written(tmp_path / "packets.bag", events)
    words = np.frombuffer(b"".join(payloads_of(path)), "<u2")
    assert len(plainly_decoded(WORDS)) == 2 and events["t"][-1] > 1 << 24 and len(words) > 500
    np.testing.assert_array_equal(open_recording(path).read(), events)


@every_bag
def test_a_bag_is_closed_wherever_reading_ends(tmp_path, monkeypatch, name):
    """At its end, before it, and where its topic is not there."""
    with Bag(tmp_path / name) as bag:
        bag.packet(WORDS, SENSOR)
    closed = []
    open_bag = ros_reader._open

    def open_and_note(path):
        bag, is_ros_1 = open_bag(path)
        close = bag.close
        bag.close = lambda: closed.append(close())
        return bag, is_ros_1

    monkeypatch.setattr(ros_reader, "_open", open_and_note)
    path = str(tmp_path / name)
    assert len(list(ros_reader.read_bag(path, None))) == 2 and len(closed) == 1
    blocks = ros_reader.read_bag(path, None)
    next(blocks)
    blocks.close()
    assert len(closed) == 2
    with pytest.raises(ValueError, match="must be one of"):
        next(ros_reader.read_bag(path, "/other"))
    assert len(closed) == 3
