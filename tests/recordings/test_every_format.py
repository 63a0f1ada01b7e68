"""Laws of every format: what its writer writes is read back, event for event, however it is cut into packets."""

import os
import tracemalloc

import numpy as np
import pytest
from numba import config
from recordings.written import FORMATS, IN_CHILD, SENSOR, csv, made_events, written

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings

every_format = pytest.mark.parametrize("name", sorted(FORMATS))
every_suffix = pytest.mark.parametrize("suffix", sorted(READERS))


def sensor_for(name):
    return tuple(np.minimum(SENSOR, FORMATS[name].largest).tolist())


def gap(events):
    events["t"][len(events) // 2 :] += 3_000_000
    return events


EVENTS = {
    "none": lambda sensor: made_events(0),
    "one": lambda sensor: made_events(1, sensor=sensor),
    "at one time": lambda sensor: made_events(300, sensor=sensor, step_us=1),
    "gap": lambda sensor: gap(made_events(500, sensor=sensor)),
    "more than a block": lambda sensor: made_events(140_000, sensor=sensor, step_us=4),
}


@every_format
@pytest.mark.parametrize("what", EVENTS)
def test_events_are_read_back(tmp_path, name, what):
    sensor = sensor_for(name)
    events = EVENTS[what](sensor)
    recording = open_recording(written(tmp_path / name, events, sensor))
    got = recording.read()
    assert got.dtype == EVENT_DTYPE
    np.testing.assert_array_equal(got, events)
    assert (recording.n_events, recording.n_unsorted) == (len(events), 0)
    assert recording.duration_us == (events["t"][-1] - events["t"][0] if len(events) else 0)
    assert recording.sensor == (sensor if FORMATS[name].states_sensor else None)


SIZES = (1, 7, 1000, 1499, 1500, 1501)
PACKETS = [(name, n) for name in sorted(FORMATS) for n in ((1000,) if name.endswith(IN_CHILD) else SIZES)]


@pytest.mark.parametrize(("name", "packet_events"), [*PACKETS, *((name, 70_000) for name in sorted(FORMATS))])
def test_packets_end_to_end_are_the_recording_and_the_callers_own(tmp_path, name, packet_events):
    events = made_events(1_500 if packet_events < 2000 else 140_000, sensor=sensor_for(name), step_us=4)
    recording = open_recording(written(tmp_path / name, events, sensor_for(name)), packet_events=packet_events)
    packets = list(recording)
    assert len(packets) == len(recording) == -(-len(events) // packet_events)
    assert all(len(packet) == packet_events for packet in packets[:-1])
    np.testing.assert_array_equal(np.concatenate(packets), events)
    for packet in packets:
        packet["t"] = -1
    np.testing.assert_array_equal(recording.read(), events)


@every_format
def test_every_bit_of_a_pixel_is_read(tmp_path, name):
    """Events in all corners of the largest sensor that the format can say, and with one bit alone."""
    width, height = FORMATS[name].largest
    events = made_events(300, sensor=(width, height))
    events["x"][:4], events["y"][:4] = [0, width - 1, 0, width - 1], [0, 0, height - 1, height - 1]
    for i in range(16):
        events["x"][10 + i], events["y"][40 + i] = (1 << i) % width, (1 << i) % height
    np.testing.assert_array_equal(open_recording(written(tmp_path / name, events, (width, height))).read(), events)


@every_format
def test_links_are_followed_and_suffixes_may_be_in_capitals(tmp_path, name):
    events = made_events(50, sensor=(34, 34))
    written(tmp_path / name, events, (34, 34))
    capitals = tmp_path / name.upper()
    if not capitals.exists():  # a file system may not tell them apart
        capitals.symlink_to(tmp_path / name)
    np.testing.assert_array_equal(open_recording(capitals).read(), events)
    (tmp_path / f"gone{capitals.suffix}").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match="gone"):
        open_recording(tmp_path / f"gone{capitals.suffix}")


def test_the_representation_reads_nothing(tmp_path):
    recording = open_recording(written(tmp_path / "v2.dat", made_events(50)))
    assert "v2.dat" in repr(recording) and "not read yet" in repr(recording)
    recording.read()
    assert "50 events" in repr(recording)


def test_the_content_tells_the_format_where_suffixes_are_shared(tmp_path):
    events = made_events(50)
    for name in ("evt3.raw", "dvs.es"):
        for suffix in (".raw", ".h5", ".dat", ".aedat4"):
            renamed = written(tmp_path / name, events).rename(tmp_path / f"renamed{suffix}")
            np.testing.assert_array_equal(open_recording(renamed).read(), events)


N_LONG = 1_000_000
BLOCK = made_events(100_000, step_us=4)


def long_file(path):
    """The same events ten times over: writing a million different ones as text takes longer than reading them."""
    if path.suffix in (".txt", ".csv"):
        head, rows = written(path, BLOCK).read_bytes().split(b"\n", 1)
        path.write_bytes(head + b"\n" + rows * (N_LONG // len(BLOCK)))
        return
    events = np.tile(BLOCK, N_LONG // len(BLOCK))
    events["t"] = np.sort(events["t"])
    FORMATS[path.name].write(path, events, SENSOR, **({"chunks": (10_000,)} if "h" in path.suffix else {}))


@pytest.mark.skipif(config.DISABLE_JIT, reason="a million events in Python take minutes")
@pytest.mark.parametrize(
    "name", ["uzh.txt", "plain.csv", "v2.dat", "evt3.raw", "records.npy", "dv.aedat4", "dsec.h5", "metavision.hdf5"]
)
def test_memory_does_not_grow_with_the_file(tmp_path, name):
    long_file(tmp_path / name)
    next(iter(open_recording(tmp_path / name)))  # compiles and imports
    tracemalloc.start()
    try:
        n = sum(len(packet) for packet in open_recording(tmp_path / name))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert n == N_LONG
    assert peak < 9e6 < N_LONG * 13  # what all events would take


T_US = [10, 30, 20, 30, 29, 50, 40, 45, 60]


@pytest.fixture(params=["a.csv", "a.npy"])
def unsorted(request, tmp_path):
    events = made_events(len(T_US))
    events["t"] = T_US
    if request.param == "a.npy":
        np.save(tmp_path / "a.npy", events)
    else:
        (tmp_path / "a.csv").write_bytes(csv(events))
    return tmp_path / request.param


def test_events_older_than_one_before_them_are_accepted_dropped_or_refused(unsorted):
    recording = open_recording(unsorted)
    assert recording.read()["t"].tolist() == T_US
    assert (recording.n_unsorted, recording.n_events, recording.duration_us) == (4, 9, 50)
    recording = open_recording(unsorted, packet_events=2, unsorted="drop")
    assert np.concatenate(list(recording))["t"].tolist() == [10, 30, 30, 50, 60]
    assert (recording.n_unsorted, recording.n_events, len(recording)) == (4, 5, 3)
    with pytest.raises(ValueError, match=r'got 20 after 30 us at event 2; unsorted="accept" keeps such events'):
        open_recording(unsorted, unsorted="raise").read()
    with pytest.raises(ValueError, match="`unsorted` must be one of accept, drop, raise, got 'sort'"):
        open_recording(unsorted, unsorted="sort")


def test_unsorted_events_are_counted_across_blocks(tmp_path):
    events = made_events(100_000, step_us=3)
    events["t"][65_536] -= 1_000  # the first of a block
    events["t"][70_000:70_003] -= 500
    np.save(tmp_path / "a.npy", events)
    late = np.flatnonzero(events["t"][1:] < np.maximum.accumulate(events["t"])[:-1]) + 1
    recording = open_recording(tmp_path / "a.npy", unsorted="drop")
    np.testing.assert_array_equal(recording.read(), np.delete(events, late))
    assert recording.n_unsorted == len(late) >= 4


@every_suffix
def test_what_is_not_a_file_is_refused_at_opening(tmp_path, suffix):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        open_recording(tmp_path / f"nowhere{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(IsADirectoryError, match=r"is a folder, .* async-tnt run .* --out results\.jsonl streams all"):
        open_recording(tmp_path / f"folder{suffix}")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / f"pipe{suffix}")
        with pytest.raises(ValueError, match=rf"pipe\{suffix}: a recording must be a file that can be read more than"):
            open_recording(tmp_path / f"pipe{suffix}")
    if os.path.exists("/dev/zero"):
        (tmp_path / f"device{suffix}").symlink_to("/dev/zero")
        with pytest.raises(ValueError, match="got a pipe or a device"):
            open_recording(tmp_path / f"device{suffix}")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.mp4", r"a\.mp4: unknown suffix '\.mp4', expected one of \.aedat4, \.bin, \.csv, \.dat.*\.txt$"),
        ("nothing", "unknown suffix ''"),
        *[(f"a.csv.{x}", rf"unknown suffix '\.{x}', expected .*; decompress it first$") for x in ("gz", "zip", "xz")],
    ],
)
def test_an_unknown_suffix_lists_the_known_ones(tmp_path, name, message):
    with pytest.raises(ValueError, match=message):
        open_recording(tmp_path / name)


def test_a_further_format_is_one_more_reader(tmp_path, monkeypatch):
    monkeypatch.setitem(READERS, ".ten", lambda path: (made_events(10, sensor=(64, 48)), (64, 48)))
    recording = open_recording(tmp_path / "a.ten")
    assert recording.sensor == (64, 48) and recording.n_events == 10


@pytest.mark.parametrize("packet_events", [0, -3])
def test_packets_hold_at_least_one_event(packet_events):
    with pytest.raises(ValueError, match=f"`packet_events` must be at least 1, got {packet_events}"):
        open_recording("a.bin", packet_events=packet_events)


def test_ten_samples_are_bundled():
    samples = sample_recordings()
    assert sorted(samples) == list(range(10))
    for digit, path in samples.items():
        events = read_nmnist(path)
        assert path.stem == str(digit)
        assert 1_500 < len(events) < 9_000
        assert 290_000 < events["t"][-1] <= 308_000


def test_atis_events_of_changing_light_by_hand(tmp_path):
    header = b"Event Stream\x02\x00\x00\x02" + np.array(SENSOR, "<u2").tobytes()
    pixel = np.array([4, 0], "<u2").tobytes()  # y = 0 is the lowest row
    body = b"\xfd\xfe" + bytes([5 << 2 | 2]) + pixel + bytes([1 << 2 | 1]) + pixel + bytes([1 << 2]) + pixel
    (tmp_path / "a.es").write_bytes(header + body)
    assert open_recording(tmp_path / "a.es").read().tolist() == [(194, 4, 239, 1), (196, 4, 239, 0)]
