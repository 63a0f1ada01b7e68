"""Recordings in memory -> windows, split by recording."""

import numpy as np
from made import events_of

from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import make_windows


def recording(times_us):
    return events_of(times_us, *(np.full(len(times_us), value) for value in (5, 7, 1)))


def test_windows_from_zero_and_from_the_first_event():
    times = [[2_000, 104_999, 105_000, 316_000], [], [212_000]]
    recordings = Recordings.from_events(map(recording, times), [1, 2, 3])
    from_zero = make_windows(recordings, 105_000, duration_us=315_000)
    # none of 0's between 210 and 315 ms
    np.testing.assert_array_equal(from_zero.recording, [0, 0, 2])
    np.testing.assert_array_equal(from_zero.start_us, [0, 105_000, 210_000])
    np.testing.assert_array_equal(from_zero.labels, [1, 1, 3])
    from_first = make_windows(recordings, 105_000, first_event=True, duration_us=315_000)
    np.testing.assert_array_equal(from_first.recording, [0, 0, 2])
    np.testing.assert_array_equal(from_first.start_us, [2_000, 212_000, 212_000])
    assert len(make_windows(recordings, 400_000, which=[0], duration_us=315_000)) == 1


def test_windows_without_a_duration_reach_to_the_last_event():
    events = [recording([3, 102, 103, 2_000_000_003]), recording([50]), recording([])]
    windows = make_windows(Recordings.from_events(events, [0, 1, 1]), 100, first_event=True)
    np.testing.assert_array_equal(windows.recording, [0, 0, 0, 1])
    np.testing.assert_array_equal(windows.start_us, [3, 103, 2_000_000_003, 50])
