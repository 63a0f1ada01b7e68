"""TNTVolume against numbers worked out by hand: equality cannot see an error made on both sides."""

import numpy as np
import pytest

from async_tnt import TNTConfig, TNTVolume

RAW = TNTConfig(transform="none", window_us=800, bins=9)
TNT = TNTConfig(landmark="center", window_us=800, bins=9, t_max=8.0)  # dt = 100 us: one bin, TNT time 1


def volume_of(config, *events, start_us=0):
    volume = TNTVolume(config)
    volume.open(start_us)
    for event in events:
        volume.update_one(*event)
    return volume


def nonzero(array):
    return {tuple(map(int, place)): float(array[tuple(place)]) for place in np.argwhere(array)}


def test_first_event_of_a_raw_window_is_in_bin_0():
    assert nonzero(volume_of(RAW, (0, 5, 7, 1)).array) == {(0, 7, 5): 1.0}
    assert nonzero(volume_of(RAW, (0, 3, 4, -1)).array) == {(0, 4, 3): -1.0}  # polarity -1 is OFF


def test_event_between_two_bins_is_shared_by_its_distance():
    assert nonzero(volume_of(RAW, (225, 5, 7, 0)).array) == {(2, 7, 5): -0.75, (3, 7, 5): -0.25}


def test_last_microsecond_goes_almost_whole_to_the_last_bin():
    array = volume_of(RAW, (799, 33, 33, 1)).array
    assert array[8, 33, 33] == np.float32(0.99) and array[7, 33, 33] == pytest.approx(0.01, abs=1e-7)


def test_transform_divides_the_distance_from_the_landmark_by_tnt_time():
    # tau = 2 at dt = 200: u = (20 - 16.5) / 2 + 16.5 = 18.25, v = (12 - 16.5) / 2 + 16.5 = 14.25
    array = volume_of(TNT, (200, 20, 12, 1)).array
    weights = {14: 0.75, 15: 0.25}, {18: 0.75, 19: 0.25}
    assert nonzero(array) == {(2, v, u): weights[0][v] * weights[1][u] for v in (14, 15) for u in (18, 19)}


def test_the_transformed_border_itself_is_inside():
    # tau = 1: u = x; x = 33 lies on the border u = W - 1. A microsecond earlier it is past it.
    volume = volume_of(TNT, (100, 33, 0, 1), (99, 33, 16, 1))
    assert nonzero(volume.array) == {(1, 0, 33): 1.0}
    assert (volume.counts.kept, volume.counts.dropped_outside) == (1, 1)


def test_a_ten_millionth_of_a_pixel_past_the_border_is_outside():
    """Only rounding is forgiven: tau = 1 - 1e-8 puts u at 33 + 1.65e-7."""
    config = TNT.replace(window_us=800_000_000)
    assert volume_of(config, (99_999_999, 33, 16, 1)).counts.dropped_outside == 1
    assert volume_of(config, (100_000_000, 33, 16, 1)).counts.kept == 1


def test_tnt_time_zero_is_dropped_and_counted():
    volume = volume_of(TNT, (0, 16, 16, 1))
    assert not volume.array.any()
    assert volume.counts.dropped_tau_zero == 1 and volume.counts.kept == 0


def test_running_landmark_centres_each_event_on_the_centroid_so_far():
    # Event 1 on itself: the centre. Event 2 (tau 2): centroid 12, u = (14 - 12) / 2 + 16.5 = 17.5.
    volume = volume_of(TNT.replace(landmark="running", polarity="unsigned"), (100, 10, 16, 1), (200, 14, 16, 1))
    assert volume.landmark == (12.0, 16.0)
    array = volume.array
    assert array[1].sum() == 1.0 and array[1, 16, 16] == 0.25
    assert nonzero(array[2]) == {(16, 17): 0.25, (16, 18): 0.25, (17, 17): 0.25, (17, 18): 0.25}


def test_line_landmark_is_the_ridge_line_at_the_windows_start():
    # f = 1/8, 3/8: C_ff = 2 / 64. x = 10, 14: C_xf = 2 * (1/8) * 2 = 1/2, m_x = (1/2) / (1 + 1/32) = 16/33.
    # y = 18, 12: C_yf = -3/4, m_y = -24/33.
    volume = volume_of(TNT.replace(landmark="line"), (100, 10, 18, 1), (300, 14, 12, 1))
    assert volume.flow == pytest.approx((16 / 33, -24 / 33), abs=1e-12)
    assert volume.landmark == pytest.approx((12 - 16 / 33 / 4, 15 + 24 / 33 / 4), abs=1e-12)


def test_remove_flow_displaces_an_event_from_the_line_itself():
    # x - l_x - m_x f = 14 - 12 - (16/33)(3/8 - 1/4) = 2 - 2/33 at tau = 3: u = 16.5 + 64/99
    # y - l_y - m_y f = 12 - 15 + (24/33)(3/8 - 1/4) = -3 + 3/33:           v = 16.5 - 32/33
    config = TNT.replace(landmark="line", remove_flow=True, polarity="unsigned")
    array = volume_of(config, (100, 10, 18, 1), (300, 14, 12, 1)).array
    assert (array[3] * np.arange(34)).sum() == pytest.approx(16.5 + 64 / 99, abs=1e-5)
    assert (array[3].T * np.arange(34)).sum() == pytest.approx(16.5 - 32 / 33, abs=1e-5)


def test_window_landmark_centres_all_events_on_the_centroid_at_the_read():
    # centroid (12, 16): event 1 at tau 1: u = 14.5; event 2 at tau 2: u = 17.5
    volume = volume_of(TNT.replace(landmark="window", polarity="unsigned"), (100, 10, 16, 1), (200, 14, 16, 1))
    array = volume.array
    assert nonzero(array[1]) == {(v, u): 0.25 for v in (16, 17) for u in (14, 15)}
    assert nonzero(array[2]) == {(v, u): 0.25 for v in (16, 17) for u in (17, 18)}


def test_split_polarity_puts_off_bins_behind_on_bins():
    array = volume_of(RAW.replace(polarity="split"), (100, 3, 4, 1), (225, 5, 7, 0)).array
    assert nonzero(array) == {(1, 4, 3): 1.0, (9 + 2, 7, 5): 0.75, (9 + 3, 7, 5): 0.25}


def test_a_larger_sensor_maps_corner_to_corner():
    config = TNTConfig(sensor=(67, 67), grid=(34, 34), transform="none", window_us=800)
    array = volume_of(config, (0, 66, 66, 1), (0, 0, 0, 1), (0, 33, 0, 1)).array
    assert nonzero(array) == {(0, 33, 33): 1.0, (0, 0, 0): 1.0, (0, 0, 16): 0.5, (0, 0, 17): 0.5}


def test_times_in_a_window_of_events_are_scaled_by_the_newest():
    """At TNT time 1 an event stays where it is, at 2 it is at half its distance from the centre; the last bin is the
    newest event's."""
    volume = TNTVolume(TNTConfig(sensor=(5, 3), grid=(5, 3), bins=3, t_max=2.0, landmark="center", window_events=3))
    volume.update(([100, 150], [4, 4], [1, 1], [1, 1]))
    expected = np.zeros((3, 3, 5))
    expected[2, 1, 3] = 1  # tau = 2; the first event, at tau = 0, is dropped
    assert np.array_equal(volume.array, expected)
    volume.update_one(200, 2, 1, 0)
    expected[:] = 0
    expected[1, 1, 4] = 1  # now tau = 1, in the middle bin
    expected[2, 1, 2] = -1
    assert np.array_equal(volume.array, expected)
    assert volume.counts.dropped_tau_zero == 1
    volume.update_one(201, 0, 0, 1)  # the next window: one event, no duration
    assert not volume.array.any() and (volume.start_us, volume.n_events) == (201, 1)


@pytest.mark.parametrize("start_us", [0, 1_700_000_000_000_000, (1 << 62) - 801])
def test_epoch_sized_times_lose_nothing(start_us):
    array = volume_of(RAW, (start_us + 225, 5, 7, 1), start_us=start_us).array
    assert nonzero(array) == {(2, 7, 5): 0.75, (3, 7, 5): 0.25}


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
