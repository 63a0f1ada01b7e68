"""The place of each event in the figures.

It is the reference's, and the one that the streamed volume is made of.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, nasty_streams, opened, random_events, random_model

from async_tnt import TNTConfig
from async_tnt.kernels.volume.state import BLOCK
from async_tnt.views.figure_subject import Subject, _on_grid

CONFIGS = {
    "center": TNTConfig(landmark="center", t_max=3.0),
    "running": TNTConfig(landmark="running", t_max=3.0),
    "line": TNTConfig(landmark="line", t_max=2.0),
    "line, flow removed": TNTConfig(landmark="line", t_max=2.0, remove_flow=True),
    "window": TNTConfig(landmark="window", t_max=3.0),
    "regressor": TNTConfig(landmark="regressor", t_max=3.0),
    "center, another grid": TNTConfig(landmark="center", grid=(12, 70), t_max=3.0),
}
MODEL = random_model(CONFIGS["regressor"])
START_US = 1_000
EVENTS = random_events(3 * BLOCK + 5, start_us=START_US)


def window_of(events, config):
    """The window of these events, from START_US on."""
    model = MODEL if config.needs_regressor else None
    return Subject("made", events, config, model, "made", START_US).window(1)


def streamed(events, config):
    return opened(config, events, START_US, regressor=window_of(events, config).subject.regressor())


def equal_reference(events, config):
    tnt_reference = pytest.importorskip("tnt_reference")
    found = window_of(events, config).coordinates()
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
    return found


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_coordinates_equal_the_reference_and_drawn_volumes_the_stream(config):
    before = EVENTS.copy()
    window = window_of(EVENTS, config)
    volume = streamed(EVENTS, config)
    found = equal_reference(EVENTS, config)
    assert 0 < found.kept.sum() == volume.counts.kept < found.kept.size
    raw, tnt = window.volumes()
    without_transform = window.subject.config.replace(
        transform="none", landmark="center", remove_flow=False
    )
    np.testing.assert_array_equal(tnt, volume.array)
    np.testing.assert_array_equal(raw, streamed(EVENTS, without_transform).array)
    np.testing.assert_array_equal(EVENTS, before)


@given(
    st.data(),
    st.sampled_from(
        [CONFIGS[name] for name in ("center", "running", "line, flow removed", "window")]
    ),
)
def test_coordinates_equal_the_reference_on_nasty_streams(data, config):
    equal_reference(
        data.draw(nasty_streams(config.sensor, config.window_us, START_US).filter(len)), config
    )


def test_rounding_drops_no_event_on_the_border():
    within = [-1e-9, 0.0, 33.0, 33.0 + 9e-10]
    beyond = [-2e-9, 33.0 + 2e-9, np.inf, -np.inf, np.nan]
    assert _on_grid(np.array(within), 33).all() and not _on_grid(np.array(beyond), 33).any()


def test_one_event_by_hand():
    """TNT time 1/2 at an eighth of t_max = 4: the distance from the centre doubles."""
    events = events_of([START_US, START_US + 13_125], [3, 18], [4, 17], [0, 1])
    u, v, kept, landmark = window_of(events, TNTConfig(landmark="center", t_max=4.0)).coordinates()
    assert kept.tolist() == [False, True]  # TNT time is zero at the window's start
    assert (u[1], v[1]) == (19.5, 17.5) and landmark[1].tolist() == [16.5, 16.5]
