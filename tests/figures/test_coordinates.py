"""Where the figures put each event: what the reference says, and what the streamed volume is made of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of, nasty_streams, random_events, random_model

from async_tnt import TNTConfig, TNTVolume
from async_tnt.kernels.state import BLOCK
from async_tnt.views.coordinates import transformed
from async_tnt.views.figure_subject import Subject

CONFIGS = {
    "center": TNTConfig(landmark="center", t_max=3.0),
    "running": TNTConfig(landmark="running", t_max=3.0),
    "line": TNTConfig(landmark="line", t_max=2.0),
    "line, flow removed": TNTConfig(landmark="line", t_max=2.0, remove_flow=True),
    "window": TNTConfig(landmark="window", t_max=3.0),
    "regressor": TNTConfig(landmark="regressor", t_max=3.0),
    "another grid": TNTConfig(sensor=(34, 34), grid=(50, 21), t_max=3.0),
    "a fixed grid": TNTConfig(landmark="center", sensor=(34, 34), grid=(12, 70), t_max=3.0),
    "the mean on another grid": TNTConfig(landmark="window", sensor=(34, 34), grid=(40, 25), t_max=3.0),
    "split": TNTConfig(polarity="split", t_max=3.0),
    "no transform": TNTConfig(transform="none", grid=(20, 30)),
}
MODEL = random_model(CONFIGS["regressor"])
START_US = 1_000


def window_of(events, config):
    """Their window, from START_US on."""
    model = MODEL if config.needs_regressor else None
    return Subject("made", events, config, model, "made", START_US).window(1)


def landmark_at_reading(events, config):
    """The landmark (x, y) where it is known only then, as the streamed volume has it."""
    if not config.needs_replay:
        return None
    window = window_of(events, config)
    volume = TNTVolume(config, regressor=window.subject.regressor())
    volume.open(START_US)
    volume.update(events)
    return volume.landmark


def reference_coordinates(events, config):
    tnt_reference = pytest.importorskip("tnt_reference")
    where = dict(start_us=START_US, window_us=config.window_us, sensor=config.sensor, grid=config.grid)
    landmark = landmark_at_reading(events, config) if config.needs_regressor else config.landmark
    return tnt_reference.tnt_coordinates(
        events["t"],
        events["x"],
        events["y"],
        **where,
        t_max=config.t_max,
        landmark=landmark,
        remove_flow=config.remove_flow,
    )


def splatted(t, u, v, p, config):
    """The volume's equation, cell by cell and without any care for speed."""
    bins, height, width = config.bins, config.grid[1], config.grid[0]
    volume = np.zeros((2 if config.polarity == "split" else 1, bins, height, width))
    b = (bins - 1) * (t - START_US) / config.window_us

    def weights(place, n):
        return np.maximum(0, 1 - np.abs(np.arange(n) - place))

    for k in range(len(t)):
        cells = np.einsum("b,y,x->byx", weights(b[k], bins), weights(v[k], height), weights(u[k], width))
        if config.polarity == "split":
            volume[0 if p[k] else 1] += cells
        else:
            volume[0] += cells * (1 if p[k] or config.polarity == "unsigned" else -1)
    return volume.reshape(config.shape)


@pytest.mark.parametrize("name", [name for name in CONFIGS if name != "no transform"])
def test_coordinates_equal_the_reference(name):
    config = CONFIGS[name]
    events = random_events(3 * BLOCK + 5, start_us=START_US)
    ours = window_of(events, config).coordinates()
    u, v, kept = (column.numpy() for column in reference_coordinates(events, config))
    np.testing.assert_array_equal(ours.kept, kept)
    assert 0 < kept.sum() < kept.size
    np.testing.assert_allclose(ours.u[kept], u[kept], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.v[kept], v[kept], rtol=0, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.data(), st.sampled_from([CONFIGS[name] for name in ("center", "running", "line, flow removed", "window")]))
def test_coordinates_equal_the_reference_on_nasty_streams(data, config):
    events = data.draw(nasty_streams(config.sensor, config.window_us, START_US).filter(len))
    got = transformed(events, config, START_US, landmark_at_reading(events, config))
    u, v, kept = (column.numpy() for column in reference_coordinates(events, config))
    np.testing.assert_array_equal(got.kept, kept)
    np.testing.assert_allclose(got.u[kept], u[kept], rtol=0, atol=1e-8)
    np.testing.assert_allclose(got.v[kept], v[kept], rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", CONFIGS)
def test_the_streamed_volume_is_made_of_these_coordinates(name):
    config = CONFIGS[name]
    events = random_events(700, start_us=START_US, seed=1)
    window = window_of(events, config)
    u, v, kept, _ = window.coordinates()
    volume = TNTVolume(config, regressor=window.subject.regressor())
    volume.open(START_US)
    volume.update(events)
    expected = splatted(events["t"][kept], u[kept], v[kept], events["p"][kept], config)
    np.testing.assert_allclose(volume.array, expected, rtol=0, atol=1e-5)
    assert np.abs(expected).max() > 0.5
    assert kept.sum() == volume.counts.kept
    drawn = window.volumes()[0 if config.transform == "none" else 1]
    np.testing.assert_array_equal(drawn, volume.array)


def test_landmarks_are_the_points_that_events_were_centred_on():
    events = random_events(500, start_us=START_US, seed=2)
    n = np.arange(1, 501)
    running = transformed(events, CONFIGS["running"], START_US).landmark
    np.testing.assert_allclose(running[:, 0], np.cumsum(events["x"]) / n, atol=1e-12)
    np.testing.assert_allclose(running[:, 1], np.cumsum(events["y"]) / n, atol=1e-12)
    assert (transformed(events, CONFIGS["center"], START_US).landmark == 16.5).all()
    assert (transformed(events, CONFIGS["no transform"], START_US).landmark == (9.5, 14.5)).all()
    mean = landmark_at_reading(events, CONFIGS["window"])
    np.testing.assert_allclose(transformed(events, CONFIGS["window"], START_US, mean).landmark, [mean] * 500)
    line = transformed(events, CONFIGS["line"], START_US).landmark
    volume = TNTVolume(CONFIGS["line"])
    volume.open(START_US)
    volume.update(events)
    np.testing.assert_allclose(line[-1], volume.landmark, atol=1e-12)
    fraction = (events["t"][-1] - START_US) / CONFIGS["line"].window_us
    on_the_line = transformed(events, CONFIGS["line, flow removed"], START_US).landmark
    np.testing.assert_allclose(on_the_line[-1], np.add(volume.landmark, np.multiply(volume.flow, fraction)), atol=1e-9)


def test_one_event_by_hand():
    """TNT time 1/2 at an eighth of t_max = 4: the distance from the centre doubles."""
    events = events_of([START_US, START_US + 13_125], [3, 18], [4, 17], [0, 1])
    u, v, kept, landmark = transformed(events, TNTConfig(landmark="center", t_max=4.0), START_US)
    assert kept.tolist() == [False, True]  # TNT time is zero at the window's start
    assert (u[1], v[1]) == (19.5, 17.5) and landmark[1].tolist() == [16.5, 16.5]


def test_events_are_left_as_they_are_and_none_is_fine():
    events = random_events(400, start_us=START_US)
    before = events.copy()
    transformed(events, CONFIGS["running"], START_US)
    np.testing.assert_array_equal(events, before)
    assert [part.shape for part in transformed(events[:0], CONFIGS["line"], START_US)] == [(0,), (0,), (0,), (0, 2)]


def test_what_cannot_be_is_an_error():
    events = random_events(10, start_us=START_US)
    with pytest.raises(ValueError, match=r"`events` must lie in the window \[2000000, 2105000\) us, got \d+ to \d+"):
        transformed(events, CONFIGS["running"], 2_000_000)
    with pytest.raises(ValueError, match="`landmark` must be given for 'window'"):
        transformed(events, CONFIGS["window"], START_US)
    events["x"][4] = 34
    with pytest.raises(ValueError, match=r"`x` must be in \[0, 34\), got 34 at event 4"):
        transformed(events, CONFIGS["running"], START_US)
