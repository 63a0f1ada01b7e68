"""The product's promise, on streams of hard cases: stream == batch at every prefix.

That packets do not matter is a law of tests/test_laws.py.
"""

import numpy as np
import pytest
import tnt_reference
from hypothesis import given, settings
from hypothesis import strategies as st
from made import nasty_streams, opened, random_events, random_regressor_model

from async_tnt import CompiledRegressor, TNTConfig
from async_tnt.checking.reference import reference_landmark, reference_volume
from async_tnt.networks.models.torch_modules import landmark_function

TRANSFORMS = [
    {"landmark": "center"},
    {"landmark": "center", "transform": "none"},
    {"landmark": "running"},
    {"landmark": "line"},
    {"landmark": "line", "remove_flow": True},
    {"landmark": "window"},
]
CONFIGS = [
    TNTConfig(polarity=polarity, **settings)
    for settings in TRANSFORMS
    for polarity in ("signed", "unsigned", "split")
]
CONFIGS += [
    TNTConfig(representation=representation, polarity=polarity, transform="none")
    for representation in ("count", "count_time", "mean_time", "time_surface")
    for polarity in ("unsigned", "split")
]
# sensor, grid, bins, window_us, t_max
SHAPES = [
    ((34, 34), (34, 34), 9, 105_000, 8.0),
    ((34, 34), (34, 34), 9, 800, 2.0),
    ((5, 7), (5, 7), 2, 7, 1.0),
    ((64, 48), (17, 23), 4, 1000, 3.7),
    ((2, 2), (2, 2), 1, 1, 8.0),
]
STARTS = [0, 123_456_789, 1_700_000_000_000_000]


def reference_kept(events, config, start_us, landmark):
    return tnt_reference.tnt_coordinates(
        *(events[field] for field in "txy"),
        start_us=start_us,
        window_us=tnt_reference.until_newest(events["t"], start_us)
        if config.window_events
        else config.window_us,
        sensor=config.sensor,
        grid=config.grid,
        t_max=config.t_max,
        landmark=config.landmark if landmark is None else landmark,
        remove_flow=config.remove_flow,
    ).kept


def assert_equals_reference(volume, events, config, start_us, landmark=None):
    """landmark : where it is in the reference, or else as the configuration says."""
    expected = reference_volume(events, config, start_us, landmark)
    # 1e-9 events: a volume below that has cancelled, and its rounding (1e-15 at most) is left
    assert np.abs(volume.array - expected).max() <= 1e-6 * max(np.abs(expected).max(), 1e-9)
    if config.transform == "none":
        assert volume.counts.kept == events.size
    elif events.size:
        assert volume.counts.kept == reference_kept(events, config, start_us, landmark).sum()
        landmark = landmark or reference_landmark(events, config, start_us)
        assert np.abs(np.subtract(volume.landmark, landmark)).max() <= 1e-9


@given(st.data())
def test_update_equals_batch_at_every_prefix(data):
    sensor, grid, bins, window_us, t_max = data.draw(st.sampled_from(SHAPES))
    config = data.draw(st.sampled_from(CONFIGS)).replace(
        sensor=sensor, grid=grid, window_us=window_us, t_max=t_max
    )
    if config.representation == "volume":
        config = config.replace(bins=bins)
    config = config.replace(window_events=data.draw(st.sampled_from([None, 25])))
    start_us = data.draw(st.sampled_from(STARTS))
    events = data.draw(nasty_streams(sensor, window_us, start_us, max_events=25))
    volume = opened(config, start_us=start_us)
    assert_equals_reference(volume, events[:0], config, start_us)
    for n, event in enumerate(events.tolist(), start=1):
        volume.update_one(*event)
        assert_equals_reference(volume, events[:n], config, start_us)


LINES = [(7, 1), (1, 5), (1, 1)]
"""Sensors with a side of one pixel."""

PLAIN = [config for config in CONFIGS if config.transform == "none"]


@pytest.mark.parametrize("sensor", LINES, ids=str)
@given(data=st.data())
def test_a_line_of_pixels_equals_batch_at_every_prefix(sensor, data):
    config = data.draw(st.sampled_from(PLAIN)).replace(sensor=sensor, grid=sensor, window_us=800)
    events = data.draw(nasty_streams(sensor, 800, STARTS[1], max_events=25))
    volume = opened(config, start_us=STARTS[1])
    for n, event in enumerate(events.tolist(), start=1):
        volume.update_one(*event)
        assert_equals_reference(volume, events[:n], config, STARTS[1])


MODELS = [
    random_regressor_model(
        TNTConfig(
            sensor=sensor, grid=grid, bins=bins, window_us=window_us, t_max=t_max, polarity=polarity
        ),
        regressor_widths=widths,
        sharpness=20.0,
    )
    for (sensor, grid, bins, window_us, t_max), polarity, widths in (
        (SHAPES[0], "signed", (20, 20, 20)),
        (SHAPES[2], "unsigned", (8, 5, 17)),
        (SHAPES[3], "split", (8, 5, 17)),
    )
]
TORCH = {id(model): landmark_function(model) for model in MODELS}


@settings(max_examples=settings.default.max_examples // 4)  # a torch network at every prefix
@given(st.sampled_from(MODELS), st.sampled_from(STARTS), st.data())
def test_with_a_landmark_network_it_equals_batch_about_the_landmark_of_torch(model, start_us, data):
    config = model.config
    events = data.draw(nasty_streams(config.sensor, config.window_us, start_us, max_events=20))
    volume = opened(config, start_us=start_us, regressor=CompiledRegressor(model))
    for n, event in enumerate(events.tolist(), start=1):
        volume.update_one(*event)
        raw = reference_volume(events[:n], config.replace(transform="none"), start_us)
        assert np.abs(np.subtract(volume.landmark, TORCH[id(model)](raw))).max() <= 1e-4
        assert_equals_reference(volume, events[:n], config, start_us, volume.landmark)


@pytest.mark.parametrize(
    "config",
    CONFIGS,
    ids=lambda c: f"{c.representation}-{c.landmark}-{c.polarity}-{c.transform}-{c.remove_flow}",
)
def test_a_long_packet_equals_batch_and_its_cells_sum_to_the_events_kept(config):
    events = random_events(1500, seed=1)
    volume = opened(config, events)
    assert_equals_reference(volume, events, config, 0)
    if config.polarity != "signed" and config.representation in ("volume", "count"):
        assert volume.array.sum(dtype=np.float64) == pytest.approx(volume.counts.kept, abs=1e-4)


def test_opposite_events_cancel_without_a_trace():
    """float32 sums would be off by their rounding here.

    There are 1000 ON events, then 999 OFF events, at one place.
    """
    n = 1000
    events = random_events(2 * n - 1, seed=2, duration_us=90_000)
    events["x"] = 20
    events["y"] = 21
    events["t"][n:] = events["t"][: n - 1]
    events["p"] = np.arange(2 * n - 1) < n
    config = TNTConfig(landmark="center")
    assert_equals_reference(opened(config, events), events, config, 0)
