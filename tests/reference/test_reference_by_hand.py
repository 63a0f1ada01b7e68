"""Volumes and landmarks that were computed with pencil and paper.

A comparison of twins cannot see an error that both have.
"""

from itertools import product

import pytest
import torch
from tnt_reference import (
    count_timestamp_image,
    event_volume,
    fitted_flow,
    landmark,
    time_image,
    tnt_volume,
    windows_of_events,
)

# 9 bins in 800 us: bin position = TNT time = t / 100. Centre of a 5 x 5 grid: (2, 2).
SQUARE = dict(start_us=0, window_us=800, sensor=(5, 5), grid=(5, 5))


def cells(volume):
    """The non-zero cells as {(bin, y, x): value}."""
    return {tuple(i.tolist()): pytest.approx(volume[tuple(i)].item()) for i in volume.nonzero()}


TNT = {"landmark": "center"}
# u = (4 - 3)/2 + 2 = 2.5, v = (2 - 1)/2 + 2 = 2.5
GIVEN = {(2, y, x): 0.25 for y in (2, 3) for x in (2, 3)}
ONE_EVENT = [  # t, x, y, settings of a transform or None, cells
    (0, 1, 3, None, {(0, 3, 1): 1.0}),  # the window's start: first bin
    (250, 1, 3, None, {(2, 3, 1): 0.5, (3, 3, 1): 0.5}),  # between bins
    (301, 1, 3, None, {(3, 3, 1): 0.99, (4, 3, 1): 0.01}),
    (800, 1, 3, None, {(8, 3, 1): 1.0}),  # t == end: exactly the last bin
    (-1, 1, 3, None, {}),
    (200, 4, 0, TNT, {(2, 1, 3): 1.0}),  # u = (4 - 2)/2 + 2 = 3, v = (0 - 2)/2 + 2 = 1
    (100, 4, 0, TNT, {(1, 0, 4): 1.0}),  # u = 4 = W - 1, v = 0: on the border, kept
    (99, 4, 2, TNT, {}),  # u = 2/0.99 + 2 > 4: off the right border
    (50, 2, 2, TNT, {(0, 2, 2): 0.5, (1, 2, 2): 0.5}),  # the landmark itself stays, however early
    (0, 2, 2, TNT, {}),  # tau = 0
    (800, 4, 2, TNT, {(8, 2, 2): 0.75, (8, 2, 3): 0.25}),  # t == end: u = 2/8 + 2
    (400, 3, 2, TNT | {"t_max": 2, "bins": 3}, {(1, 2, 3): 1.0}),  # tau = 2 * 400/800 = 1; b = 1
    (200, 4, 2, {"landmark": (3, 1)}, GIVEN),
    (200, 4, 2, {"landmark": torch.tensor([[3.0, 1.0]])}, GIVEN),
]


@pytest.mark.parametrize("t, x, y, transform, expected", ONE_EVENT)
def test_one_event(t, x, y, transform, expected):
    volume = event_volume if transform is None else tnt_volume
    assert cells(volume([t], [x], [y], [1], **SQUARE, **transform or {})) == expected


@pytest.mark.parametrize(
    ("x", "y"), [(0, 1), (3, 1), (1, 0), (2, 3)], ids=["left", "right", "top", "bottom"]
)
def test_a_billionth_of_a_pixel_past_the_border_is_inside_and_more_is_not(x, y):
    """A pixel at the side of four is 1.5 from the centre.

    k microseconds before tau = 1 of T, it is 4.17e-10 k past the border.
    """
    window_us = 3_600_000_000
    at = dict(
        start_us=0,
        window_us=window_us,
        sensor=(4, 4),
        grid=(4, 4),
        bins=2,
        t_max=1.0,
        landmark="center",
    )
    for k, kept in ((1, 1), (2, 1), (3, 0), (4, 0), (1000, 0)):
        volume = tnt_volume([window_us - k], [x], [y], [1], **at)
        assert volume.sum().item() == pytest.approx(kept), k


def test_eight_cells_and_polarities():
    # b = 1.5; x_g = 2 * 4 / 5 = 1.6; y_g = 4 * 4 / 5 = 3.2
    event = dict(t=[150], x=[2], y=[4], p=[0], **SQUARE | {"sensor": (6, 6)})
    k_x = {1: 0.4, 2: 0.6}
    k_y = {3: 0.8, 4: 0.2}
    for polarity, sign, first in (("signed", -1, 0), ("unsigned", 1, 0), ("split", 1, 9)):
        expected = {
            (first + b, y, x): sign * 0.5 * k_y[y] * k_x[x] for b, y, x in product((1, 2), k_y, k_x)
        }
        assert cells(event_volume(**event, polarity=polarity)) == expected


# x_g = x/2, y_g = y/2; c = (2, 1)
SMALL = dict(start_us=100, window_us=8, sensor=(9, 5), grid=(5, 3))


def test_centroids():
    where = dict(t=[101, 102, 103], x=[2, 4, 0], y=[1, 3, 2], **SMALL)
    assert landmark("center", **where).tolist() == [[2.0, 1.0]] * 3
    assert landmark("running", **where).tolist() == [[1.0, 0.5], [1.5, 1.0], [1.0, 1.0]]
    assert landmark("window", **where).tolist() == [[1.0, 1.0]] * 3


def test_line_is_the_ridge_intercept_of_the_events_so_far():
    t = [102, 106, 108]  # f = 0.25, 0.75, 1
    x = [2, 6, 7]
    y = [4, 0, 2]
    # 1 event:  C = 0: the event itself.
    # 2 events: mean_x 4, mean_f 1/2, C_xf = 2 (2/4) = 1, C_ff = 1/8: m = 8/9, l = 4 - 4/9 = 32/9.
    #           y: mean 2, C_yf = -1, m = -8/9, l = 2 + 4/9 = 22/9.
    # 3 events: mean_x 5, mean_f 2/3, df = -5/12, 1/12, 4/12; C_ff = 42/144 = 7/24;
    #           C_xf = (15 + 1 + 8)/12 = 2: m = 2/(31/24) = 48/31, l = 5 - 32/31 = 123/31.
    #           C_yf = (2 (-5) - 2 (1) + 0)/12 = -1: m = -24/31, l = 2 + 16/31 = 78/31.
    in_pixels = [[2, 4], [32 / 9, 22 / 9], [123 / 31, 78 / 31]]
    flow_in_pixels = [[0, 0], [8 / 9, -8 / 9], [48 / 31, -24 / 31]]
    assert landmark("line", t, x, y, **SMALL) * 2 == pytest.approx(torch.tensor(in_pixels))
    assert fitted_flow(t, x, y, **SMALL) * 2 == pytest.approx(torch.tensor(flow_in_pixels))


def test_events_outside_the_window_take_no_part():
    t = [99, 101, 109, 102, 0]
    x = [8, 2, 8, 4, 8]
    y = [4, 1, 4, 3, 4]
    for name in ("running", "line", "window"):
        rows = landmark(name, t, x, y, **SMALL)
        assert torch.equal(rows[[1, 3]], landmark(name, [101, 102], [2, 4], [1, 3], **SMALL))
        assert rows[[0, 2, 4]].tolist() == [[2.0, 1.0]] * 3  # the centre: filled in, never read
    assert fitted_flow(t, x, y, **SMALL)[[0, 2, 4]].tolist() == [[0.0, 0.0]] * 3


def test_windows_of_events_end_with_their_last_event_or_before_their_time_is_over():
    """A window lasts at most 20 us.

    An event exactly 20 us after a window's first event begins the next window.
    """
    times = [0, 5, 19, 20, 21, 40, 39, 41, 42, 43]
    for n, expected in (
        (9, [[0, 1, 2], [3, 4], [5, 7, 8, 9]]),  # 39 is older than its window
        (3, [[0, 1, 2], [3, 4], [5, 7, 8], [9]]),
        (1, [[0], [1], [2], [3], [4], [5], [6], [7], [8], [9]]),
    ):
        assert [one.tolist() for one in windows_of_events(times, n, 20)] == expected
    assert [one.tolist() for one in windows_of_events(times, 4)] == [
        [0, 1, 2, 3],
        [4, 5, 6, 7],
        [8, 9],
    ]
    assert windows_of_events([], 3, 20) == []


def test_an_image_of_counts_and_times_leaves_out_what_is_outside_its_window():
    """[10, 50) us: the event at 10 counts at time 0, one at 50 does not."""
    at = dict(start_us=10, window_us=40, sensor=(3, 2))
    image = count_timestamp_image([9, 10, 49, 50], [0, 1, 2, 0], [0, 0, 0, 1], [1, 1, 1, 1], **at)
    assert image[0].tolist() == [[0, 1, 1], [0, 0, 0]] and image[1].sum() == image[3].sum() == 0
    assert image[2].tolist() == [[0, 0, pytest.approx(39 / 40)], [0, 0, 0]]


def test_an_image_of_times_leaves_out_shares_below_a_billionth():
    """The newest event lies a rounding error beside a pixel.

    The pixel next to it keeps its own time.
    """
    shared = dict(start_us=0, window_us=8, sensor=(3, 3), grid=(3, 3), polarity="unsigned")
    for share, newest in ((1e-12, 2 / 8), (1e-6, 4 / 8)):
        image = time_image(
            [2, 4], [0, 1 - share], [1, 1], [1, 1], representation="count_time", **shared
        )
        assert image[1, 1, :2].tolist() == [newest, 4 / 8] and image[1].count_nonzero() == 2
