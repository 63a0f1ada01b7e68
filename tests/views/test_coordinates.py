"""The place of each event in the figures: the reference's, and those that the streamed volume is made of."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, nasty_streams, random_events, random_model

from async_tnt import TNTConfig, TNTVolume
from async_tnt.kernels.state import BLOCK
from async_tnt.views.figure_subject import Subject, transformed

CONFIGS = {
    "center": TNTConfig(landmark="center", t_max=3.0),
    "running": TNTConfig(landmark="running", t_max=3.0),
    "line": TNTConfig(landmark="line", t_max=2.0),
    "line, flow removed": TNTConfig(landmark="line", t_max=2.0, remove_flow=True),
    "window": TNTConfig(landmark="window", t_max=3.0),
    "regressor": TNTConfig(landmark="regressor", t_max=3.0),
    "center, another grid": TNTConfig(landmark="center", grid=(12, 70), t_max=3.0),
}
RAW = TNTConfig(transform="none", grid=(20, 30))
MODEL = random_model(CONFIGS["regressor"])
START_US = 1_000
EVENTS = random_events(3 * BLOCK + 5, start_us=START_US)


def window_of(events, config):
    """Their window, from START_US on."""
    return Subject("made", events, config, MODEL if config.needs_regressor else None, "made", START_US).window(1)


def streamed(events, config):
    volume = TNTVolume(config, regressor=window_of(events, config).subject.regressor())
    volume.open(START_US)
    volume.update(events)
    return volume


def equal_reference(found, events, config):
    tnt_reference = pytest.importorskip("tnt_reference")
    u, v, kept = tnt_reference.tnt_coordinates(
        *(events[name] for name in "txy"),
        start_us=START_US,
        window_us=config.window_us,
        sensor=config.sensor,
        grid=config.grid,
        t_max=config.t_max,
        landmark=streamed(events, config).landmark if config.needs_regressor else config.landmark,
        remove_flow=config.remove_flow,
    )
    np.testing.assert_array_equal(found.kept, kept)
    np.testing.assert_allclose(found.u[found.kept], u[kept], rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.v[found.kept], v[kept], rtol=0, atol=1e-8)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_coordinates_equal_the_reference_and_drawn_volumes_the_stream(config):
    before, window, volume = EVENTS.copy(), window_of(EVENTS, config), streamed(EVENTS, config)
    found = window.coordinates()
    equal_reference(found, EVENTS, config)
    assert 0 < found.kept.sum() == volume.counts.kept < found.kept.size
    raw, tnt = window.volumes()
    np.testing.assert_array_equal(tnt, volume.array)
    np.testing.assert_array_equal(raw, streamed(EVENTS, window.subject.raw_config).array)
    np.testing.assert_array_equal(EVENTS, before)


@given(st.data(), st.sampled_from([CONFIGS[name] for name in ("center", "running", "line, flow removed", "window")]))
def test_coordinates_equal_the_reference_on_nasty_streams(data, config):
    events = data.draw(nasty_streams(config.sensor, config.window_us, START_US).filter(len))
    landmark = streamed(events, config).landmark if config.needs_replay else None
    equal_reference(transformed(events, config, START_US, landmark), events, config)


def test_without_the_transform_they_are_pixels_of_the_grid():
    u, v, kept, landmark = transformed(EVENTS, RAW, START_US)
    np.testing.assert_allclose([u, v], [EVENTS["x"] * 19 / 33, EVENTS["y"] * 29 / 33], atol=1e-12)
    assert kept.all() and (landmark == (9.5, 14.5)).all()


def test_landmarks_are_the_points_that_events_were_centred_on():
    def landmark(name, given=None):
        return transformed(EVENTS, CONFIGS[name], START_US, given).landmark

    n = np.arange(1, EVENTS.size + 1)
    running = np.stack([np.cumsum(EVENTS["x"]) / n, np.cumsum(EVENTS["y"]) / n], axis=1)
    np.testing.assert_allclose(landmark("running"), running, atol=1e-12)
    assert (landmark("center") == 16.5).all()
    mean = streamed(EVENTS, CONFIGS["window"]).landmark
    np.testing.assert_allclose(landmark("window", mean), [mean] * EVENTS.size)
    line = streamed(EVENTS, CONFIGS["line"])
    np.testing.assert_allclose(landmark("line")[-1], line.landmark, atol=1e-12)


def test_one_event_by_hand():
    """TNT time 1/2 at an eighth of t_max = 4: the distance from the centre doubles."""
    events = events_of([START_US, START_US + 13_125], [3, 18], [4, 17], [0, 1])
    u, v, kept, landmark = transformed(events, TNTConfig(landmark="center", t_max=4.0), START_US)
    assert kept.tolist() == [False, True]  # TNT time is zero at the window's start
    assert (u[1], v[1]) == (19.5, 17.5) and landmark[1].tolist() == [16.5, 16.5]
    assert [part.shape for part in transformed(events[:0], CONFIGS["line"], START_US)] == [(0,), (0,), (0,), (0, 2)]


def test_invalid_events_and_a_missing_landmark():
    with pytest.raises(ValueError, match=r"`events` must lie in the window \[2000000, 2105000\) us, got \d+ to \d+"):
        transformed(EVENTS, CONFIGS["running"], 2_000_000)
    with pytest.raises(ValueError, match="`landmark` must be given for 'window'"):
        transformed(EVENTS, CONFIGS["window"], START_US)
    with pytest.raises(ValueError, match=r"`x` must be in \[0, 34\), got 34 at event 0"):
        transformed(events_of([START_US], [34], [0], [1]), CONFIGS["running"], START_US)
