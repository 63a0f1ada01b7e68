"""Landmark "regressor": the streamed volume equals the reference's, at every prefix and however cut."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made import nasty_streams, random_events, random_regressor_model

from async_tnt import Counts, ReplayBufferFull, TNTConfig, TNTVolume
from async_tnt.checking.reference import reference_kept, reference_volume
from async_tnt.networks.compiled import CompiledRegressor
from async_tnt.networks.torch_modules import landmark_function

SHAPES = [  # sensor, grid, bins, window_us, t_max
    ((34, 34), (34, 34), 9, 105_000, 8.0),
    ((34, 34), (34, 34), 9, 800, 2.0),
    ((5, 7), (5, 7), 2, 7, 4.0),
    ((64, 48), (17, 23), 4, 1000, 3.7),
]
STARTS = [0, 123_456_789, 1_700_000_000_000_000]
MODELS = [
    random_regressor_model(
        TNTConfig(sensor=sensor, grid=grid, bins=bins, window_us=window_us, t_max=t_max, polarity=polarity),
        regressor_widths=widths,
        sharpness=20.0,
        seed=seed,
    )
    for seed, (sensor, grid, bins, window_us, t_max) in enumerate(SHAPES)
    for polarity, widths in (("signed", (20, 20, 20)), ("split", (12, 9, 16)), ("unsigned", (8, 5, 17)))
]
TORCH = {id(model): landmark_function(model) for model in MODELS}
CONFIG = TNTConfig(window_us=1000, landmark="regressor", t_max=2.0)


def brightest(raw):
    """A regressor of one's own: the pixel with most events, in the middle of a grid cell."""
    y, x = np.unravel_index(np.abs(raw).sum(0).argmax(), raw.shape[1:])
    return x + 0.5, y + 0.25


def volume_of(model, **settings):
    return TNTVolume(model.config, regressor=CompiledRegressor(model), **settings)


def assert_equals_reference(volume, events, model, start_us):
    config, array = volume.config, volume.array
    raw = reference_volume(events, config.replace(transform="none"), start_us)
    expected = TORCH[id(model)](raw)
    offset = np.abs(np.subtract(volume.landmark, expected))
    assert offset.max() <= 1e-4
    about_ours = reference_volume(events, config, start_us, volume.landmark)
    largest = max(np.abs(about_ours).max(), 1e-9)  # below: cancelled
    assert np.abs(array - about_ours).max() <= 1e-6 * largest
    kept = reference_kept(events, config, start_us, volume.landmark)
    assert volume.counts.kept == kept.sum()
    # About the reference's own landmark: at TNT time tau an event lies offset / tau from where it lies about ours,
    # and its share of a cell changes by no more than that in x plus that in y. Where it crosses the border, the
    # outermost cells have or lack all of it.
    about_theirs = reference_volume(events, config, start_us, expected)
    same_kept = np.array_equal(kept, reference_kept(events, config, start_us, expected))
    inner = slice(None) if same_kept else slice(1, -1)
    tau = config.t_max * (events["t"] - start_us) / config.window_us
    bound = (offset.sum() / tau[kept]).sum() + 1e-6 * largest
    assert np.abs(array - about_theirs)[:, inner, inner].max() <= bound


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_update_equals_batch_at_every_prefix(data):
    model = data.draw(st.sampled_from(MODELS))
    config, start_us = model.config, data.draw(st.sampled_from(STARTS))
    events = data.draw(nasty_streams(config.sensor, config.window_us, start_us, max_events=20))
    volume = volume_of(model)
    volume.open(start_us)
    for n, event in enumerate(events.tolist(), start=1):
        volume.update_one(*event)
        assert_equals_reference(volume, events[:n], model, start_us)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.config.grid}-{m.config.polarity}")
def test_every_prefix_of_a_window_whose_landmark_wanders(model):
    sensor = tuple(side // 2 for side in model.config.sensor)
    events = random_events(60, sensor=sensor, duration_us=model.config.window_us, start_us=500, seed=3)
    volume, landmarks = volume_of(model), []
    volume.open(500)
    for n, event in enumerate(events.tolist(), start=1):
        volume.update_one(*event)
        assert_equals_reference(volume, events[:n], model, 500)
        landmarks.append(volume.landmark)
    from_center = np.abs(np.array(landmarks) - np.subtract(model.config.grid, 1) / 2)
    assert from_center.max() > 0.05 * max(model.config.grid)
    assert np.ptp(landmarks, axis=0).max() > 0.05
    assert volume.counts.kept > 5


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.one_of(st.integers(1, 400), st.sampled_from(["read", "open", "late"])), min_size=3, max_size=25),
    st.sampled_from([(34, 34), (90, 70)]),
    st.integers(0, 1000),
)
def test_a_used_volume_equals_a_fresh_one(steps, sensor, seed):
    config = CONFIG.replace(sensor=sensor, grid=sensor)
    used, start_us = TNTVolume(config, regressor=brightest), 1000
    fresh = TNTVolume(config, regressor=brightest)
    used.open(start_us), fresh.open(start_us)
    for step in steps:
        seed += 1
        if step == "open":
            start_us += 1000
            used.open(start_us)
            fresh = TNTVolume(config, regressor=brightest)
            fresh.open(start_us)
        elif step == "late":
            used.update_one(start_us - 1, 3, 3, 1)
        elif step == "read":
            assert (used.landmark, used.counts.kept >= 0) == (fresh.landmark, True)
            assert np.array_equal(used.array, fresh.array)
        else:
            events = random_events(step, seed=seed, duration_us=1000, start_us=start_us, sensor=sensor)
            used.update(events)
            fresh.update(events)
    assert np.array_equal(used.array, fresh.array)


# -- what a regressor sees and says --------------------------------------------------------------------------


def test_it_sees_the_raw_volume_of_its_window_read_only():
    seen = []

    def regressor(raw):
        with pytest.raises(ValueError, match="read-only"):
            raw[0, 0, 0] = 1
        seen.append(raw.copy())
        return 3.0, 4.0

    volume = TNTVolume(CONFIG, regressor=regressor)
    raw = TNTVolume(CONFIG.replace(transform="none"))
    for start_us in (0, 1000, 7000):
        events = random_events(300, seed=start_us, duration_us=1000, start_us=start_us)
        volume.open(start_us), raw.open(start_us)
        for part in np.split(events, [0, 1, 100]):
            volume.update(part), raw.update(part)
            _ = volume.array
            if part.size:
                assert seen[-1].dtype == np.float32 and seen[-1].tobytes() == raw.array.tobytes()
                assert volume.landmark == (3.0, 4.0)


def test_it_is_asked_once_until_new_events_come(monkeypatch):
    asked, replayed = [], []
    import async_tnt.deferred_landmark as module

    absorb = module.absorb
    monkeypatch.setattr(module, "absorb", lambda *args: replayed.append(1) or absorb(*args))
    volume = TNTVolume(CONFIG, regressor=lambda raw: asked.append(1) or (16.0, 16.0))
    volume.open(1000)
    _ = volume.array, volume.landmark, volume.counts
    assert (len(asked), len(replayed)) == (0, 0)
    volume.update_one(1500, 3, 3, 1)
    assert (len(asked), len(replayed)) == (0, 0)
    assert volume.landmark == (16.0, 16.0)
    assert (len(asked), len(replayed)) == (1, 0)
    for _ in range(3):
        _ = volume.array, volume.landmark, volume.counts
    assert (len(asked), len(replayed)) == (1, 1)
    volume.update_one(999, 3, 3, 1)  # late: not in the window
    volume.update([])
    _ = volume.array, volume.landmark, volume.counts
    assert (len(asked), len(replayed)) == (1, 1)
    volume.update_one(1500, 3, 3, 1)
    _ = volume.array, volume.landmark, volume.counts
    assert (len(asked), len(replayed)) == (2, 2)
    volume.open(2000)  # nothing new to ask about
    assert (len(asked), len(replayed)) == (2, 2)


def test_the_centre_before_the_first_event():
    config = CONFIG.replace(grid=(20, 11))
    volume = TNTVolume(config, regressor=lambda raw: (1.0, 2.0))
    assert volume.landmark == (9.5, 5.0) and not volume.array.any() and volume.counts == Counts()
    volume.update_one(5, 3, 3, 1)
    assert volume.landmark == (1.0, 2.0)
    volume.open(1000)
    assert volume.landmark == (9.5, 5.0) and not volume.array.any()
    volume.update_one(1005, 3, 3, 1)
    volume.close()
    assert volume.landmark == (9.5, 5.0) and not volume.array.any()


def test_by_hand():
    """bins 5, t_max 2, window 1000: t = 500 has tau 1 and bin 2; t = 750 has tau 1.5 and bin 3."""
    config = TNTConfig(sensor=(67, 34), grid=(34, 34), bins=5, window_us=1000, t_max=2.0, landmark="regressor")
    volume = TNTVolume(config, regressor=lambda raw: (10.5, 8.5))
    volume.open(0)
    volume.update(([500, 750], [21, 27], [9, 10], [1, 0]))  # in grid pixels (10.5, 9), (13.5, 10)
    expected = np.zeros((5, 34, 34), np.float32)
    expected[2, 17, 16:18] = 0.5  # u = 0 / 1 + 16.5, v = 0.5 / 1 + 16.5
    expected[3, 17:19, 18:20] = -0.25  # u = 3 / 1.5 + 16.5 = 18.5, v = 1.5 / 1.5 + 16.5 = 17.5
    assert np.abs(volume.array - expected).max() <= 1e-6
    assert volume.counts == Counts(received=2, kept=2)


def test_the_centre_as_answer_gives_the_bits_of_landmark_center():
    for sensor, grid in (((34, 34), (34, 34)), ((90, 70), (33, 20))):
        config = TNTConfig(sensor=sensor, grid=grid, window_us=1000, t_max=2.0, landmark="center")
        center = TNTVolume(config)
        c = np.subtract(grid, 1) / 2
        volume = TNTVolume(config.replace(landmark="regressor"), regressor=lambda raw, c=c: c)
        events = random_events(2000, seed=4, duration_us=3500, sensor=sensor)
        for part in np.split(events, 5):
            assert volume.update(part) == center.update(part)
            assert np.abs(volume.array - center.array).max() <= (0 if sensor == grid else 1e-6)
            assert volume.counts == center.counts and volume.array.any()


def test_a_landmark_far_outside_drops_everything():
    for far in (1e5, -1e308, 1e308):
        volume = TNTVolume(CONFIG, regressor=lambda raw, far=far: (far, 3.0))
        volume.update(random_events(50, duration_us=1000))
        assert volume.landmark == (far, 3.0) and not volume.array.any()
        c = volume.counts
        assert (c.received, c.kept) == (50, 0) and c.dropped_outside + c.dropped_tau_zero == 50


@pytest.mark.parametrize("kind", [tuple, list, np.array, lambda a: np.array(a, np.float32), lambda a: iter(a)])
def test_any_pair_of_numbers_is_an_answer(kind):
    volume = TNTVolume(CONFIG, regressor=lambda raw: kind([3.5, 4]))
    volume.update_one(5, 3, 3, 1)
    assert volume.landmark == (3.5, 4.0) and all(type(value) is float for value in volume.landmark)


def test_a_torch_module_may_be_the_regressor():
    import tnt_reference
    import torch

    module = tnt_reference.LandmarkRegressor()
    torch.nn.init.normal_(module.heatmap.weight, generator=torch.Generator().manual_seed(0))
    volume = TNTVolume(CONFIG, regressor=lambda raw: module(torch.tensor(raw)).detach())
    volume.update(random_events(500, duration_us=900, sensor=(17, 17)))
    assert volume.landmark == tuple(module(torch.tensor(volume._replay._raw.array)).tolist())


# -- windows, counts, copies ---------------------------------------------------------------------------------


def test_a_full_buffer_hides_the_same_events_from_replay_and_regressor():
    """So the promise to the reference holds for the events that are stored."""
    events = random_events(90, seed=8, duration_us=1000)
    model = random_regressor_model(CONFIG, sharpness=20.0)
    for size in (1, 7, 90):
        full, short = volume_of(model, replay_events=40), volume_of(model)
        full.open(0), short.open(0)
        short.update(events[:40])
        with pytest.warns(ReplayBufferFull, match="the replay buffer of 40 events is full"):
            for first in range(0, 90, size):
                full.update(events[first : first + size])
                _ = full.array
        assert full.array.tobytes() == short.array.tobytes() and full.landmark == short.landmark
        a, b = full.counts, short.counts
        assert (a.received, a.dropped_unstored, full.n_events) == (90, 50, 90)
        assert (a.kept, a.dropped_outside, a.dropped_tau_zero) == (b.kept, b.dropped_outside, b.dropped_tau_zero)
    full.open(1000)  # and the next window stores again
    full.update_one(1500, 3, 3, 1)
    assert full.counts.received == 91 and full.counts.dropped_unstored == 50


def test_without_the_transform_there_is_no_landmark():
    config = CONFIG.replace(transform="none")
    volume, plain = TNTVolume(config), TNTVolume(config.replace(landmark="running"))
    for v in (volume, plain):
        v.update(random_events(200, duration_us=900))
    assert volume.array.tobytes() == plain.array.tobytes()
    assert volume.landmark == (16.5, 16.5)
