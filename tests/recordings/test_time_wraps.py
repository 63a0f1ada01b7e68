"""Clocks that start anew: times go on, through any number of wraps, with events a little out of order."""

import struct

import numpy as np
import pytest
from recordings.written import dat, evt2, evt3, evt21, evt_header, made_events

from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.time_wraps import unwrapped

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
        return unwrapped(np.array(raw), before, 100)[0].tolist()

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
