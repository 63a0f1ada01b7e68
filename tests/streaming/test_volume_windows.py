"""Windows, counts and errors of TNTVolume."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of, random_events

from async_tnt import Counts, ReplayBufferFull, TNTConfig, TNTVolume

CONFIG = TNTConfig(window_us=1000, landmark="center", t_max=1.0)


def test_first_event_opens_the_window():
    volume = TNTVolume(CONFIG)
    volume.update_one(777, 3, 3, 1)
    assert (volume.start_us, volume.n_events, volume.newest_us) == (777, 1, 777)


def test_window_is_half_open():
    volume = TNTVolume(CONFIG)
    volume.open(0)
    assert volume.update_one(999, 3, 3, 1) == 0 and volume.start_us == 0
    assert volume.update_one(1000, 3, 3, 1) == 1 and volume.start_us == 1000
    assert volume.n_events == 1


def test_next_window_lies_on_the_grid_and_empty_ones_are_skipped():
    volume = TNTVolume(CONFIG)
    volume.open(50)
    volume.update_one(60, 3, 3, 1)
    assert volume.update_one(60 + 10**15, 3, 3, 1) == 1
    assert volume.start_us == 50 + 10**15


def test_a_packet_may_close_several_windows():
    volume = TNTVolume(CONFIG)
    assert volume.update(([0, 1500, 1600, 2500, 9000], [1] * 5, [1] * 5, [1] * 5)) == 3
    assert (volume.start_us, volume.n_events) == (9000, 1)


def test_array_is_a_read_only_float32_view_of_the_open_window():
    volume = TNTVolume(CONFIG)
    volume.open(0)
    first = volume.array
    volume.update_one(500, 16, 16, 1)
    assert first is volume.array and first.any()
    assert first.dtype == np.float32 and first.shape == (9, 34, 34) and first.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0, 0] = 1
    volume.open(1000)
    assert not volume.array.any()


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.one_of(st.integers(1, 400), st.sampled_from(["read", "open"])), min_size=3, max_size=25),
    st.sampled_from([(34, 34), (90, 70), (300, 200)]),
    st.sampled_from(["running", "window"]),
    st.sampled_from(["signed", "split"]),
    st.integers(0, 1000),
)
def test_a_used_volume_equals_a_fresh_one(steps, sensor, landmark, polarity, seed):
    """Whatever was read and emptied before: large volumes are read and emptied only where events were."""
    config = CONFIG.replace(sensor=sensor, grid=sensor, landmark=landmark, polarity=polarity)
    used, start_us = TNTVolume(config), 0
    used.open(0)
    fresh = TNTVolume(config)
    fresh.open(0)
    for step in steps:
        seed += 1
        if step == "open":
            start_us += 1000
            used.open(start_us)
            fresh = TNTVolume(config)
            fresh.open(start_us)
        elif step == "read":
            assert np.array_equal(used.array, fresh.array)
        else:
            events = random_events(step, seed=seed, duration_us=1000, start_us=start_us, sensor=sensor)
            used.update(events)
            fresh.update(events)
    assert np.array_equal(used.array, fresh.array)


def test_events_before_the_open_window_are_dropped_and_counted():
    volume = TNTVolume(CONFIG.replace(landmark="running"))
    volume.open(1000)
    volume.update(([1500, 999, 0, 1600], [3, 30, 30, 3], [3, 30, 30, 3], [1, 1, 1, 1]))
    volume.update_one(5, 30, 30, 1)
    assert volume.counts == Counts(received=5, kept=2, dropped_late=3)
    assert volume.landmark == (3.0, 3.0)


def test_late_events_inside_the_window_are_accepted_by_default():
    volume = TNTVolume(CONFIG)
    volume.open(0)
    volume.update(([500, 400, 600], [3, 3, 3], [3, 3, 3], [1, 1, 1]))
    assert volume.counts.received == 3 and volume.counts.dropped_late == 0


def test_late_drop_drops_and_counts_what_is_older_than_the_newest():
    volume = TNTVolume(CONFIG, late="drop")
    volume.open(0)
    volume.update(([500, 400, 600, 599, 600], [16] * 5, [16] * 5, [1] * 5))
    volume.update_one(550, 16, 16, 1)
    assert volume.counts == Counts(received=6, kept=3, dropped_late=3)
    assert volume.n_events == 3


def test_late_raise_refuses_the_whole_packet():
    volume = TNTVolume(CONFIG, late="raise")
    volume.open(0)
    volume.update_one(500, 16, 16, 1)
    before = volume.array.tobytes(), volume.counts
    with pytest.raises(ValueError, match=r"`t` must not run backwards .*got 550 after 600 at event 1"):
        volume.update(([600, 550], [16, 16], [16, 16], [1, 1]))
    assert (volume.array.tobytes(), volume.counts) == before
    volume.update_one(500, 16, 16, 1)


def test_numpy_scalars_and_bools_are_events_too():
    plain, numpy = TNTVolume(CONFIG), TNTVolume(CONFIG)
    plain.update_one(300, 3, 4, 1)
    numpy.update_one(np.uint64(300), np.uint16(3), np.int8(4), np.bool_(True))
    assert plain.array.tobytes() == numpy.array.tobytes()
    numpy.update_one(301, 3, 4, True)
    assert numpy.n_events == 2


@pytest.mark.parametrize(
    "start_us, error", [(-1, ValueError), (1 << 62, ValueError), (0.5, TypeError), ("0", TypeError)]
)
def test_open_refuses_what_is_no_time(start_us, error):
    with pytest.raises(error):
        TNTVolume(CONFIG).open(start_us)


def test_open_says_what_it_wants():
    with pytest.raises(ValueError, match=r"`start_us` must be in \[0, 2\*\*62\), got -1"):
        TNTVolume(CONFIG).open(-1)


def test_flow_needs_the_line():
    with pytest.raises(ValueError, match=r"`flow` needs landmark=.line. and transform=.tnt., got landmark='center'"):
        _ = TNTVolume(CONFIG).flow


def test_full_replay_buffer_says_so_once_a_window_and_counts():
    volume = TNTVolume(CONFIG.replace(landmark="window"), replay_events=10)
    volume.open(0)
    events = random_events(30, seed=8, duration_us=1000)
    volume.update(events[:10])
    with pytest.warns(ReplayBufferFull, match="the replay buffer of 10 events is full"):
        volume.update(events[10:20])
    volume.update(events[20:])
    c = volume.counts
    assert (c.received, c.dropped_unstored) == (30, 20)
    assert c.kept + c.dropped_outside + c.dropped_tau_zero == 10
    assert volume.landmark == pytest.approx((events["x"].mean(), events["y"].mean()))
    volume.open(1000)
    with pytest.warns(ReplayBufferFull):
        volume.update(random_events(30, seed=9, duration_us=1000, start_us=1000))
    assert volume.counts.dropped_unstored == 40


def test_replay_buffer_grows_to_its_bound_only():
    volume = TNTVolume(TNTConfig(landmark="window"), replay_events=10_000)
    volume.open(0)
    volume.update(random_events(9_000, seed=10))
    assert volume.counts.received == 9_000 and volume.counts.dropped_unstored == 0
    with pytest.raises(ValueError, match="`replay_events` must be at least 1, got 0"):
        TNTVolume(TNTConfig(landmark="window"), replay_events=0)


def test_landmark_is_the_centre_where_none_is_defined():
    assert TNTVolume(CONFIG.replace(landmark="running")).landmark == (16.5, 16.5)
    volume = TNTVolume(CONFIG.replace(transform="none"))
    volume.update(events_of([0], [3], [4], [1]))
    assert volume.landmark == (16.5, 16.5)


def test_a_shallow_copy_shares_nothing():
    volume = TNTVolume(CONFIG)
    volume.update(random_events(50, duration_us=900))
    before, twin = volume.array.copy(), copy.copy(volume)
    twin.update_one(950, 16, 16, 1)
    assert np.array_equal(volume.array, before) and twin.n_events == 51
    with pytest.raises(ValueError, match="read-only"):
        twin.array[0, 0, 0] = 1
