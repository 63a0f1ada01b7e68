"""`open_recording`, its packets, and the bundled samples."""

import numpy as np
import pytest

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.nmnist import read_nmnist, write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings

EVENTS = np.array([(5 + 7 * i, i % 34, (3 * i) % 34, i % 2) for i in range(10)], EVENT_DTYPE)


@pytest.fixture
def path(tmp_path):
    write_nmnist(tmp_path / "ten.bin", EVENTS)
    return tmp_path / "ten.bin"


@pytest.mark.parametrize("packet_events", [1, 2, 3, 9, 10, 11, 1000])
def test_packets_laid_end_to_end_are_the_recording(path, packet_events):
    recording = open_recording(path, packet_events=packet_events)
    packets = list(recording)
    assert len(packets) == len(recording)
    assert all(len(packet) == packet_events for packet in packets[:-1])
    np.testing.assert_array_equal(np.concatenate(packets), EVENTS)
    np.testing.assert_array_equal(recording.read(), EVENTS)


def test_what_a_recording_says_of_itself(path):
    recording = open_recording(str(path))
    assert (recording.path, recording.sensor, recording.n_events, recording.duration_us) == (
        path,
        (34, 34),
        10,
        63,
    )
    assert "ten.bin" in repr(recording) and "10 events" in repr(recording)


def test_packets_are_copies_and_every_pass_starts_afresh(path):
    recording = open_recording(path, packet_events=4)
    for packet in recording:
        packet["t"] = -1
    recording.read()["x"] = 0
    np.testing.assert_array_equal(np.concatenate(list(recording)), EVENTS)


def test_empty_recording_has_no_packets(tmp_path):
    (tmp_path / "none.bin").write_bytes(b"")
    recording = open_recording(tmp_path / "none.bin")
    assert (list(recording), recording.n_events, recording.duration_us) == ([], 0, 0)


def test_suffix_is_read_in_any_case(path):
    assert open_recording(path.rename(path.with_suffix(".BIN"))).n_events == 10


def test_unknown_suffix_lists_the_known_ones(tmp_path):
    with pytest.raises(
        ValueError, match=r"a\.mp4: unknown suffix '\.mp4', expected one of \.aedat4, \.bin, \.csv, \.dat"
    ):
        open_recording(tmp_path / "a.mp4")
    with pytest.raises(ValueError, match="unknown suffix ''"):
        open_recording(tmp_path / "nothing")


def test_a_further_format_is_one_more_reader(tmp_path, monkeypatch):
    monkeypatch.setitem(READERS, ".ten", lambda path: (EVENTS, (64, 48)))
    recording = open_recording(tmp_path / "a.ten")
    assert recording.sensor == (64, 48) and recording.n_events == 10


@pytest.mark.parametrize("packet_events", [0, -3])
def test_packets_hold_at_least_one_event(path, packet_events):
    with pytest.raises(ValueError, match=f"`packet_events` must be at least 1, got {packet_events}"):
        open_recording(path, packet_events=packet_events)


@pytest.mark.parametrize("suffix", sorted(READERS))
def test_missing_file_is_an_os_error_at_opening(tmp_path, suffix):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        open_recording(tmp_path / f"nowhere{suffix}")


def test_ten_samples_are_bundled():
    samples = sample_recordings()
    assert sorted(samples) == list(range(10))
    for digit, path in samples.items():
        events = read_nmnist(path)
        assert path.stem == str(digit)
        assert 1_500 < len(events) < 9_000
        assert 290_000 < events["t"][-1] <= 308_000
