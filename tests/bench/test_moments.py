"""Moments of decisions: exactly so many new events, inside of windows, in order of time."""

from __future__ import annotations

import numpy as np
import pytest
from made import events_of, random_events, random_model

from async_tnt import TNTConfig, load_model
from async_tnt.checking.moments import Moments, bench_recordings, windows_of

WINDOW_US = 1000


def window(n: int, seed: int = 0) -> np.ndarray:
    return random_events(n, seed=seed, duration_us=WINDOW_US)


def test_windows_of_a_recording_by_hand():
    events = events_of([5, 999, 1000, 3500, 3501], [1, 2, 3, 4, 5], [0] * 5, [1] * 5)
    found = windows_of(events, WINDOW_US)  # the third window is empty
    assert [w["t"].tolist() for w in found] == [[5, 999], [0], [500, 501]]
    assert [w["x"].tolist() for w in found] == [[1, 2], [3], [4, 5]]
    assert windows_of(events[:0], WINDOW_US) == []
    assert events["t"].tolist() == [5, 999, 1000, 3500, 3501]  # the caller's are as they were


@pytest.mark.parametrize("n_new", [1, 3, 10])
def test_every_moment_has_so_many_new_events_after_the_first_one_of_its_window(n_new):
    moments = Moments([window(31), window(7, 1), window(2, 2)], WINDOW_US, n_new)
    assert moments.a_lap == 30 // n_new + 6 // n_new + 1 // n_new
    last = None
    for i in range(3 * moments.a_lap):
        moment = moments[i]
        assert moment.n_new == n_new and moment.start_us % WINDOW_US == 0
        assert (moment.events["t"] // WINDOW_US == moment.start_us // WINDOW_US).all()
        assert np.array_equal(moment.before.events, moment.events[:-n_new]) and moment.before.n_new == 0
        if moment.follows:
            assert np.array_equal(moment.before.events, last.events)
        else:
            assert len(moment.before.events) == 1
            assert last is None or moment.start_us > last.start_us
        last = moment


def test_blocks_are_spread_over_a_lap_and_begin_with_a_decision_of_their_own():
    moments = Moments([window(101)], WINDOW_US, 1)
    blocks = list(moments.blocks(4, 5))
    assert [[len(m.events) for m in block] for block in blocks] == [
        [2, 3, 4, 5, 6],
        [27, 28, 29, 30, 31],
        [52, 53, 54, 55, 56],
        [77, 78, 79, 80, 81],
    ]
    assert [[m.follows for m in block] for block in blocks] == [[False, True, True, True, True]] * 4


def test_blocks_that_need_more_than_a_lap_go_on_in_time():
    moments = Moments([window(11)], WINDOW_US, 5)
    starts = [m.start_us for block in moments.blocks(3, 4) for m in block]
    assert starts == [0, 0, 1000, 1000, 2000, 2000, 3000, 3000, 4000, 4000, 5000, 5000]


def test_windows_that_are_too_short_are_refused():
    with pytest.raises(ValueError, match="a window of at least 11 events is needed, the longest has 10"):
        Moments([window(10), window(3)], WINDOW_US, 10)
    with pytest.raises(ValueError, match="at least 2 events is needed, the longest has 0"):
        Moments([], WINDOW_US, 1)


def test_the_bundled_recordings_give_thirty_windows_of_which_some_have_1300_events():
    model = load_model("digits")
    windows = [w for events in bench_recordings(model) for w in windows_of(events, model.config.window_us)]
    assert len(windows) == 30 and sum(len(w) > 1300 for w in windows) > 10


def test_another_sensor_gets_made_recordings_of_as_many_windows():
    model = random_model(TNTConfig(sensor=(50, 40), grid=(24, 20)))
    windows = [w for events in bench_recordings(model, seed=3) for w in windows_of(events, model.config.window_us)]
    assert len(windows) == 30 and all(len(w) > 1300 for w in windows)
    assert max(int(w["x"].max()) for w in windows) == 49
