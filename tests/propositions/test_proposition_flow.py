"""Optical flow: no symmetry of the convolution, but a translation after the transform.

Propositions 1 and 2 of Wang 2019, arXiv:1911.12801. L_v is the motion of constant optical flow, a
shear of space-time:

    (x, y, t) -> (x + v_x t, y + v_y t, t)
"""

import pytest
import torch
import torch.nn.functional as F
from tnt_reference import Classifier, event_volume, move_by_flow, tnt_coordinates, tnt_volume


def difference(a, b):
    """The largest difference."""
    return (a - b).abs().max().item()


BINS = 9
WINDOW_US = 8_000
T_MAX = 2.0
SENSOR = (57, 57)
AT = dict(start_us=0, window_us=WINDOW_US, sensor=SENSOR, grid=SENSOR, bins=BINS)
FLOW = (16, -8)  # pixels per window


def point_events(flow):
    """One event of one point at each bin, so that it adds to one cell of each bin."""
    k = torch.arange(BINS)
    return dict(t=1_000 * k, x=28 + flow[0] * k // 8, y=28 + flow[1] * k // 8, p=torch.ones(BINS))


def test_proposition_1_in_x_y_and_t():
    """V(L_v e) * phi != L_v (V(e) * phi), in the event volume and with a 3-D convolution.

    To a point at rest, a 3 x 3 x 3 filter of ones answers 3. To a point that moves by 3 px per bin
    to the right and 1 up it answers 1. Neither the same shear of the still answer nor a translation
    brings the two answers closer than 2.
    """
    flow = (24, -8)
    phi = torch.ones(1, 1, 3, 3, 3, dtype=torch.float64)

    def answer(v):
        volume = event_volume(**point_events(v), **AT, dtype=torch.float64)
        return F.conv3d(volume[None, None], phi)[0, 0]

    still = answer((0, 0))
    moving = answer(flow)
    assert still.max() == 3 and moving.max() == 1
    sheared = torch.stack([still[k].roll((-(k + 1), 3 * (k + 1)), (0, 1)) for k in range(BINS - 2)])
    assert difference(moving, sheared) == 2
    shifts = [(t_y, t_x) for t_y in range(-8, 1) for t_x in range(25)]
    assert min(difference(moving, still.roll(by, (1, 2))) for by in shifts) >= 2


def sheared(volume, flow):
    """L_v of a volume (..., B, H, W): bin k moved by k times `flow`.

    `flow` is (x, y) in whole pixels per bin.
    """
    bins = [v.roll((k * flow[1], k * flow[0]), (-2, -1)) for k, v in enumerate(volume.unbind(-3))]
    return torch.stack(bins, -3)


def test_a_convolution_with_sheared_filters_is_equivariant_to_flow():
    """V(L_v e) * L_v phi = L_v (V(e) * phi): Proposition 1 is about filters that stay as they are.

    With (V * phi)[b, y, x] = sum phi[d, i, j] V[b + d, y + i, x + j], shearing both moves the sum's
    terms only.
    """
    per_bin = (2, -1)  # FLOW, in pixels per bin
    at_rest = event_volume(**square((0, 0)), **AT, dtype=torch.float64)[None, None]
    in_motion = event_volume(**square(FLOW), **AT, dtype=torch.float64)[None, None]
    assert difference(in_motion, sheared(at_rest, per_bin)) < 1e-12

    # The filter is 3 x 3 x 3 within 3 x 13 x 13, so that it stays inside when it is sheared.
    phi = torch.zeros(1, 1, 3, 13, 13, dtype=torch.float64)
    generator = torch.Generator().manual_seed(1)
    phi[..., 5:8, 5:8] = torch.randn(3, 3, 3, generator=generator, dtype=torch.float64)
    still = F.conv3d(at_rest, phi, padding=(0, 6, 6))
    moving = F.conv3d(in_motion, sheared(phi, per_bin), padding=(0, 6, 6))
    same_filter = F.conv3d(in_motion, phi, padding=(0, 6, 6))

    inner = (..., slice(12, -12), slice(4, -20))  # what rolling round the border does not reach
    assert still[inner].abs().max() > 1
    assert difference(moving[inner], sheared(still, per_bin)[inner]) < 1e-12
    assert difference(same_filter[inner], sheared(still, per_bin)[inner]) > 1


def test_proposition_2_event_by_event():
    """TNT(L_v e) = TNT(e) + v / t_max for each event, to 1e-12 px.

    It holds at any place and time, and about any fixed landmark, for a motion that starts where the
    object at rest is. An object that passes the centre at half time is displaced by v (f - 1/2).
    About a fixed landmark, it is then at u = [the object at rest] + v / t_max - v / (2 t_max f).
    The last term depends on time. About the centroid it vanishes, as all translations do.
    """
    v_x = -3.7
    v_y = 11.1
    g = torch.Generator().manual_seed(3)
    t = torch.randint(WINDOW_US // 8, WINDOW_US + 1, (500,), generator=g).sort().values
    x, y = torch.rand(2, 500, generator=g, dtype=torch.float64) * 10 + 23
    f = t.double() / WINDOW_US
    settings = dict(start_us=0, window_us=WINDOW_US, sensor=SENSOR, grid=SENSOR, t_max=T_MAX)
    flowing = move_by_flow(t, x, y, (v_x, v_y), start_us=0, window_us=WINDOW_US)
    half_way = x + v_x * (f - 0.5)
    for fixed in ("center", (30.5, 25.25)):
        still = tnt_coordinates(t, x, y, **settings, landmark=fixed)
        moved = tnt_coordinates(t, *flowing, **settings, landmark=fixed)
        passing = tnt_coordinates(t, half_way, y, **settings, landmark=fixed)
        assert (still.kept & moved.kept).sum() > 300
        assert (moved.u - still.u - v_x / T_MAX).abs().max() < 1e-12
        assert (moved.v - still.v - v_y / T_MAX).abs().max() < 1e-12
        assert (passing.u - still.u - v_x / T_MAX + v_x / (2 * T_MAX * f)).abs().max() < 1e-12

    moved = tnt_coordinates(t, x + v_x * f, y, **settings, landmark="running").u
    passing = tnt_coordinates(t, half_way, y, **settings, landmark="running").u
    assert (moved - passing).abs().max() < 1e-9


def square(flow):
    """The outline of a square of 5 x 5 px about the centre, all of it at each of 8 instants.

    Two sides are ON. Pixels are whole, at rest and in motion, so that the stream, whose pixels are
    integers, can take them too.
    """
    side = torch.arange(-2, 3)
    offset = torch.cartesian_prod(side, side)
    offset = offset[offset.abs().max(1).values == 2]  # (16, 2)
    k = torch.arange(1, 9).repeat_interleave(len(offset))
    offset = offset.repeat(8, 1)
    x = 28 + offset[:, 0] + flow[0] * k // 8
    y = 28 + offset[:, 1] + flow[1] * k // 8
    return dict(t=1_000 * k, x=x, y=y, p=(offset[:, 0] > offset[:, 1]).long())


# FLOW / T_MAX
SHIFT_X = 8
SHIFT_Y = -4


def translated(f, step=1):
    """A map of `step` grid pixels per cell, translated by v / t_max."""
    return f.roll((SHIFT_Y // step, SHIFT_X // step), dims=(-2, -1))


# An object that moves at constant flow while events arrive evenly. Event i comes at f_i = i/n, for
# i = 0..n-1, so that the mean of f over events 0..i is exactly f_i/2. x is real-valued: no rounding
# to pixels hides the law.
N_EVENTS = 1300
WIDE = dict(start_us=0, window_us=10 * N_EVENTS, sensor=(41, 41), grid=(41, 41), t_max=T_MAX)
I = torch.arange(1, N_EVENTS, dtype=torch.float64)  # noqa: E741
RIDGE = 1 + (I + 1) * ((I + 1) ** 2 - 1) / 12 / N_EVENTS**2  # C_ff + 1 over events 0..i


def object_in_motion(flow):
    """The same 1,300 points of an object 6 px across; `flow` in grid pixels per window, along x."""
    generator = torch.Generator().manual_seed(7)
    shape = torch.rand(N_EVENTS, 2, generator=generator, dtype=torch.float64) * 6 + 12
    i = torch.arange(N_EVENTS)
    return dict(t=10 * i, x=shape[:, 0] + flow * i.double() / N_EVENTS, y=shape[:, 1])


@pytest.mark.parametrize(
    ("options", "expected", "at"),
    [
        ({"landmark": "running"}, 2.0 + 0 * I, {}),
        ({"landmark": "line"}, 4 * (1 - 1 / (2 * RIDGE)), {129: 2.200, 649: 3.863, -1: 3.982}),
        ({"landmark": "line", "remove_flow": True}, 4 / (2 * RIDGE), {-1: 0.018}),
        (
            {"landmark": "window"},
            4 * (1 - (N_EVENTS - 1) / (2 * I)),
            {324: -4.0, 649: 0.0, -1: 2.0},
        ),
    ],
    ids=["running", "line", "line, flow removed", "window"],
)
def test_how_far_each_landmark_translates_events_under_flow(options, expected, at):
    """At v = 8 px per window and t_max = 2, in grid pixels, event by event (event 0 has tau = 0):

    a fixed point                v / t_max                            all of the flow
    running                      v / (2 t_max)                        half of it
    line                         v / t_max (1 - 1/(2 (C_ff + 1)))     all of it up to the ridge
    line, flow removed           v / (2 t_max (C_ff + 1))             what the ridge leaves
    window                       v / t_max (1 - T / 2t)               not a translation
    """
    moving = tnt_coordinates(**object_in_motion(8.0), **WIDE, **options)
    still = tnt_coordinates(**object_in_motion(0.0), **WIDE, **options)
    torch.testing.assert_close(moving.v, still.v, rtol=0, atol=1e-12)
    got = (moving.u - still.u)[1:]
    torch.testing.assert_close(got, expected, rtol=0, atol=1e-9)
    tolerance = 0.01 if options["landmark"] == "window" else 0.001
    for i, shift in at.items():
        assert got[i].item() == pytest.approx(shift, abs=tolerance)


@pytest.mark.parametrize("polarity", ["signed", "split"])
def test_proposition_2_for_the_volume_and_a_3d_convolution_of_it(polarity):
    """V(TNT(L_v e)) = L_{v / t_max} V(TNT(e)).

    At 16 px right and 8 up per window and t_max = 2, this is a translation by (8, -4) cells. So
    V(TNT(L_v e)) * phi = L_{v / t_max} (V(TNT(e)) * phi), for filters over x, y and t. Without TNT
    it is not.
    """
    options = dict(AT, polarity=polarity, dtype=torch.float64)
    still = tnt_volume(**square((0, 0)), **options, landmark="center", t_max=T_MAX)
    moving = tnt_volume(**square(FLOW), **options, landmark="center", t_max=T_MAX)
    assert still.abs().sum() > 50
    assert moving.abs().sum().item() == pytest.approx(still.abs().sum().item())  # nothing fell off
    assert difference(moving, translated(still)) < 1e-12
    assert difference(moving, still) >= 1

    generator = torch.Generator().manual_seed(1)
    phi = torch.randn(4, 1, 3, 3, 3, generator=generator, dtype=torch.float64)

    def convolved(volume):
        return F.conv3d(volume[None, None], phi)

    assert convolved(still).abs().max() > 1
    assert difference(convolved(moving), translated(convolved(still))) < 1e-12
    raw_still = convolved(event_volume(**square((0, 0)), **options))
    raw_moving = convolved(event_volume(**square(FLOW), **options))
    assert difference(raw_moving, translated(raw_still)) > 1


def test_the_classifiers_features_translate_with_the_flow():
    """Phi(V(TNT(L_v e))) = L Phi(V(TNT(e))).

    L is a translation by (8, -4) cells after conv1, and by (2, -1) after conv1, pool, conv2, pool.
    v / t_max is a multiple of 4, as two poolings ask for. The outermost cells, which see the zero
    padding, are left out. Features of the raw volumes differ by more than a standard deviation.
    """
    torch.manual_seed(0)
    network = Classifier(BINS, SENSOR).double().requires_grad_(False)
    options = dict(AT, dtype=torch.float64)

    def worst(volume_of):
        """The largest difference of each layer, in standard deviations."""
        firsts = [network.conv1(volume_of(v)).relu() for v in ((0, 0), FLOW)]
        pooled = [F.avg_pool2d(first, 2) for first in firsts]
        seconds = [F.avg_pool2d(network.conv2(maps).relu(), 2) for maps in pooled]
        for (still, moving), step in ((firsts, 1), (seconds, 4)):
            inner = (..., slice(2, -2 + SHIFT_Y // step), slice(SHIFT_X // step + 2, -2))
            expected = translated(still, step)[inner]
            assert expected.std() > 0.01
            yield difference(moving[inner], expected) / expected.std().item()

    def transformed(v):
        return tnt_volume(**square(v), **options, landmark="center", t_max=T_MAX)

    def raw(v):
        return event_volume(**square(v), **options)

    assert max(worst(transformed)) < 1e-12
    assert min(worst(raw)) > 1
