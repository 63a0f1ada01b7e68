"""Prophesee's formats: words by hand, words of other kinds, and clocks that wrap."""

import struct

import numpy as np
import pytest
from recordings.written import dat, evt2, evt3, evt21, evt_header, made_events

from async_tnt.kernels.evt import FINE, decode_evt2, decode_evt3, decode_evt21, unwrap_times
from async_tnt.sources.files.recording import open_recording

MAKE = {"2.0": (evt2, "<u4", 28), "2.1": (evt21, "<u8", 60), "3.0": (evt3, "<u2", 12)}
KNOWN = {"2.0": (0, 1, 8), "2.1": (0, 1, 8), "3.0": (0, 2, 3, 4, 5, 6, 8)}
EVENTS = made_events(1_000, step_us=300)


@pytest.mark.parametrize("version", MAKE)
def test_other_words_change_nothing(tmp_path, version):
    make, dtype, shift = MAKE[version]
    more = ";endianness=little" if version == "2.1" else ""
    start = len(evt_header(version, more=more))
    data = make(EVENTS)
    words = np.frombuffer(data[start:], dtype)
    rng = np.random.default_rng(3)
    for kind in sorted(set(range(16)) - set(KNOWN[version])):
        others = rng.integers(0, 1 << shift, 200, dtype=np.uint64) | np.uint64(kind << shift)
        mixed = np.insert(words, np.sort(rng.integers(0, len(words) + 1, 200)), others.astype(dtype))
        (tmp_path / "a.raw").write_bytes(data[:start] + mixed.astype(dtype).tobytes())
        np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read(), EVENTS, err_msg=f"kind {kind}")


def written(path, version, words, more=""):
    path.write_bytes(evt_header(version, (2048, 2048), more) + np.array(words, MAKE[version][1]).tobytes())
    return open_recording(path).read().tolist()


def test_evt3_words_before_their_row_time_or_base_are_left_out(tmp_path):
    path = tmp_path / "a.raw"
    event, vector12, vector8, row, high = 0x2005, 0x4001, 0x5001, 0x0009, 0x8001
    assert written(path, "3.0", [high, event, row, event]) == [(4096, 5, 9, 0)]  # no row
    assert written(path, "3.0", [row, event, high, event]) == [(4096, 5, 9, 0)]  # no time
    assert written(path, "3.0", [high, row, vector12, vector8, 0x3007, vector12]) == [(4096, 7, 9, 0)]  # no base
    assert written(path, "3.0", [high, 0x3007, vector12, row, vector12]) == [(4096, 19, 9, 0)]  # base moves on
    assert written(path, "3.0", [row, 0x3807, vector8, high, vector12]) == [(4096, 15, 9, 1)]


def test_evt21_pixels_before_the_first_time_are_left_out(tmp_path):
    pixels, high = (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 0b11, 0x80000001 << 32
    got = written(tmp_path / "a.raw", "2.1", [pixels, high, pixels], ";endianness=little")
    assert got == [(69, 64, 9, 1), (69, 65, 9, 1)]


@pytest.mark.parametrize("version", MAKE)
def test_t0_is_added(tmp_path, version):
    make = MAKE[version][0]
    data = make(EVENTS).replace(b"% end\n", b"% t0 7000000\n% end\n")
    (tmp_path / "a.raw").write_bytes(data)
    np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read()["t"], EVENTS["t"] + 7_000_000)


def test_vectors_reach_the_last_column_and_not_beyond(tmp_path):
    path = tmp_path / "a.raw"
    assert written(path, "3.0", [0x8001, 0x0009, 0x3000 | 2036, 0x4800]) == [(4096, 2047, 9, 0)]
    word = (1 << 28 | 2016 << 11 | 9) << 32 | 1 << 31
    assert written(path, "2.1", [0x80000001 << 32, word], ";endianness=little") == [(64, 2047, 9, 1)]
    with pytest.warns(UserWarning, match="reaches beyond x = 2047"):
        assert written(path, "2.1", [0x80000001 << 32, word + (1 << 43)], ";endianness=little") == []
    with pytest.warns(UserWarning, match="reaches beyond x = 2047"):
        assert written(path, "3.0", [0x8001, 0x0009, 0x3000 | 2037, 0x4800]) == []


def test_evt21_without_endianness_is_legacy_only_without_a_format_line(tmp_path):
    little = (0x8 << 60 | 1 << 32, (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 1)
    swapped = [word >> 32 | (word & 0xFFFFFFFF) << 32 for word in little]
    for header, words in ((b"% format EVT21;height=720;width=1280\n", little), (b"% evt 2.1\n", swapped)):
        (tmp_path / "a.raw").write_bytes(header + np.array(words, "<u8").tobytes())
        assert open_recording(tmp_path / "a.raw").read().tolist() == [(69, 64, 9, 1)]


@pytest.mark.parametrize(("decode", "most"), [(decode_evt2, 1), (decode_evt21, 32), (decode_evt3, 12)])
def test_a_kernel_stops_while_there_is_room_for_a_whole_word(decode, most):
    """Numba does not check bounds: a write beyond the columns would change other memory."""
    if decode is decode_evt2:
        words = np.full(200, 1 << 28 | 7, np.uint32)
    elif decode is decode_evt21:
        words = np.tile(np.array([1 << 28 | 7, 0xFFFFFFFF], np.uint32), 100)
    else:
        words = np.tile(np.array([0x3000, 0x4FFF], np.uint16), 100)
    words.flags.writeable = False
    for size in range(most, most + 70):
        whole = [np.full(size + 40, 77, dtype) for dtype in (np.int64, np.uint16, np.uint16, np.uint8)]
        state = np.array([5, 0, 9, -1, 0, 0], np.int64)
        n, done, status = decode(words, 0, state, *(column[:size] for column in whole))
        assert (n, status) == (size // most * most, FINE) and done > 0
        assert all((column[size:] == 77).all() for column in whole)


def test_evt3_rows_are_of_whichever_camera(tmp_path):
    """Bit 11 of a row says master or slave of two cameras."""
    assert written(tmp_path / "a.raw", "3.0", [0x8001, 0x0809, 0x2005]) == [(4096, 5, 9, 0)]


def test_evt3_a_repeated_time_high_changes_nothing(tmp_path):
    """Cameras repeat it; the lower half stays as it was."""
    assert written(tmp_path / "a.raw", "3.0", [0x8001, 0x6005, 0x0009, 0x8001, 0x2005]) == [(4101, 5, 9, 0)]


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
    data = evt3(EVENTS)
    start = len(evt_header("3.0"))
    words = np.frombuffer(data[start:], "<u2")
    events = np.array([0x2001, 0x0003, 0x2002], "<u2")
    (tmp_path / "a.raw").write_bytes(data[:start] + events.tobytes() + words.tobytes())
    np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read(), EVENTS)


def test_dat_version_1(tmp_path):
    word = np.array([70, 1 << 17 | 200 << 9 | 300], "<u4").tobytes()
    (tmp_path / "a.dat").write_bytes(b"% Version 1\n% Width 304\n% Height 240\n\x00\x08" + word)
    recording = open_recording(tmp_path / "a.dat")
    assert recording.read().tolist() == [(70, 300, 200, 1)] and recording.sensor == (304, 240)


CLOCKS = [("a.dat", dat, 1 << 32), ("a.raw", evt2, 1 << 34), ("a.raw", evt21, 1 << 34), ("a.raw", evt3, 1 << 24)]


@pytest.mark.parametrize(("name", "make", "period_us"), CLOCKS)
def test_times_go_on_through_wraps(tmp_path, name, make, period_us):
    events = made_events(1_000, step_us=period_us // 200, start_us=period_us // 2)
    assert events["t"][-1] > 2 * period_us
    (tmp_path / name).write_bytes(make(events))
    recording = open_recording(tmp_path / name)
    np.testing.assert_array_equal(recording.read(), events)
    assert recording.n_unsorted == 0


@pytest.mark.parametrize("start", [0.1, 0.3, 0.7])
@pytest.mark.parametrize(("name", "make", "period_us"), CLOCKS)
def test_a_pause_of_less_than_half_a_period_is_one(tmp_path, name, make, period_us, start):
    events = made_events(100, step_us=50)
    events["t"] += int(start * period_us)
    events["t"][50:] += int(0.45 * period_us)
    (tmp_path / name).write_bytes(make(events))
    np.testing.assert_array_equal(open_recording(tmp_path / name).read(), events)


@pytest.mark.parametrize(("name", "make", "period_us"), CLOCKS)
def test_disorder_around_a_wrap_is_no_wrap(tmp_path, name, make, period_us):
    events = made_events(400, step_us=10_000, start_us=period_us - 1_000_000)
    events["t"][::7] -= 40_000
    events = events[1:]
    assert events["t"][0] < period_us < events["t"][-1]
    n_late = np.count_nonzero(events["t"][1:] < np.maximum.accumulate(events["t"])[:-1])
    (tmp_path / name).write_bytes(make(events))
    recording = open_recording(tmp_path / name)
    got = recording.read()
    np.testing.assert_array_equal(got, events)
    assert recording.n_unsorted == n_late > 40


def test_unwrapped_by_hand():
    def times(*raw, before=-1):
        t = np.array(raw, np.int64)
        last = unwrap_times(t, np.int64(before), np.int64(100))
        assert last == (t[-1] if len(t) else before)
        return t.tolist()

    assert times(10, 60, 95, 5, 50, 90, 20) == [10, 60, 95, 105, 150, 190, 220]
    assert times(95, 5, 97, 6) == [95, 105, 97, 106]
    assert times(50, 40, 41) == [50, 40, 41]
    assert times(5, 99) == [5, 99]  # a long gap: no time lies before 0
    assert times(5, before=395) == [405]
    assert times(0, before=150) == [100]  # half a period either way: back
    assert times(0, before=50) == [0]
    assert times() == []


@pytest.mark.parametrize("bit", range(32))
def test_one_fallen_bit_moves_no_other_event(tmp_path, bit):
    events = made_events(50)
    wrong = events.copy()
    wrong["t"][20] ^= 1 << bit
    (tmp_path / "a.dat").write_bytes(dat(wrong))
    got = np.delete(open_recording(tmp_path / "a.dat").read(), 20)
    np.testing.assert_array_equal(got, np.delete(events, 20))


def test_evt3_steps_back_of_the_upper_half(tmp_path):
    words = [0x8005, 0x6001, 0x0000, 0x2001, 0x8004, 0x6002, 0x2002]
    (tmp_path / "a.raw").write_bytes(evt_header("3.0") + struct.pack("<7H", *words))
    recording = open_recording(tmp_path / "a.raw")
    assert recording.read()["t"].tolist() == [5 << 12 | 1, 4 << 12 | 2]
    assert recording.n_unsorted == 1
