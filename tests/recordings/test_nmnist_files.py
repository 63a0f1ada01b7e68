"""N-MNIST's five-byte format: hand-worked bytes, round trips, overflow rows, damage."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files.nmnist import read_nmnist, write_nmnist
from async_tnt.sources.files.recording import open_recording


def events_of(*rows):
    return np.array(list(rows), EVENT_DTYPE)


def random_events(n, seed=0, width=34, height=34):
    rng = np.random.default_rng(seed)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = np.sort(rng.integers(0, 1 << 23, n))
    events["x"], events["y"] = rng.integers(0, width, n), rng.integers(0, height, n)
    events["p"] = rng.integers(0, 2, n)
    return events


def test_bytes_by_hand(tmp_path):
    # 0x012345 = 74565 us, OFF; then 0x7FFFFF us, the last time there is, ON: bit 7 beside bits 6-0 all set
    path = tmp_path / "two.bin"
    path.write_bytes(bytes([3, 33, 0x01, 0x23, 0x45, 33, 0, 0xFF, 0xFF, 0xFF]))
    events = read_nmnist(path)
    assert events.dtype == EVENT_DTYPE
    assert events.tolist() == [(74565, 3, 33, 0), (8_388_607, 33, 0, 1)]


def test_written_bytes_by_hand(tmp_path):
    path = tmp_path / "two.bin"
    write_nmnist(path, events_of((74565, 3, 33, 0), (8_388_607, 33, 0, 1)))
    assert path.read_bytes() == bytes([3, 33, 0x01, 0x23, 0x45, 33, 0, 0xFF, 0xFF, 0xFF])


@pytest.mark.parametrize("n", [0, 1, 2, 4_000])
def test_read_gives_back_what_was_written(tmp_path, n):
    events = random_events(n)
    before = events.copy()
    write_nmnist(tmp_path / "a.bin", events)
    np.testing.assert_array_equal(read_nmnist(tmp_path / "a.bin"), events)
    np.testing.assert_array_equal(events, before)


def test_other_sensors_round_trip_when_asked(tmp_path):
    events = events_of((0, 255, 239, 1), (5, 0, 255, 0))
    write_nmnist(tmp_path / "a.bin", events, sensor=None)
    np.testing.assert_array_equal(read_nmnist(tmp_path / "a.bin", sensor=None), events)
    with pytest.raises(ValueError, match=r"34 x 34 sensor, got x = 255, y = 239 at event 0 .*another camera") as raised:
        read_nmnist(tmp_path / "a.bin")
    (note,) = raised.value.__notes__  # what to pass is for Python, and not for the program, which shows no notes
    assert note.startswith("Pass strict=False for the 0 events before. Pass sensor=(width, height), or None")
    assert "=None" not in str(raised.value) and "strict" not in str(raised.value)


def test_a_camera_may_be_larger_than_a_byte_addresses(tmp_path):
    """N-Caltech101: a camera of 304 x 240."""
    events = events_of((0, 239, 179, 1), (5, 255, 239, 0))
    write_nmnist(tmp_path / "a.bin", events, sensor=(304, 240))
    np.testing.assert_array_equal(read_nmnist(tmp_path / "a.bin", sensor=(304, 240)), events)
    with pytest.raises(ValueError, match=r"`x` must be in \[0, 256\), got 300"):
        write_nmnist(tmp_path / "b.bin", events_of((0, 300, 0, 0)), sensor=(304, 240))


def test_open_recording_reads_a_bin_of_the_sensor_given(tmp_path):
    events = events_of((0, 239, 179, 1), (5, 100, 99, 0))
    write_nmnist(tmp_path / "a.bin", events, sensor=None)
    recording = open_recording(tmp_path / "a.bin", sensor=(304, 240), strict=True)
    assert recording.sensor == (304, 240)
    np.testing.assert_array_equal(recording.read(), events)
    with pytest.raises(ValueError, match=r"304 x 179 sensor, got x = 239, y = 179 at event 0"):
        open_recording(tmp_path / "a.bin", sensor=(304, 179))


def test_the_sensor_given_is_that_of_files_that_state_none(tmp_path):
    events = events_of((0, 239, 179, 1), (5, 100, 99, 0))
    np.save(tmp_path / "a.npy", events)
    recording = open_recording(tmp_path / "a.npy", sensor=(200, 200), strict=True)
    assert recording.sensor == (200, 200)
    np.testing.assert_array_equal(recording.read(), events)  # off it, which is not the file's fault
    np.savez(tmp_path / "a.npz", events=events, sensor=(346, 260))
    assert open_recording(tmp_path / "a.npz", sensor=(200, 200)).sensor == (346, 260)


@pytest.mark.parametrize("sensor", [(0, 5), (3,), 34, "34x34", (34.0, 34)])
def test_an_invalid_sensor_is_refused(tmp_path, sensor):
    write_nmnist(tmp_path / "a.bin", events_of((0, 1, 1, 1)))
    with pytest.raises(ValueError, match=r"`sensor` must be \(width, height\)"):
        write_nmnist(tmp_path / "b.bin", events_of((0, 0, 0, 0)), sensor=sensor)
    for read in (read_nmnist, open_recording):
        with pytest.raises(ValueError, match=r"`sensor` must be \(width, height\)"):
            read(tmp_path / "a.bin", sensor=sensor)


def test_fields_in_any_order_and_of_any_integer_type(tmp_path):
    dtype = [("p", "?"), ("y", "i4"), ("t", "u8"), ("x", ">i2")]
    events = np.array([(True, 5, 1000, 7), (False, 6, 2000, 8)], dtype)
    write_nmnist(tmp_path / "a.bin", events)
    assert read_nmnist(tmp_path / "a.bin").tolist() == [(1000, 7, 5, 1), (2000, 8, 6, 0)]


def test_overflow_rows_add_8192_us_to_all_that_follows_and_vanish(tmp_path):
    path = tmp_path / "a.bin"
    event = bytes([1, 2, 0x80, 0, 100])
    overflow = bytes([49, 240, 0, 0, 100])
    path.write_bytes(event + overflow + event + event + overflow + overflow + event)
    events = read_nmnist(path)
    assert events["t"].tolist() == [100, 100 + 8192, 100 + 8192, 100 + 3 * 8192]
    assert events["y"].tolist() == [2, 2, 2, 2]


def test_overflow_rows_alone_are_not_events(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes([49, 240, 0, 0, 0]) * 3)
    assert len(read_nmnist(tmp_path / "a.bin")) == 0


def test_times_past_32_bits_from_many_overflows(tmp_path):
    n = 600_000  # 600,000 x 8,192 us = 4.9e9 us, past 2^32
    (tmp_path / "a.bin").write_bytes(bytes([0, 240, 0, 0, 0]) * n + bytes([1, 1, 0, 0, 7]))
    assert read_nmnist(tmp_path / "a.bin")["t"].tolist() == [n * 8192 + 7]


def test_missing_file_and_folder_are_os_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.bin"):
        read_nmnist(tmp_path / "nowhere.bin")
    with pytest.raises(OSError, match=str(tmp_path.name)):
        read_nmnist(tmp_path)


@pytest.mark.parametrize("size", range(26))
def test_truncation_at_every_byte(tmp_path, size):
    events = random_events(5)
    whole, cut = tmp_path / "whole.bin", tmp_path / "cut.bin"
    write_nmnist(whole, events)
    cut.write_bytes(whole.read_bytes()[:size])
    if size % 5 == 0:  # a shorter recording, and nothing in the format could tell
        np.testing.assert_array_equal(read_nmnist(cut), events[: size // 5])
        return
    place = rf"got {size}: .* {size % 5} bytes into row {size // 5}"
    message = rf"cut\.bin: damaged .* {size} bytes: .*multiple of 5 bytes .* {place}"
    with pytest.raises(ValueError, match=message):
        read_nmnist(cut)
    with pytest.warns(UserWarning, match=message):
        kept = read_nmnist(cut, strict=False)
    np.testing.assert_array_equal(kept, events[: size // 5])


def test_time_running_backwards_is_damage(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes([1, 1, 0, 0, 9, 1, 1, 0, 0, 9, 1, 1, 0, 0, 8, 1, 1, 0, 0, 20]))
    message = r"`t` must never decrease, got 8 us after 9 us at event 2 \(byte 10\)"
    with pytest.raises(ValueError, match=message):
        read_nmnist(path)
    with pytest.warns(UserWarning, match=message):
        assert read_nmnist(path, strict=False)["t"].tolist() == [9, 9]


def test_place_of_damage_counts_overflow_rows_in_bytes_not_in_events(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes([1, 1, 0, 0, 9]) + bytes([0, 240, 0, 0, 0]) * 2 + bytes([34, 1, 0, 0, 9]))
    with pytest.raises(ValueError, match=r"got x = 34, y = 1 at event 1 \(byte 15\)"):
        read_nmnist(path)


@settings(max_examples=200)
@given(raw=st.binary(max_size=200), sensor=st.sampled_from([(34, 34), None]))
def test_random_bytes_give_events_in_range_or_one_clear_error(tmp_path_factory, raw, sensor):
    path = tmp_path_factory.getbasetemp() / "fuzz.bin"
    path.write_bytes(raw)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kept = read_nmnist(path, strict=False, sensor=sensor)
    try:
        events = read_nmnist(path, sensor=sensor)
    except ValueError as error:
        assert "damaged N-MNIST recording" in str(error)
        events = kept
    np.testing.assert_array_equal(events, kept)
    assert (np.diff(events["t"]) >= 0).all() and (events["y"] != 240).all()
    if sensor is not None:
        assert (events["x"] < 34).all() and (events["y"] < 34).all()


@settings(max_examples=200)
@given(place=st.integers(0, 499), value=st.integers(0, 255))
def test_one_damaged_byte_is_an_error_or_changes_one_event(tmp_path_factory, place, value):
    path = tmp_path_factory.getbasetemp() / "damaged.bin"
    events = random_events(100, seed=3)
    write_nmnist(path, events)
    raw = bytearray(path.read_bytes())
    raw[place] = value
    path.write_bytes(raw)
    try:
        read = read_nmnist(path)
    except ValueError as error:
        assert "damaged N-MNIST recording" in str(error)
        return
    if raw[place // 5 * 5 + 1] == 240:  # has become a mark of overflow; nothing can tell
        assert len(read) == 99
        return
    assert (read != events).nonzero()[0].tolist() in ([], [place // 5])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((0, 34, 0, 0), r"`x` must be in \[0, 34\), got 34 at event 1"),
        ((0, 0, 99, 0), r"`y` must be in \[0, 34\), got 99 at event 1"),
        ((0, 0, 0, 2), "`p` must be 0 or 1, or -1 or \\+1, got 2 at event 1"),
        ((1 << 23, 0, 0, 0), r"`t` must be in \[0, 8388608\), got 8388608 at event 1"),
        ((-1, 0, 0, 0), r"`t` must be in \[0, 2\*\*62\) microseconds, got -1 at event 1"),
    ],
)
def test_values_that_do_not_fit_are_refused_and_nothing_is_written(tmp_path, row, message):
    with pytest.raises(ValueError, match=message):
        write_nmnist(tmp_path / "a.bin", events_of((0, 0, 0, 0), row))
    assert not (tmp_path / "a.bin").exists()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((0, 256, 0, 0), r"`x` must be in \[0, 256\), got 256 at event 0"),
        ((0, 0, 300, 0), r"`y` must be in \[0, 256\), got 300 at event 0"),
        ((0, 0, 240, 0), r"`y` must not be 240, the mark of a timer overflow, got 240 at event 0"),
    ],
)
def test_what_one_byte_cannot_hold_is_refused_on_any_sensor(tmp_path, row, message):
    with pytest.raises(ValueError, match=message):
        write_nmnist(tmp_path / "a.bin", events_of(row), sensor=None)


def test_unsorted_events_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"`t` must never decrease, got 4 at event 2"):
        write_nmnist(tmp_path / "a.bin", events_of((1, 0, 0, 0), (5, 0, 0, 0), (4, 0, 0, 0)))


@pytest.mark.parametrize("events", [np.zeros((3, 4), int), np.zeros(3, [("t", "i8"), ("x", "u2")]), {}, "abc"])
def test_what_is_not_events_is_refused(tmp_path, events):
    with pytest.raises((TypeError, ValueError), match="events"):
        write_nmnist(tmp_path / "a.bin", events)
    assert not (tmp_path / "a.bin").exists()
