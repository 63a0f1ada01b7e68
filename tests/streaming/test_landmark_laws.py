"""What the landmarks do to constant flow, in the stream and with numbers (docs/theory.md)."""

import numpy as np
import pytest
from made import events_of

from async_tnt import TNTConfig, TNTVolume

WINDOW_US, T_MAX, N = 104_000, 2.0, 1300
V = 8  # pixels per window, to the right


def volume_of(events, **settings):
    volume = TNTVolume(TNTConfig(window_us=WINDOW_US, t_max=T_MAX, **settings))
    volume.open(0)
    volume.update(events)
    return volume.array.astype(np.float64)


def moving(v):
    """A cross of five pixels in the middle of the sensor, moving v pixels per window; an even event rate."""
    t = np.arange(N) * (WINDOW_US // N)
    place = np.arange(N) % 5
    x = 12 + 2 * np.array([0, 1, 2, 1, 1])[place] + np.rint(v * t / WINDOW_US).astype(int)
    y = 16 + 2 * np.array([1, 1, 1, 0, 2])[place]
    return events_of(t, x, y, np.ones(N, int))


def shift_of_each_bin(landmark, **settings):
    """Centroid along x of the volume's bins, relative to the same object at rest."""
    centroids = []
    for v in (V, 0):
        array = volume_of(moving(v), landmark=landmark, polarity="unsigned", **settings)
        centroids.append((array * np.arange(34)).sum((1, 2)) / array.sum((1, 2)))
    return (centroids[0] - centroids[1])[2:]  # the first bins, at little TNT time, lose events over the border


def test_running_turns_flow_v_into_a_translation_by_half_of_it_and_line_by_all_of_it():
    assert shift_of_each_bin("running") == pytest.approx(V / 2 / T_MAX, abs=0.15)
    shift = shift_of_each_bin("line")
    assert shift[-4:] == pytest.approx(V / T_MAX, abs=0.25)
    assert shift[0] < V / T_MAX - 0.5  # the ridge: few events give the running centroid
    assert shift_of_each_bin("line", remove_flow=True)[-4:] == pytest.approx(0, abs=0.15)


def test_centroid_of_the_whole_window_leaves_no_translation():
    # v (1 - T / 2t) / t_max: from -4 at a quarter of the window to +2 at its end
    shift = shift_of_each_bin("window")
    assert shift[0] == pytest.approx(V / T_MAX * (1 - 4 / 2), abs=0.4)
    assert shift[-1] == pytest.approx(V / T_MAX * (1 - 1 / 2), abs=0.4)
    assert np.ptp(shift) > 5


@pytest.mark.parametrize(("v", "w"), [(8, -16), (-24, 8)])
@pytest.mark.parametrize("landmark", ["running", "line", "window"])
def test_where_the_landmark_is_after_each_event_of_constant_flow(v, w, landmark):
    """Eight instants, a whole number of pixels apart, so that no rounding to pixels hides the law; to 1e-9 px.

    After instant k (f = k/8) the object is at v f. `running` trails by v f/2. `line` has found v C/(C + 1) of the
    flow and lies v f/2 / (C + 1) beside the object's start, with C = C_ff = 5 k (k + 1) (k + 2) / 12 / 64.
    The centroid of the window is at v f/2 as well, but for old events too, and that is what breaks it.
    """
    cross = np.array([(30, 30), (32, 30), (28, 30), (30, 32), (30, 28)])
    volume = TNTVolume(TNTConfig(window_us=8_008, landmark=landmark, sensor=(61, 61), grid=(61, 61)))
    volume.open(0)
    for k in range(8):
        x, y = (cross + np.array([v, w]) * k // 8).T
        volume.update((np.full(5, 1_001 * k), x, y, np.ones(5, int)))
        share = 0.5
        if landmark == "line":
            c_ff = 5 * k * (k + 1) * (k + 2) / 12 / 64
            share /= c_ff + 1
            assert volume.flow == pytest.approx((v * c_ff / (c_ff + 1), w * c_ff / (c_ff + 1)), abs=1e-9)
        assert volume.landmark == pytest.approx((30 + v * k / 8 * share, 30 + w * k / 8 * share), abs=1e-9)
