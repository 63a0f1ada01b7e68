"""What each format's writer writes is read back, event for event, however it is cut into packets."""

import numpy as np
import pytest
from recordings.written import SAYS_SENSOR, SENSOR, WRITERS, evt3, evt21, evt_header, made_events

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files.recording import open_recording


@pytest.fixture(params=sorted(WRITERS))
def written(request, tmp_path):
    """A function from events to the path of a file with them."""
    path = tmp_path / request.param

    def write(events):
        WRITERS[path.name](path, events)
        return path

    return write


def with_gaps(events):
    events["t"][len(events) // 2 :] += 3_000_000
    return events


EVENTS = {
    "none": made_events(0),
    "one": made_events(1),
    "many": made_events(5_000),
    "at one time": made_events(300, step_us=1),
    "gap": with_gaps(made_events(500)),
    "more than a block": made_events(140_000, step_us=4),
}


@pytest.mark.parametrize("name", EVENTS)
def test_events_are_read_back(written, name):
    recording = open_recording(written(EVENTS[name]))
    events = EVENTS[name]
    got = recording.read()
    assert got.dtype == EVENT_DTYPE
    np.testing.assert_array_equal(got, events)
    assert (recording.n_events, recording.n_unsorted) == (len(events), 0)
    assert recording.duration_us == (events["t"][-1] - events["t"][0] if len(events) else 0)
    assert recording.sensor == (SENSOR if SAYS_SENSOR[recording.path.name] else None)


@pytest.mark.parametrize("packet_events", [1, 7, 1000, 70_000])
def test_packets_laid_end_to_end_are_the_recording(written, packet_events):
    events = made_events(1_500) if packet_events < 1000 else EVENTS["more than a block"]
    recording = open_recording(written(events), packet_events=packet_events)
    packets = list(recording)
    assert len(packets) == len(recording) == -(-len(events) // packet_events)
    assert all(len(packet) == packet_events for packet in packets[:-1])
    np.testing.assert_array_equal(np.concatenate(packets), events)


def test_packets_are_the_callers_own(written):
    recording = open_recording(written(EVENTS["many"]), packet_events=400)
    for packet in recording:
        packet["t"] = -1
    np.testing.assert_array_equal(recording.read(), EVENTS["many"])


def test_representation_reads_nothing(written):
    recording = open_recording(written(EVENTS["many"]))
    assert "not read yet" in repr(recording)
    recording.read()
    assert "5000 events" in repr(recording)


def test_content_tells_the_format_where_suffixes_are_shared(tmp_path):
    for name in ("evt3.raw", "v2.dat", "dvs.es"):
        WRITERS[name](tmp_path / name, EVENTS["many"])
        for suffix in (".raw", ".h5"):
            renamed = (tmp_path / name).with_suffix(suffix)
            if name != "v2.dat":  # DAT has no mark but its suffix
                renamed.write_bytes((tmp_path / name).read_bytes())
                np.testing.assert_array_equal(open_recording(renamed).read(), EVENTS["many"])
    (tmp_path / "what.raw").write_bytes(b"\x00\x01\x02\x03")
    with pytest.raises(ValueError, match=r"what\.raw: its first bytes are of no known format"):
        open_recording(tmp_path / "what.raw")


def test_evt21_of_both_endiannesses(tmp_path):
    (tmp_path / "a.raw").write_bytes(evt21(EVENTS["many"], endianness="legacy"))
    np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read(), EVENTS["many"])


def test_evt21_and_evt3_vectors_by_hand(tmp_path):
    """One word tells several pixels: bits 0, 2 and 31 from x = 64; bits 0 and 11, then 8 pixels on, from x = 100."""
    words = np.array([0x8 << 60 | 1 << 32, (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 1 << 31 | 0b101], "<u8")
    (tmp_path / "evt21.raw").write_bytes(evt_header("2.1", more=";endianness=little") + words.tobytes())
    got = open_recording(tmp_path / "evt21.raw").read()
    assert got.tolist() == [(69, 64, 9, 1), (69, 66, 9, 1), (69, 95, 9, 1)]

    words = np.array([0x8001, 0x6005, 0x0009, 0x3000 | 100, 0x4801, 0x5081, 0x7000, 0xE000, 0xA001], "<u2")
    (tmp_path / "evt3.raw").write_bytes(evt_header("3.0") + words.tobytes())
    got = open_recording(tmp_path / "evt3.raw").read()
    assert got.tolist() == [(4101, x, 9, 0) for x in (100, 111, 112, 119)]


def test_evt3_time_low_starts_at_zero_after_a_new_time_high(tmp_path):
    words = np.array([0x8001, 0x6FFF, 0x0009, 0x2001, 0x8002, 0x2002, 0x6003, 0x2003], "<u2")
    (tmp_path / "a.raw").write_bytes(evt_header("3.0") + words.tobytes())
    assert open_recording(tmp_path / "a.raw").read()["t"].tolist() == [8191, 8192, 8195]


def test_events_before_the_first_time_are_left_out(tmp_path):
    data = evt3(EVENTS["many"])
    start = len(evt_header("3.0"))
    words = np.frombuffer(data[start:], "<u2")
    events = np.array([0x2001, 0x0003, 0x2002], "<u2")
    (tmp_path / "a.raw").write_bytes(data[:start] + events.tobytes() + words.tobytes())
    np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read(), EVENTS["many"])


def test_es_atis_events_of_changing_light(tmp_path):
    header = b"Event Stream\x02\x00\x00\x02" + np.array(SENSOR, "<u2").tobytes()
    place = np.array([4, 0], "<u2").tobytes()  # y = 0 is the lowest row
    body = b"\xfd\xfe" + bytes([5 << 2 | 2]) + place + bytes([1 << 2 | 1]) + place + bytes([1 << 2]) + place
    (tmp_path / "a.es").write_bytes(header + body)
    assert open_recording(tmp_path / "a.es").read().tolist() == [(194, 4, 239, 1), (196, 4, 239, 0)]


def test_dat_version_1(tmp_path):
    word = np.array([70, 1 << 17 | 200 << 9 | 300], "<u4").tobytes()
    (tmp_path / "a.dat").write_bytes(b"% Version 1\n% Width 304\n% Height 240\n\x00\x08" + word)
    recording = open_recording(tmp_path / "a.dat")
    assert recording.read().tolist() == [(70, 300, 200, 1)] and recording.sensor == (304, 240)


@pytest.mark.parametrize("layout", ["dsec.h5", "metavision.hdf5"])
def test_hdf5_in_compressed_chunks(tmp_path, layout):
    path = tmp_path / layout
    WRITERS[layout](path, EVENTS["many"], chunks=(1000,), compression="gzip", shuffle=True)
    np.testing.assert_array_equal(open_recording(path).read(), EVENTS["many"])
