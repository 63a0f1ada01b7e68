"""TNTVolume against numbers worked out by hand: equality cannot see an error made on both sides."""

import numpy as np
import pytest

from async_tnt import TNTConfig, TNTVolume

RAW = TNTConfig(transform="none", window_us=800, bins=9)
# dt = 100 us: one bin, TNT time 1
TNT = TNTConfig(landmark="center", window_us=800, bins=9, t_max=8.0)


def volume_of(config, *events, start_us=0):
    volume = TNTVolume(config)
    volume.open(start_us)
    for event in events:
        volume.update_one(*event)
    return volume


def nonzero(array):
    return {tuple(map(int, place)): float(array[tuple(place)]) for place in np.argwhere(array)}


def cells(b, y, x, value=0.25):
    return {(b, v, u): value for v in y for u in x}


TWO = [(100, 10, 16, 1), (200, 14, 16, 1)]
# configuration, events after the window's start, cells; kept, dropped outside, dropped at TNT time
# zero
BY_HAND = {
    "the first event of a raw window is in bin 0": (RAW, [(0, 5, 7, 1)], {(0, 7, 5): 1.0}),
    "polarity -1 is OFF": (RAW, [(0, 3, 4, -1)], {(0, 4, 3): -1.0}),
    "between two bins by its distance": (
        RAW,
        [(225, 5, 7, 0)],
        {(2, 7, 5): -0.75, (3, 7, 5): -0.25},
    ),
    "OFF bins follow all ON bins": (
        RAW.replace(polarity="split"),
        [(100, 3, 4, 1), (225, 5, 7, 0)],
        {(1, 4, 3): 1.0, (9 + 2, 7, 5): 0.75, (9 + 3, 7, 5): 0.25},
    ),
    "a larger sensor is mapped corner to corner": (
        RAW.replace(sensor=(67, 67)),
        [(0, 66, 66, 1), (0, 0, 0, 1), (0, 33, 0, 1)],
        {(0, 33, 33): 1.0, (0, 0, 0): 1.0, (0, 0, 16): 0.5, (0, 0, 17): 0.5},
    ),
    # tau = 2: u = (20 - 16.5) / 2 + 16.5 = 18.25, v = (12 - 16.5) / 2 + 16.5 = 14.25
    "the transform divides the distance from the landmark by TNT time": (
        TNT,
        [(200, 20, 12, 1)],
        {(2, 14, 18): 9 / 16, (2, 14, 19): 3 / 16, (2, 15, 18): 3 / 16, (2, 15, 19): 1 / 16},
    ),
    # tau = 1: u = x; x = 33 lies on the border u = W - 1. A microsecond earlier it is past it.
    "the border itself is inside": (
        TNT,
        [(100, 33, 0, 1), (99, 33, 16, 1)],
        {(1, 0, 33): 1.0},
        (1, 1, 0),
    ),
    "TNT time zero is dropped": (TNT, [(0, 16, 16, 1)], {}, (0, 0, 1)),
    # Event 1 on itself: the centre. Event 2 (tau 2): centroid 12, u = (14 - 12) / 2 + 16.5 = 17.5.
    "running centres each event on the centroid so far": (
        TNT.replace(landmark="running", polarity="unsigned"),
        TWO,
        cells(1, (16, 17), (16, 17)) | cells(2, (16, 17), (17, 18)),
    ),
    # centroid (12, 16): event 1 at tau 1: u = 14.5; event 2 at tau 2: u = 17.5
    "window centres all events on the centroid at the read": (
        TNT.replace(landmark="window", polarity="unsigned"),
        TWO,
        cells(1, (16, 17), (14, 15)) | cells(2, (16, 17), (17, 18)),
    ),
}


@pytest.mark.parametrize("name", BY_HAND)
@pytest.mark.parametrize("start_us", [0, 1_700_000_000_000_000, (1 << 62) - 801])
def test_cells(name, start_us):
    """The same ones whenever the window starts: no microsecond is lost."""
    config, events, expected, *counted = BY_HAND[name]
    volume = volume_of(
        config, *((start_us + t, x, y, p) for t, x, y, p in events), start_us=start_us
    )
    assert nonzero(volume.array) == expected
    counts = volume.counts
    assert (counts.kept, counts.dropped_outside, counts.dropped_tau_zero) == (
        counted or [(len(events), 0, 0)]
    )[0]


def test_last_microsecond_goes_almost_whole_to_the_last_bin():
    array = volume_of(RAW, (799, 33, 33, 1)).array
    assert array[8, 33, 33] == np.float32(0.99) and array[7, 33, 33] == pytest.approx(
        0.01, abs=1e-7
    )


def test_a_ten_millionth_of_a_pixel_past_the_border_is_outside():
    """Only rounding is forgiven: tau = 1 - 1e-8 puts u at 33 + 1.65e-7."""
    config = TNT.replace(window_us=800_000_000)
    assert volume_of(config, (99_999_999, 33, 16, 1)).counts.dropped_outside == 1
    assert volume_of(config, (100_000_000, 33, 16, 1)).counts.kept == 1


@pytest.mark.parametrize(
    ("x", "y"), [(0, 1), (3, 1), (1, 0), (2, 3)], ids=["left", "right", "top", "bottom"]
)
def test_a_billionth_of_a_pixel_past_the_border_is_inside_and_more_is_not(x, y):
    """A pixel at the side of four is 1.5 from the centre.

    k microseconds before tau = 1 it is at 1.5 / (1 - k / T), 4.17e-10 k past the border. Events
    come in packets and one by one.
    """
    config = TNT.replace(sensor=(4, 4), grid=(4, 4), bins=2, window_us=3_600_000_000, t_max=1.0)
    for k, kept in ((1, 1), (2, 1), (3, 0), (4, 0), (25, 0), (1000, 0)):
        event = config.window_us - k, x, y, 1
        one = volume_of(config, event)
        many = volume_of(config)
        many.update([np.array([value]) for value in event])
        assert one.counts == many.counts and one.counts.kept == kept, k


def test_rounding_leaves_no_trace_at_the_border_nor_on_the_next_cell():
    """At tau = 13 / 13 the first column is at -3.6e-15.

    Pixel 49 of 50 is 1.1e-16 before the second column of two.
    """
    assert volume_of(TNT.replace(window_us=104), (13, 0, 33, 1)).counts.kept == 1
    times = TNTConfig(sensor=(50, 2), grid=(2, 2), window_us=40, representation="count_time")
    assert volume_of(times, (10, 49, 0, 1)).array[:2, 0].tolist() == [[0, 1], [0, 0.25]]


def test_line_landmark_is_the_ridge_line_at_the_windows_start():
    # f = 1/8, 3/8:  C_ff = 2 / 64
    # x = 10, 14:    C_xf = 2 * (1/8) * 2 = 1/2,  m_x = (1/2) / (1 + 1/32) = 16/33
    # y = 18, 12:    C_yf = -3/4,                 m_y = -24/33
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


def test_times_in_a_window_of_events_are_scaled_by_the_newest():
    """At TNT time 1 an event stays where it is, at 2 it has half its distance from the centre.

    The last bin is that of the newest event.
    """
    volume = TNTVolume(
        TNTConfig(sensor=(5, 3), grid=(5, 3), bins=3, t_max=2.0, landmark="center", window_events=3)
    )
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


def test_no_duration_puts_the_newest_event_beyond_the_last_bin():  # the first OFF bin
    for bins, newest_us in [(4, 187), (16, 29), (24, 21), (24, 22)]:
        volume = TNTVolume(
            TNTConfig(bins=bins, polarity="split", window_events=3, transform="none")
        )
        volume.update(([0, newest_us], [3, 4], [5, 6], [1, 1]))
        assert volume.array[:bins].sum() == 2 and not volume.array[bins:].any()


def test_a_regressors_landmark_is_the_centre():
    """bins 5, t_max 2, window 1000: t = 500 has tau 1 and bin 2; t = 750 has tau 1.5 and bin 3."""
    config = TNTConfig(
        sensor=(67, 34), grid=(34, 34), bins=5, window_us=1000, t_max=2.0, landmark="regressor"
    )
    volume = TNTVolume(config, regressor=lambda raw: (10.5, 8.5))
    volume.open(0)
    # The events are at (10.5, 9) and (13.5, 10) in grid pixels.
    volume.update(([500, 750], [21, 27], [9, 10], [1, 0]))
    expected = np.zeros((5, 34, 34), np.float32)
    expected[2, 17, 16:18] = 0.5  # u = 0 / 1 + 16.5, v = 0.5 / 1 + 16.5
    expected[3, 17:19, 18:20] = -0.25  # u = 3 / 1.5 + 16.5 = 18.5, v = 1.5 / 1.5 + 16.5 = 17.5
    assert np.abs(volume.array - expected).max() <= 1e-6
    assert (volume.counts.received, volume.counts.kept) == (2, 2)


# -- images: a window of 40 us from 10 us on -------------------------------------------------------


def image_of(events, **settings):
    config = TNTConfig(sensor=(3, 2), window_us=40, transform="none", polarity="split", **settings)
    return volume_of(config, *events, start_us=10).array


def test_the_images_of_a_configuration_by_hand():
    events = [(10, 0, 1, 1), (20, 2, 0, 0), (40, 2, 0, 0), (30, 2, 1, 1)]  # one comes late
    settings = {"grid": (3, 2)}
    on, off = image_of(events, representation="count", **settings)
    assert on.tolist() == [[0, 0, 0], [1, 0, 1]] and off.tolist() == [[0, 0, 2], [0, 0, 0]]
    n_on, t_on, n_off, t_off = image_of(events, representation="count_time", **settings)
    assert np.array_equal(n_on, on) and np.array_equal(n_off, off)
    assert t_on.tolist() == [[0, 0, 0], [0, 0, 0.5]] and t_off.tolist() == [[0, 0, 0.75], [0, 0, 0]]
    assert image_of(events, representation="mean_time", **settings)[1].tolist() == [
        [0, 0, 0.5],
        [0, 0, 0],
    ]
    # ages: 1, half and a quarter of the window
    on, off = image_of(events, representation="time_surface", **settings)
    newest_on = np.exp([-2.0, -1.0])
    newest_off = np.exp(-0.5)
    np.testing.assert_allclose(on, [[0, 0, 0], [newest_on[0], 0, newest_on[1]]], rtol=1e-6)
    np.testing.assert_allclose(off, [[0, 0, newest_off], [0, 0, 0]], rtol=1e-6)


def test_on_a_larger_grid_an_event_is_shared_by_the_cells_around_it():
    """A sensor of 3 pixels on a grid of 4: pixel 1 lies half way between columns 1 and 2."""
    events = [(20, 1, 0, 1), (30, 0, 0, 1)]
    settings = {"grid": (4, 2)}
    n_on, t_on, *_ = image_of(events, representation="count_time", **settings)
    assert n_on[0].tolist() == [1, 0.5, 0.5, 0] and t_on[0].tolist() == [0.5, 0.25, 0.25, 0]
    assert image_of(events, representation="mean_time", **settings)[0, 0].tolist() == [
        0.5,
        0.25,
        0.25,
        0,
    ]
