"""Volumes and landmarks worked out with pencil and paper: twins cannot see an error made on both sides."""

import numpy as np
import pytest
import torch
from tnt_reference import event_volume, fitted_flow, hats, landmark, tnt_coordinates, tnt_volume

# 9 bins in 800 us: bin position = TNT time = t / 100. Centre of a 5 x 5 grid: (2, 2).
SQUARE = dict(start_us=0, window_us=800, sensor=(5, 5), grid=(5, 5))


def cells(volume):
    """The non-zero cells as {(bin, y, x): value}."""
    return {tuple(i.tolist()): pytest.approx(volume[tuple(i)].item()) for i in volume.nonzero()}


def one(volume, t, x, y, p=1, **options):
    return cells(volume(t=[t], x=[x], y=[y], p=[p], **{**SQUARE, **options}))


@pytest.mark.parametrize(
    "t, expected",
    [
        (0, {(0, 3, 1): 1.0}),  # the window's start: first bin
        (250, {(2, 3, 1): 0.5, (3, 3, 1): 0.5}),  # between bins
        (300, {(3, 3, 1): 1.0}),  # on a bin: no share for its neighbours
        (301, {(3, 3, 1): 0.99, (4, 3, 1): 0.01}),
        (799, {(7, 3, 1): 0.01, (8, 3, 1): 0.99}),
        (800, {(8, 3, 1): 1.0}),  # t == end: exactly the last bin
        (-1, {}),
    ],
)
def test_an_event_lies_between_two_bins(t, expected):
    assert one(event_volume, t, x=1, y=3) == expected


@pytest.mark.parametrize("x, y", [(0, 0), (4, 0), (0, 4), (4, 4)])
def test_corner_pixels_stay_in_their_corner(x, y):
    assert one(event_volume, 400, x, y, p=0) == {(4, y, x): -1.0}


def test_a_larger_sensor_maps_corner_to_corner():
    larger = dict(sensor=(9, 5), grid=(5, 3))
    assert one(event_volume, 100, 8, 4, **larger) == {(1, 2, 4): 1.0}
    # x_g = 3 * 4 / 8 = 1.5,  y_g = 1 * 2 / 4 = 0.5
    quarter = {(1, y, x): -0.25 for y in (0, 1) for x in (1, 2)}
    assert one(event_volume, 100, 3, 1, p=0, **larger) == quarter


def test_eight_cells():
    # b = 1.5; x_g = 2 * 4 / 5 = 1.6; y_g = 4 * 4 / 5 = 3.2
    volume = one(event_volume, 150, 2, 4, sensor=(6, 6))
    k_x, k_y = {1: 0.4, 2: 0.6}, {3: 0.8, 4: 0.2}
    assert volume == {(b, y, x): 0.5 * k_y[y] * k_x[x] for b in (1, 2) for y in k_y for x in k_x}


def test_polarities():
    two = dict(t=[100, 100, 100], x=[1, 1, 2], y=[0, 0, 3], p=[1, 0, 0], **SQUARE)
    assert cells(event_volume(**two)) == {(1, 3, 2): -1.0}  # ON and OFF on one pixel cancel
    assert cells(event_volume(**two, polarity="unsigned")) == {(1, 0, 1): 2.0, (1, 3, 2): 1.0}
    split = event_volume(**two, polarity="split")
    assert split.shape == (18, 5, 5)
    assert cells(split) == {(1, 0, 1): 1.0, (9 + 1, 0, 1): 1.0, (9 + 1, 3, 2): 1.0}


@pytest.mark.parametrize(
    "t, x, y, expected",
    [
        (200, 4, 0, {(2, 1, 3): 1.0}),  # u = (4 - 2)/2 + 2 = 3, v = (0 - 2)/2 + 2 = 1
        (100, 4, 0, {(1, 0, 4): 1.0}),  # u = 4 = W - 1, v = 0: on the border, kept
        (99, 4, 2, {}),  # u = 2/0.99 + 2 > 4: off the right border
        (99, 2, 0, {}),
        (50, 2, 2, {(0, 2, 2): 0.5, (1, 2, 2): 0.5}),  # the landmark itself stays, however early
        (0, 2, 2, {}),  # tau = 0
        (800, 4, 2, {(8, 2, 2): 0.75, (8, 2, 3): 0.25}),  # t == end: u = 2/8 + 2
    ],
)
def test_tnt_about_the_centre(t, x, y, expected):
    assert one(tnt_volume, t, x, y, landmark="center") == expected


def test_t_max_is_independent_of_the_bins():
    # tau = 2 * 400/800 = 1, b = 4
    assert one(tnt_volume, 400, 3, 2, landmark="center", t_max=2) == {(4, 2, 3): 1.0}
    # b = 2 * 400/800 = 1
    assert one(tnt_volume, 400, 3, 2, landmark="center", t_max=2, bins=3) == {(1, 2, 3): 1.0}


def test_tnt_about_a_given_point():
    # u = (4 - 3)/2 + 2 = 2.5, v = (2 - 1)/2 + 2 = 2.5
    quarter = {(2, y, x): 0.25 for y in (2, 3) for x in (2, 3)}
    assert one(tnt_volume, 200, 4, 2, landmark=(3, 1)) == quarter
    assert one(tnt_volume, 200, 4, 2, landmark=torch.tensor([[3.0, 1.0]])) == quarter


def test_running_centres_each_event_on_the_events_so_far():
    # l_x: 1, (1 + 4)/2 = 2.5, (1 + 4 + 1)/3 = 2;  tau: 1, 2, 4.  l_y = 2 throughout.
    u, v, kept = tnt_coordinates([100, 200, 400], [1, 4, 1], [2, 2, 2], landmark="running", **SQUARE)
    assert u.tolist() == [2.0, 2.75, 1.75]
    assert v.tolist() == [2.0, 2.0, 2.0]
    assert kept.all()


def test_line_with_and_without_its_flow():
    # f = 0.25, 0.75, x = 1, 3: C_xf = 2 (1 * 0.25) = 0.5, C_ff = 2 (1/16) = 1/8,
    # m = 0.5 / (1 + 1/8) = 4/9, l = 2 - 4/9 * 1/2 = 16/9; event 2 has tau = 6.
    stream = dict(t=[200, 600], x=[1, 3], y=[2, 2], landmark="line", **SQUARE)
    u, _, _ = tnt_coordinates(**stream)
    assert u.tolist() == pytest.approx([2.0, (3 - 16 / 9) / 6 + 2])
    u, _, _ = tnt_coordinates(**stream, remove_flow=True)
    assert u.tolist() == pytest.approx([2.0, (3 - 16 / 9 - 4 / 9 * 0.75) / 6 + 2])


# x_g = x/2, y_g = y/2; c = (2, 1)
SMALL = dict(start_us=100, window_us=8, sensor=(9, 5), grid=(5, 3))


def test_centroids():
    where = dict(t=[101, 102, 103], x=[2, 4, 0], y=[1, 3, 2], **SMALL)
    assert landmark("center", **where).tolist() == [[2.0, 1.0]] * 3
    assert landmark("running", **where).tolist() == [[1.0, 0.5], [1.5, 1.0], [1.0, 1.0]]
    assert landmark("window", **where).tolist() == [[1.0, 1.0]] * 3


def test_line_is_the_ridge_intercept_of_the_events_so_far():
    t, x, y = [102, 106, 108], [2, 6, 7], [4, 0, 2]  # f = 0.25, 0.75, 1
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
    t, x, y = [99, 101, 109, 102, 0], [8, 2, 8, 4, 8], [4, 1, 4, 3, 4]
    for name in ("running", "line", "window"):
        rows = landmark(name, t, x, y, **SMALL)
        assert torch.equal(rows[[1, 3]], landmark(name, [101, 102], [2, 4], [1, 3], **SMALL))
        assert rows[[0, 2, 4]].tolist() == [[2.0, 1.0]] * 3  # the centre: filled in, never read
    assert fitted_flow(t, x, y, **SMALL)[[0, 2, 4]].tolist() == [[0.0, 0.0]] * 3


def test_hats_count_earlier_events_of_the_same_cell_and_polarity():
    """Cells of 10 x 5 pixels. In the left upper one, ON at (2, 1) twice, then at (4, 2); OFF at (4, 1)."""
    t, x, y, p = np.array([(1, 2, 1, 1), (2, 2, 1, 1), (3, 4, 1, 0), (4, 4, 2, 1), (5, 9, 4, 1), (6, 10, 4, 1)]).T
    at = dict(start_us=0, window_us=100, sensor=(20, 10), grid=(2, 2))
    expected = torch.zeros(2, 7, 7, 2, 2)  # polarity, z_y + 3, z_x + 3, row, column
    expected[0, 3, 3, 0, 0] = 1 / 5  # the second at (2, 1) finds the first; five events are in this cell
    expected[0, 2, 1, 0, 0] = 2 / 5  # that at (4, 2) finds both, two pixels to the left and one up
    torch.testing.assert_close(hats(t, x, y, p, **at), expected.reshape(98, 2, 2))  # (9, 4) is too far; (10, 4) outside
    expected[0, 3, 1, 0, 0] = 2 / 5  # the OFF event finds both ON events
    expected[0, 2, 3, 0, 0] = 1 / 5  # and is found
    torch.testing.assert_close(hats(t, x, y, p, **at, polarity="unsigned"), expected[0].reshape(49, 2, 2))
