"""Damage of every format: the events before it and a clear message, or a ValueError; never a crash.

ASYNC_TNT_FUZZ_CASES and ASYNC_TNT_FUZZ_SEED make the random damage a long run.
"""

import os
import struct
import warnings

import numpy as np
import pytest
from sources.files.written import (
    FORMATS,
    aedat2,
    aedat3,
    dat,
    evt2,
    evt3,
    evt_header,
    made_events,
    written,
)

from async_tnt.sources.files import worker_source
from async_tnt.sources.files.off_sensor import EventsOffSensor
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "60"))  # number of cases of each format
SEED = int(os.environ.get("ASYNC_TNT_FUZZ_SEED", "0"))
SMALL = (34, 34)
EVENTS = made_events(12, step_us=300, sensor=SMALL)
# AEDAT 3.1, a time before 0
NEGATIVE = struct.pack("<hhiiiiiiII", 1, 1, 8, 4, 0, 1, 1, 1, 1, 1 << 31)
every_format = pytest.mark.parametrize("name", sorted(FORMATS))


def read(path, **how):
    """(events, or None if the file is refused; the warnings), within what every reader promises:

    nothing but a ValueError of one line that names the file; at most one warning of damage and one
    of events off the sensor in three passes; the same events in every pass; valid events, on the
    sensor.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            recording = open_recording(path, packet_events=64, **how)
            packets = list(recording)
            assert recording.n_events == sum(map(len, packets))
            again = recording.read()
        except ValueError as error:
            assert str(path) in str(error) and "\n" not in str(error)
            return None, caught
    off_sensor = [warning for warning in caught if warning.category is EventsOffSensor]
    caught = [warning for warning in caught if warning.category is not EventsOffSensor]
    assert len(caught) <= 1
    assert all(issubclass(warning.category, DamagedRecording) for warning in caught)
    assert len(off_sensor) == (recording.counts.off_sensor > 0)
    got = np.concatenate([made_events(0), *packets])
    np.testing.assert_array_equal(got, again)
    assert (got["t"] >= 0).all() and (got["t"] < 1 << 62).all() and (got["p"] <= 1).all()
    if recording.sensor is not None:
        assert (got["x"] < recording.sensor[0]).all() and (got["y"] < recording.sensor[1]).all()
    return got, caught


@every_format
def test_a_file_cut_at_any_byte_gives_its_first_events(tmp_path, name):
    path = written(tmp_path / name, EVENTS, SMALL)
    data = path.read_bytes()
    step = 1
    if FORMATS[name].in_worker:
        step = len(data) // 3
    elif name.endswith(".npz"):
        step = 7
    sizes = range(0, len(data), step)
    n_silent = 0
    for size in sizes:
        path.write_bytes(data[:size])
        got, caught = read(path)
        if got is None:
            continue
        np.testing.assert_array_equal(got, EVENTS[: len(got)])
        if caught:
            assert len(got) > 0, "a file without one event is not damaged, it is refused"
            assert f"Keeping the {len(got)} events before" in str(caught[0].message)
            assert read(path, strict=True)[0] is None
        else:
            n_silent += 1
            assert FORMATS[name].whole_when_cut or len(got) == len(EVENTS), (
                f"cut to {size} bytes in silence"
            )
    assert n_silent < len(sizes)


def damaged(data, rng):
    """Bytes changed, lost, inserted, doubled, set to zeros or ones; or the end lost."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(0, len(data) + 1))
        length = int(rng.integers(1, 12))
        there = data[place : place + length]
        noise = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        new = (
            noise,
            b"",
            noise + there,
            bytes(length),
            b"\xff" * length,
            there * 10,
            bytes(b ^ 4 for b in there),
        )
        data[place : place + length] = new[rng.integers(0, len(new))]
        if rng.integers(0, 30) == 0:
            del data[place:]
    return bytes(data)


@every_format
def test_random_damage_never_crashes(tmp_path, name, monkeypatch):
    monkeypatch.setattr(worker_source, "SILENCE_S", 5)  # HDF5 reads some damage forever
    events = made_events(60, step_us=3_000, sensor=SMALL)
    path = written(tmp_path / name, events, SMALL)
    data = path.read_bytes()
    rng = np.random.default_rng((SEED, *name.encode()))
    n_cases = max(3, CASES // 100) if FORMATS[name].in_worker else CASES
    n_noticed = 0
    for _ in range(n_cases):
        path.write_bytes(damaged(data, rng))
        got, caught = read(path)
        n_noticed += got is None or len(caught) > 0
    assert n_noticed > n_cases // 100


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        (
            "a.raw",
            evt3(EVENTS)[len(evt_header("3.0")) :],
            "its first bytes are not those of a known format",
        ),
        (
            "a.raw",
            b"% evt 4.0\n",
            r"`% evt` 2.0, 2.1 or 3.0, or `% format` EVT2, EVT21 or EVT3; got '4.0'",
        ),
        (
            "a.raw",
            b"% format EVT21;endianness=big\n",
            "`endianness` must be little or legacy, got 'big'",
        ),
        (
            "a.raw",
            b"% evt 3.0\n% t0 " + b"9" * 19 + b"\n",
            "`% t0` must be whole microseconds, got '9{19}'",
        ),
        (
            "a.raw",
            b"% evt 3.0\n% geometry 12",
            "the file ends inside its header, in '% geometry 12'",
        ),
        ("a.raw", b"% evt 3.0\n% geometry 0x12\n", "must be two sizes in pixels, got '0x12'"),
        (
            "a.dat",
            b"% some table\n1 2 3\n4 5 6\n",
            "after the header there must be a type of events, 0 or 12",
        ),
        ("a.dat", b"% Version 7\n\x0c\x08", "the header's Version must be 1 or 2, got '7'"),
        (
            "a.es",
            b"Event Stream\x02\x00\x00\x00",
            "not a readable ES file: expected DVS or ATIS events, got generic",
        ),
        (
            "a.txt",
            b"hello",
            "expected `t x y p`, t in seconds, or first `width height`, got 'hello'",
        ),
        (
            "a.txt",
            b"12 1 2 1\n13 1 2 1\n",
            r"must be seconds with decimals, got whole numbers \(12, 13, ...\)",
        ),
        (
            "a.txt",
            b"1000.0 1 2 1\n1.25e3 1 2 1\n",
            r"with decimals, got whole numbers \(1000.0, 1.25e3, ...\)",
        ),
        ("a.txt", b"240 18", "the file ends in its first line, '240 18'"),
        (
            "a.csv",
            b"t x y p\n",
            "at least four columns with commas, semicolons or tabs .* got 't x y p' at line 1",
        ),
        (
            "a.csv",
            b"t,x,y,q\n",
            r"the header must name t\|ts\|timestamp, x, y, p\|on\|polarity\|pol; got 't,x,y,q'",
        ),
        ("a.csv", b"1,2,3,0,5\n", "without a header there must be four columns t, x, y, p, got 5"),
        ("a.aedat", b"#!AER-DAT1.0\r\n", "AEDAT 2.0, 3.1 or 4, ES or HDF5; got b'#!AER-DAT1.0"),
        (
            "a.aedat",
            b"#!AER-DAT2.0\r\n# AEChip: ini.Foo7\r\n",
            "the camera must be one of DVS128, .*, got 'ini.Foo7'",
        ),
        (
            "a.aedat",
            b"#!AER-DAT2.0\r\n# AEChip: davis346.Foo7\r\n",  # the last part is the camera's
            "the camera must be one of DVS128, .*, got 'davis346.Foo7'",
        ),
        (
            "a.aedat",
            b"#!AER-DAT3.1\r\n#Source 1: DVS128\r\n",
            "the header must end within 4096 lines by #!END-HEADER",
        ),
        ("a.aedat4", b"#!AER-DAT4.0\r\n" + bytes(9), "not a readable AEDAT4 file: "),
        ("a.bag", b"#ROSBAG V2.0\n", "not a readable ROS bag file: "),
        ("a.db3", b"SQLite format 3\0" + bytes(99), "not a readable ROS bag file: "),
        (
            "a.mcap",
            b"\x89MCAP1\r\n",
            "as a bag of ROS 1, an SQLite or an MCAP file does, got b'.x89MCAP1",
        ),
        ("a.csv", b"%geometry:0,720\n1,2,1,7\n", "1 to 65536 pixels a side, got '%geometry:0,720'"),
        (
            "a.csv",
            b"%geometry:" + b"9" * 5_000 + b",9\n1,2,1,7\n",
            "1 to 65536 pixels a side, got '%geometry:9{70}'$",
        ),
        ("a.txt", b"0.5 1 2 1 9\n", "expected `t x y p`, .* got '0.5 1 2 1 9' at line 1"),
        # In these files the header is understood, but no event is.
        (
            "a.csv",
            b"t,x,y,p\n5,1,2,hello\n6,1,2,1\n",
            "not one event can be read: line 2: expected t,x,y,p, .* got '5,",
        ),
        (
            "a.csv",
            b"5,6,9,7\n",
            "not one event can be read: event 0: t = 5, x = 6, y = 9, p = 7 is not a valid event",
        ),
        (
            "a.csv",
            b"1.5,2,3,1\n2.5,2,3,1\n",
            "not one event can be read: line 1: .* whole microseconds, got '1.5,2,3",
        ),
        (
            "a.txt",
            b"0.5 1 2\n0.6 1 2\n",
            "not one event can be read: line 1: expected `t x y p`, .* got '0.5 1 2'",
        ),
        (
            "a.txt",
            b"9 9\n-0.5 1 2 1\n",
            "not one event can be read: event 0: t = -500000, .* is not a valid event",
        ),
        (
            "a.raw",
            evt_header("3.0") + b"\x01\x00\x02\x20",
            "not one event .*: 1 words of events have no time or no row",
        ),
        (
            "a.raw",
            evt_header("3.0") + b"\x01",
            "not one event .*: the file ends at byte .*, 1 bytes into a word of 2",
        ),
        (
            "a.dat",
            dat(EVENTS[:0]) + bytes(7) + b"\x70",
            r"not one event .*: event 0 \(byte .*, p = 7 is not a valid event",
        ),
        (
            "a.aedat",
            aedat3(EVENTS[:0]) + NEGATIVE,
            "not one event .*: t = -1, x = 0, y = 0, p = 0 is not a valid event",
        ),
    ],
)
def test_a_file_that_cannot_be_understood_is_refused_in_one_line(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=message) as raised:
        open_recording(tmp_path / name)
    assert str(tmp_path / name) in str(raised.value) and "\n" not in str(raised.value)


ROWS = b"\n".join(b"%d.5 1 2 1" % i if i != 150_000 else b"what" for i in range(160_000))


@pytest.mark.parametrize(
    ("name", "data", "message", "n_events"),
    [
        ("a.raw", evt2(EVENTS)[:-1], "the file ends at byte .*, 3 bytes into a word of 4", 11),
        ("a.dat", dat(EVENTS)[:-3], "the file ends 5 bytes into event 11, which has 8", 11),
        (
            "a.dat",
            dat(EVENTS)[:-1] + b"\x70",
            r"event 11 \(byte .*\): t = .*, p = 7 is not a valid event",
            11,
        ),
        (
            "a.aedat",
            aedat2(EVENTS, SMALL, "")[:-1],
            "the file ends 7 bytes into an event, which has 8",
            11,
        ),
        (
            "a.aedat",
            aedat3(EVENTS)[:-45],
            "the file ends within a packet, which has 2 more events",
            11,
        ),
        ("a.aedat", aedat3(EVENTS)[:-3], "the file ends 5 bytes into a packet, which has 8", 12),
        (
            "a.aedat",
            aedat3(EVENTS)[:-33],
            "the file ends 3 bytes into the header of a packet, which has 28",
            12,
        ),
        (
            "a.aedat",
            aedat3(EVENTS) + b"\1\0" * 14,
            "has no valid header: type 1, 65537 events of 65537 bytes",
            12,
        ),
        (
            "a.aedat",
            aedat3(EVENTS) + NEGATIVE,
            "in the packet around byte .*: t = -1, x = 0, y = 0, p = 0 is not",
            12,
        ),
        ("a.txt", ROWS, "line 150001: .* got 'what'", 150_000),
        (
            "a.txt",
            b"0.5 1 2 1\n#" + b" " * 3_000_000 + b"\n0.6 1 2 1\n",
            "line 2: expected .* more than 65,536 b",
            1,
        ),
        (
            "a.txt",
            b"0.5 1 2 1\n0.6 1 2 1" + b" " * 70_000 + b"what",
            "line 2: expected .* got '0.6 1 2 1",
            1,
        ),
        # without its line end, `1234` may have been 123456
        (
            "a.csv",
            b"x,y,p,t\n1,2,1,1233\n1,2,1,1234",
            "line 3: .* got '1,2,1,1234', and the file ends there",
            1,
        ),
        ("a.csv", b"x,y,p,t\n1,2,1,7\nwhat\n", "line 3: .* got 'what'(?!, and)", 1),
    ],
)
def test_a_file_is_read_up_to_the_damage_with_one_warning(tmp_path, name, data, message, n_events):
    (tmp_path / name).write_bytes(data)
    recording = open_recording(tmp_path / name)
    with pytest.warns(DamagedRecording, match=f"damaged recording: .*{message}") as caught:
        events = recording.read()
        assert (recording.n_events, len(events), sum(map(len, recording))) == (n_events,) * 3
    assert len(caught) == 1
    until = f", up to {events['t'][-1]} us" if n_events else ""
    assert str(caught[0].message).endswith(f"Keeping the {n_events} events before{until}.")
    with pytest.raises(ValueError, match=rf"{message}.*\. Fetch the file again\.$"):
        open_recording(tmp_path / name, strict=True).read()


def test_damage_before_the_first_event_of_a_part_names_no_time(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y,p\n5,1,2,1\nwhat\n")
    recording = open_recording(tmp_path / "a.csv", between_us=(7, 9))
    with pytest.warns(DamagedRecording, match=r"\. Keeping the 0 events before\.$"):
        assert len(recording.read()) == 0


LONG = made_events(150_000, step_us=4, sensor=SMALL)


def dat_with_a_polarity_of_8(k):
    data = bytearray(dat(LONG))
    place = len(data) - 8 * (len(LONG) - k)
    data[place + 7] |= 0x80
    return data, place, k


def evt2_that_ends_within_a_word(k):
    data = evt2(LONG[:k]) + b"\1\2\3"
    return bytearray(data), len(data), k


def aedat3_with_an_impossible_packet(k):
    data = aedat3(LONG[:k])
    return (
        bytearray(data + struct.pack("<hhiiiiii", 1, 1, 7, 4, 0, 1, 1, 1) + bytes(100)),
        len(data),
        k,
    )


@pytest.mark.parametrize("k", [0, 11, 65_535, 65_536, 140_003])
@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("a.dat", dat_with_a_polarity_of_8),
        ("a.raw", evt2_that_ends_within_a_word),
        ("a.aedat", aedat3_with_an_impossible_packet),
    ],
)
def test_the_byte_of_the_damage_is_named_wherever_it_is(tmp_path, name, make, k):
    """This holds however many blocks were read before it."""
    data, byte, n_before = make(k)
    (tmp_path / name).write_bytes(data)
    if n_before == 0:  # another format
        with pytest.raises(ValueError, match=rf"not one event can be read: .*\bbyte {byte}\b"):
            open_recording(tmp_path / name)
        return
    with pytest.warns(DamagedRecording, match=rf"\bbyte {byte}\b"):
        events = open_recording(tmp_path / name).read()
    np.testing.assert_array_equal(events, LONG[:n_before])
