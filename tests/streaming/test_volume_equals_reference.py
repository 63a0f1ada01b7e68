"""The product's promise, on streams that look for trouble: stream == batch at every prefix, however cut."""

import numpy as np
import pytest
import tnt_reference
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made import nasty_streams, random_events

from async_tnt import TNTConfig, TNTVolume

CONFIGS = [
    TNTConfig(landmark=landmark, polarity=polarity, transform=transform, remove_flow=remove_flow)
    for landmark in ("center", "running", "line", "window")
    for polarity in ("signed", "unsigned", "split")
    for transform, remove_flow in (("tnt", False), ("none", False), ("tnt", True))
    if not remove_flow or landmark == "line"
    if transform == "tnt" or landmark == "center"
]
SHAPES = [  # sensor, grid, bins, window_us, t_max
    ((34, 34), (34, 34), 9, 105_000, 8.0),
    ((34, 34), (34, 34), 9, 800, 2.0),
    ((5, 3), (5, 3), 2, 7, 1.0),
    ((64, 48), (17, 23), 4, 1000, 3.7),
    ((2, 2), (2, 2), 1, 1, 8.0),
]
STARTS = [0, 123_456_789, 1_700_000_000_000_000]


def reference(events, config, start_us):
    columns = [events[name] for name in "txyp"]
    where = {
        "start_us": start_us,
        "window_us": config.window_us,
        "sensor": config.sensor,
        "grid": config.grid,
        "bins": config.bins,
        "polarity": config.polarity,
    }
    if config.transform == "none":
        return tnt_reference.event_volume(*columns, **where).numpy()
    return tnt_reference.tnt_volume(
        *columns, **where, t_max=config.t_max, landmark=config.landmark, remove_flow=config.remove_flow
    ).numpy()


def kept_by_reference(events, config, start_us):
    if config.transform == "none":
        return events.size
    columns = [events[name] for name in "txy"]
    return int(
        tnt_reference.tnt_coordinates(
            *columns,
            start_us=start_us,
            window_us=config.window_us,
            sensor=config.sensor,
            grid=config.grid,
            t_max=config.t_max,
            landmark=config.landmark,
            remove_flow=config.remove_flow,
        ).kept.sum()
    )


def assert_equals_reference(volume, events, config, start_us):
    expected = reference(events, config, start_us)
    # 1e-9 events: a volume below that has cancelled, and its rounding (1e-15 at most) is left
    assert np.abs(volume.array - expected).max() <= 1e-6 * max(np.abs(expected).max(), 1e-9)
    assert volume.counts.kept == kept_by_reference(events, config, start_us)
    if config.transform == "tnt" and events.size:
        where = {"start_us": start_us, "window_us": config.window_us, "sensor": config.sensor, "grid": config.grid}
        landmark = tnt_reference.landmark(config.landmark, *(events[name] for name in "txy"), **where)[-1]
        assert np.abs(np.subtract(volume.landmark, landmark.numpy())).max() <= 1e-9


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_update_equals_batch_at_every_prefix(data):
    sensor, grid, bins, window_us, t_max = data.draw(st.sampled_from(SHAPES))
    config = data.draw(st.sampled_from(CONFIGS)).replace(
        sensor=sensor, grid=grid, bins=bins, window_us=window_us, t_max=t_max
    )
    start_us = data.draw(st.sampled_from(STARTS))
    events = data.draw(nasty_streams(sensor, window_us, start_us, max_events=25))
    volume = TNTVolume(config)
    volume.open(start_us)
    assert_equals_reference(volume, events[:0], config, start_us)
    for n, event in enumerate(events.tolist(), start=1):
        volume.update_one(*event)
        assert_equals_reference(volume, events[:n], config, start_us)


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: f"{c.landmark}-{c.polarity}-{c.transform}-{c.remove_flow}")
def test_long_packets_take_the_block_path_to_the_same_bits(config):
    """Blocks of events run in vector registers, single events in scalars."""
    events = random_events(1500, seed=1)
    one, many = TNTVolume(config), TNTVolume(config)
    one.open(0), many.open(0)
    for event in events.tolist():
        one.update_one(*event)
    many.update(events)
    assert one.array.any()
    assert one.array.tobytes() == many.array.tobytes()
    assert (one.landmark, one.counts) == (many.landmark, many.counts)
    assert_equals_reference(many, events, config, 0)


def test_opposite_events_cancel_without_a_trace():
    """float32 sums would be off by their rounding here: 1000 ON events, then 999 OFF events, at one place."""
    n = 1000
    events = random_events(2 * n - 1, seed=2, duration_us=90_000)
    events["x"], events["y"] = 20, 21
    events["t"][n:] = events["t"][: n - 1]
    events["p"] = np.arange(2 * n - 1) < n
    config = TNTConfig(landmark="center")
    volume = TNTVolume(config)
    volume.open(0)
    volume.update(events)
    assert_equals_reference(volume, events, config, 0)


def test_cells_sum_to_the_kept_signs():
    events = random_events(1300, seed=3)
    for config in CONFIGS:
        volume = TNTVolume(config)
        volume.open(0)
        volume.update(events)
        if config.polarity == "signed":
            kept_on = TNTVolume(config.replace(polarity="split"))
            kept_on.open(0)
            kept_on.update(events)
            on, off = np.split(kept_on.array.astype(np.float64), 2)
            assert volume.array.sum(dtype=np.float64) == pytest.approx(on.sum() - off.sum(), abs=1e-4)
        else:
            assert volume.array.sum(dtype=np.float64) == pytest.approx(volume.counts.kept, abs=1e-4)
