"""Volumes of a batch of windows are those of `TNTVolume`, and augmentation does what it says."""

import numpy as np
import pytest

from async_tnt.config import TNTConfig
from async_tnt.events import EVENT_DTYPE
from async_tnt.training.augment import FINE, Augmentation, unchanged
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.windows import Recordings, make_windows
from async_tnt.volume import TNTVolume

SENSOR = (34, 34)


def random_recordings(n=3, n_events=700, seed=0, sensor=SENSOR):
    rng = np.random.default_rng(seed)
    recordings = []
    for _ in range(n):
        events = np.empty(n_events, EVENT_DTYPE)
        events["t"] = np.sort(rng.integers(0, 330_000, n_events))
        events["x"], events["y"] = rng.integers(0, sensor[0], n_events), rng.integers(0, sensor[1], n_events)
        events["p"] = rng.integers(0, 2, n_events)
        recordings.append(events)
    return recordings


@pytest.mark.parametrize(
    "changes",
    [
        {"landmark": "center"},
        {"landmark": "running", "t_max": 2.0},
        {"landmark": "line", "polarity": "split"},
        {"landmark": "line", "remove_flow": True, "polarity": "unsigned"},
        {"landmark": "window"},
        {"transform": "none", "sensor": (64, 40)},
    ],
    ids=lambda changes: "-".join(map(str, changes.values())),
)
@pytest.mark.parametrize("first_event", [False, True])
def test_a_batch_equals_the_streamed_volumes(changes, first_event):
    config = TNTConfig(**changes)
    events = random_recordings(sensor=config.sensor)
    recordings = Recordings.from_events(events, [0, 1, 2])
    windows = make_windows(recordings, config.window_us, first_event=first_event)
    batch = BatchVolumes(config)(windows)
    assert batch.shape == (9, *config.shape)
    for k in range(len(windows)):
        recording, start = events[windows.recording[k]], int(windows.start_us[k])
        volume = TNTVolume(config)
        volume.open(start)
        inside = (recording["t"] >= start) & (recording["t"] < start + config.window_us)
        volume.update(recording[inside])
        assert np.abs(volume.array).max() > 0
        np.testing.assert_array_equal(batch[k], volume.array)


def test_a_partial_window_equals_the_streamed_volume_at_that_time():
    config = TNTConfig(landmark="line")
    events = random_recordings()
    windows = make_windows(Recordings.from_events(events, [0, 1, 2]), config.window_us)
    batch = BatchVolumes(config)(windows, unchanged(len(windows), config, until_us=40_000))
    volume = TNTVolume(config)
    volume.open(0)
    volume.update(events[0][events[0]["t"] < 40_000])
    np.testing.assert_array_equal(batch[0], volume.array)
    assert not batch[0, 5:].any() and batch[0, :4].any()  # 40 ms are 3.05 of 8 bins


def test_a_moved_start_takes_in_the_neighbouring_windows_events():
    config = TNTConfig(transform="none")
    windows = make_windows(Recordings.from_events(random_recordings(1), [0]), config.window_us)
    draws = Augmentation(5.0, 0, 0, 0, 0, 0, 0).draw(3, config, np.random.default_rng(1))
    draws.start_us[:] = -4_000, 5_000, 2_345
    moved = BatchVolumes(config)(windows, draws).copy()
    windows.start_us[:] += draws.start_us
    np.testing.assert_allclose(BatchVolumes(config)(windows), moved, atol=1e-5)  # another sensor: rounding


def one_event(x, y):
    return np.array([(50_000, x, y, 1)], EVENT_DTYPE)


@pytest.mark.parametrize(
    ("field", "value", "place"),
    [("shift", (2.0, -1.0), (22.0, 9.0)), ("turn", 90.0, (23.0, 20.0)), ("scale", 0.5, (18.25, 13.25))],
)
def test_places_by_hand(field, value, place):
    """An event at (20, 10), that is (3.5, -6.5) from the centre (16.5, 16.5)."""
    config = TNTConfig(transform="none")
    windows = make_windows(Recordings.from_events([one_event(20, 10)], [0]), config.window_us)
    draws = Augmentation(0, 0, 0, 0, 0, 0, 0).draw(1, config, np.random.default_rng(0))
    matrix = draws.matrix[0]
    centre = FINE * 16.5
    if field == "shift":
        matrix[:, 2] += FINE * np.array(value)
    else:  # x to the right, y downwards: a positive angle turns x towards y
        a = np.deg2rad(value) if field == "turn" else 0.0
        gain = value if field == "scale" else 1.0
        matrix[:, :2] = FINE * gain * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        matrix[:, 2] = centre - matrix[:, :2] @ [16.5, 16.5]
    volume = BatchVolumes(config)(windows, draws)[0]
    weight = volume.sum()
    ys, xs = np.mgrid[:34, :34]
    found = (volume.sum(0) * xs).sum() / weight, (volume.sum(0) * ys).sum() / weight
    assert weight == pytest.approx(1.0)
    assert found == pytest.approx(place, abs=0.5 / FINE)


def test_augmentation_of_nothing_changes_nothing():
    config = TNTConfig(landmark="running", t_max=2.0)
    windows = make_windows(Recordings.from_events(random_recordings(), [0, 1, 2]), config.window_us)
    plain = BatchVolumes(config)(windows)
    draws = Augmentation(0, 0, 0, 0, 0, 0, 0).draw(len(windows), config, np.random.default_rng(0))
    np.testing.assert_allclose(BatchVolumes(config)(windows, draws), plain, atol=1e-5)


def test_thinning_keeps_the_drawn_share():
    config = TNTConfig(transform="none", polarity="unsigned")
    recordings = Recordings.from_events(random_recordings(1, 60_000), [0])
    windows = make_windows(recordings, config.window_us)
    n_all = BatchVolumes(config)(windows).sum((1, 2, 3), dtype=np.float64)
    draws = unchanged(3, config)
    draws.keep[:] = 0.0, 0.25, 0.7
    draws.seed[:] = 1, 2, 3
    n_kept = BatchVolumes(config)(windows, draws).sum((1, 2, 3), dtype=np.float64)
    np.testing.assert_allclose(n_kept / n_all, [0.0, 0.25, 0.7], atol=0.015)  # 4 sd of 19,000 events


def test_the_same_generator_draws_the_same_and_another_does_not():
    config = TNTConfig()
    first, again, other = (Augmentation().draw(50, config, np.random.default_rng(s)) for s in (1, 1, 2))
    for name in ("start_us", "until_us", "matrix", "keep", "seed"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        assert not np.array_equal(getattr(first, name), getattr(other, name))


def test_draws_stay_within_the_stated_ranges():
    config = TNTConfig()
    draws = Augmentation(start_ms=5, drop=0.3, partial=0.25, partial_from_ms=15).draw(
        4_000, config, np.random.default_rng(0)
    )
    assert -5_000 <= draws.start_us.min() < -4_900 and 4_900 < draws.start_us.max() <= 5_000
    assert 0.7 <= draws.keep.min() < 0.71 and 0.99 < draws.keep.max() <= 1.0
    partial = draws.until_us < config.window_us
    assert partial.mean() == pytest.approx(0.25, abs=0.03)
    assert 15_000 <= draws.until_us.min() < 16_000
    gain = np.linalg.det(draws.matrix[:, :, :2]) / FINE**2  # scale^2: rotation and shear keep areas
    assert 0.81 <= gain.min() < 0.83 and 1.19 < gain.max() <= 1.21


def test_an_augmentation_out_of_range_is_refused():
    with pytest.raises(ValueError, match=r"`drop` must be in \[0, 1.0\], got 1.5"):
        Augmentation(drop=1.5)
