"""What the landmarks do to constant flow, on the streaming side and with numbers (see docs)."""

import numpy as np
import pytest
from made import events_of

from async_tnt import TNTConfig, TNTVolume

WINDOW_US, T_MAX, N = 104_000, 2.0, 1300
V = 8  # pixels per window, to the right


def moving(v):
    """A cross of five pixels in the middle of the sensor, moving v pixels per window; an even event rate."""
    t = np.arange(N) * (WINDOW_US // N)
    place = np.arange(N) % 5
    x = 12 + 2 * np.array([0, 1, 2, 1, 1])[place] + np.rint(v * t / WINDOW_US).astype(int)
    y = 16 + 2 * np.array([1, 1, 1, 0, 2])[place]
    return events_of(t, x, y, np.ones(N, int))


def centre_of_each_bin(landmark, v, **settings):
    """Centroid along x of the volume's bins, relative to the same object at rest."""
    rows = []
    for speed in (v, 0):
        volume = TNTVolume(
            TNTConfig(window_us=WINDOW_US, t_max=T_MAX, landmark=landmark, polarity="unsigned", **settings)
        )
        volume.open(0)
        volume.update(moving(speed))
        array = volume.array.astype(np.float64)
        rows.append((array.sum((0, 1, 2)), (array * np.arange(34)).sum((1, 2)) / array.sum((1, 2))))
    return (rows[0][1] - rows[1][1])[2:]  # the first bins, at little TNT time, lose events over the border


def test_running_landmark_turns_flow_v_into_a_translation_by_half_of_it():
    assert centre_of_each_bin("running", V) == pytest.approx(V / 2 / T_MAX, abs=0.15)


def test_line_landmark_recovers_the_whole_translation():
    shift = centre_of_each_bin("line", V)
    assert shift[-4:] == pytest.approx(V / T_MAX, abs=0.25)
    assert shift[0] < V / T_MAX - 0.5  # the ridge: few events give the running centroid


def test_line_with_flow_removed_takes_the_translation_away():
    assert centre_of_each_bin("line", V, remove_flow=True)[-4:] == pytest.approx(0, abs=0.15)


def test_centroid_of_the_whole_window_leaves_no_translation():
    # v (1 - T / 2t) / t_max: from -4 at a quarter of the window to +2 at its end
    shift = centre_of_each_bin("window", V)
    assert shift[0] == pytest.approx(V / T_MAX * (1 - 4 / 2), abs=0.4)
    assert shift[-1] == pytest.approx(V / T_MAX * (1 - 1 / 2), abs=0.4)
    assert np.ptp(shift) > 5


@pytest.mark.parametrize(("v", "w"), [(8, -16), (-24, 8)])
def test_where_the_landmark_is_after_each_event_of_constant_flow(v, w):
    """Eight instants, a whole number of pixels apart, so that no rounding to pixels hides the law; to 1e-9 px.

    After instant k (f = k/8) the object is at v f. `running` trails by v f/2. `line` has found v C/(C + 1) of the
    flow and lies v f/2 / (C + 1) beside the object's start, with C = C_ff = 5 k (k + 1) (k + 2) / 12 / 64.
    The centroid of the window is at v f/2 as well, but for old events too, and that is what breaks it.
    """
    cross = np.array([(30, 30), (32, 30), (28, 30), (30, 32), (30, 28)])
    for landmark in ("running", "line", "window"):
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


def test_translated_stream_gives_the_identical_volume():
    """Proposition 3 with the landmarks that move along: the same bits where all is whole numbers (`running`, `line`).

    For any stream: tests/propositions/test_proposition_landmark.py.
    """
    events = moving(V)
    shifted = events.copy()
    shifted["x"] += 3
    shifted["y"] -= 5
    for landmark, bound in (("running", 0), ("line", 0), ("window", 1e-6)):
        volumes = []
        for stream in (events, shifted):
            volume = TNTVolume(TNTConfig(window_us=WINDOW_US, t_max=T_MAX, landmark=landmark))
            volume.open(0)
            volume.update(stream)
            volumes.append(volume.array.copy())
        assert np.abs(volumes[0]).max() > 1 and np.abs(volumes[0] - volumes[1]).max() <= bound
