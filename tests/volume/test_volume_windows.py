"""Windows, counts and errors of TNTVolume."""

import copy

import numpy as np
import pytest
from made import random_events

from async_tnt import ReplayBufferFull, TNTConfig, TNTVolume

CONFIG = TNTConfig(window_us=1000, landmark="center", t_max=1.0)


def opened(config=CONFIG, start_us=0, **settings):
    volume = TNTVolume(config, **settings)
    volume.open(start_us)
    return volume


def brightest(raw):
    """A regressor: the pixel with the most events, beside the middle of its grid cell."""
    y, x = np.unravel_index(np.abs(raw).sum(0).argmax(), raw.shape[1:])
    return x + 0.5, y + 0.25


@pytest.mark.parametrize("landmark", ["center", "window"])
def test_window_is_half_open(landmark):
    volume = opened(CONFIG.replace(landmark=landmark))
    assert volume.update_one(999, 3, 3, 1) == 0 and volume.start_us == 0
    assert volume.update_one(1000, 3, 3, 1) == 1 and volume.start_us == 1000
    assert volume.update_one(999, 30, 30, 1) == 0 and volume.n_events == 1
    assert volume.counts.dropped_late == 1
    assert volume.update_one(10**15 + 7, 3, 3, 1) == 1 and volume.start_us == 10**15


def test_array_is_a_read_only_float32_view_of_the_open_window():
    volume = opened()
    first = volume.array
    volume.update_one(500, 16, 16, 1)
    assert first is volume.array and first.any()
    assert first.dtype == np.float32 and first.shape == (9, 34, 34) and first.flags.c_contiguous
    for array in (first, copy.copy(volume).array):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0, 0] = 1
    volume.open(1000)
    assert not volume.array.any()


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"`start_us` must be in \[0, 2\*\*62\), got -1"):
        TNTVolume(CONFIG).open(-1)
    with pytest.raises(TypeError, match=r"`start_us` must be a whole number, got 0\.5"):
        TNTVolume(CONFIG).open(0.5)
    with pytest.raises(ValueError, match="`replay_events` must be at least 1, got 0"):
        TNTVolume(TNTConfig(landmark="window"), replay_events=0)
    with pytest.raises(ValueError, match=r"`flow` needs landmark=.line. and transform=.tnt., got landmark='center'"):
        _ = TNTVolume(CONFIG).flow


@pytest.mark.parametrize("landmark", ["window", "regressor"])
@pytest.mark.parametrize("size", [7, 90])
def test_a_full_replay_buffer_warns_once_a_window_and_counts(landmark, size):
    """The volume is that of the events that are stored; the centroid is that of all."""
    config = CONFIG.replace(landmark=landmark)
    regressor = {"regressor": brightest} if landmark == "regressor" else {}
    full, short = opened(config, replay_events=40, **regressor), opened(config, **regressor)
    for start_us in (0, 1000):
        full.open(start_us), short.open(start_us)
        events = random_events(90, seed=8, duration_us=1000, start_us=start_us)
        short.update(events[:40])
        with pytest.warns(ReplayBufferFull, match="the replay buffer of 40 events is full") as warned:
            for first in range(0, 90, size):
                full.update(events[first : first + size])
                _ = full.array
        assert len(warned) == 1
        a, b = full.counts, short.counts
        assert (a.kept + a.dropped_outside, a.dropped_tau_zero) == (b.kept + b.dropped_outside, b.dropped_tau_zero)
        if landmark == "regressor":
            assert full.array.tobytes() == short.array.tobytes() and full.landmark == short.landmark
        else:
            assert full.landmark == pytest.approx((events["x"].mean(), events["y"].mean()))
    assert (a.received, a.dropped_unstored, full.n_events) == (180, 100, 90)


def test_the_replay_buffer_grows_to_its_bound_and_loses_nothing():
    whole, cut = (opened(CONFIG.replace(landmark="window"), replay_events=10_000) for _ in range(2))
    events = random_events(9_000, seed=10, duration_us=1000)
    whole.update(events)
    for part in np.array_split(events, 9):
        cut.update(part)
    assert whole.array.any() and cut.array.tobytes() == whole.array.tobytes()
    assert cut.counts == whole.counts and cut.counts.dropped_unstored == 0
