"""Optical flow: no symmetry of the convolution (Proposition 1), and a translation after the transform (Proposition 2).

L_v is the motion of constant optical flow, a shear of space-time: (x, y, t) -> (x + v_x t, y + v_y t, t).
Propositions of Wang 2019, arXiv:1911.12801.
"""

import pytest
import torch
import torch.nn.functional as F
from made import events_of
from tnt_reference import Classifier, event_volume, move_by_flow, tnt_coordinates, tnt_volume

from async_tnt import TNTConfig, TNTVolume


def difference(a, b):
    return (a - b).abs().max().item()


def shear(f, v, centre=0):
    """L_v on (..., t, x), v whole pixels per time step, with x on a circle: no border can make the difference."""
    return torch.stack([f[..., k, :].roll(v * (k - centre), -1) for k in range(f.shape[-2])], dim=-2)


def convolve(f, phi):
    """(..., T, X) by (3, X'): circular in x, valid in t."""
    reach = phi.shape[-1] // 2
    return F.conv2d(F.pad(f[None, None], (reach, reach, 0, 0), mode="circular"), phi[None, None])[0, 0]


def test_proposition_1_in_x_and_t():
    """(L_v f) * phi != L_v (f * phi). A still point is a line along t; the filter sums three time steps.

    Still, the filter answers 3 all along the line. At v = 1 the line is a diagonal and the answer 1: for every
    shear and translation of the still answer, the two sides differ by at least 2 of 3.
    """
    point = torch.zeros(9, 16, dtype=torch.float64)
    point[:, 5] = 1
    phi = torch.ones(3, 1, dtype=torch.float64)
    still, moving = convolve(point, phi), convolve(shear(point, 1), phi)
    assert still.max() == 3 and moving.max() == 1
    assert min(difference(moving, shear(still, w).roll(k, -1)) for w in range(-3, 4) for k in range(16)) == 2


def test_the_shear_that_the_convolution_lacks_is_the_filters():
    """(L_v f) * phi = L_v (f * L_v^-1 phi): one filter would be needed for each flow.

    So a filter of a single time step, which no shear changes, is equivariant.
    """
    g = torch.Generator().manual_seed(0)
    f, phi = (torch.randn(*shape, generator=g, dtype=torch.float64) for shape in ((9, 16), (3, 5)))
    phi[:, (0, 4)] = 0  # room for the shear by one pixel per step
    for v in (1, -1):
        got = convolve(shear(f, v), phi)
        # Output row k is centred on input row k + 1: sheared by v (k + 1).
        assert difference(got, shear(convolve(f, shear(phi, -v, centre=1)), v, centre=-1)) < 1e-12
        assert difference(got, shear(convolve(f, phi), v, centre=-1)) > 1
        instant = phi[1:2]
        assert difference(convolve(shear(f, v), instant), shear(convolve(f, instant), v)) < 1e-12


BINS, WINDOW_US, T_MAX, SENSOR = 9, 8_000, 2.0, (57, 57)
AT = dict(start_us=0, window_us=WINDOW_US, sensor=SENSOR, grid=SENSOR, bins=BINS)
FLOW = (16, -8)  # pixels per window


def point_events(flow):
    """One event of one point at each bin; of the (x, y, t) volume, one voxel per bin."""
    k = torch.arange(BINS)
    return dict(t=1_000 * k, x=28 + flow[0] * k // 8, y=28 + flow[1] * k // 8, p=torch.ones(BINS))


def test_proposition_1_in_x_y_and_t():
    """V(L_v e) * phi != L_v (V(e) * phi), in the event volume and with a 3-D convolution.

    A point, seen by a 3 x 3 x 3 filter of ones, answers 3 at rest. At 3 px per bin to the right and 1 up it
    answers 1. Neither the same shear of the still answer nor a translation brings the two closer than 2 of 3.
    """
    flow = (24, -8)
    phi = torch.ones(1, 1, 3, 3, 3, dtype=torch.float64)
    still, moving = (
        F.conv3d(event_volume(**point_events(v), **AT, dtype=torch.float64)[None, None], phi)[0, 0]
        for v in ((0, 0), flow)
    )
    assert still.max() == 3 and moving.max() == 1
    sheared = torch.stack([still[k].roll((-(k + 1), 3 * (k + 1)), (0, 1)) for k in range(BINS - 2)])
    assert difference(moving, sheared) == 2
    for t_x in range(25):
        for t_y in range(-8, 1):
            assert difference(moving, still.roll((t_y, t_x), (1, 2))) >= 2


@pytest.mark.parametrize("fixed", ["center", (28.0, 28.0), (30.5, 25.25)], ids=str)
@pytest.mark.parametrize("flow", [(16.0, -8.0), (-3.7, 11.1)], ids=str)
def test_proposition_2_event_by_event(fixed, flow):
    """TNT(L_v e) = TNT(e) + v / t_max, for each event, at any place, time and fixed landmark; to 1e-12 px.

    u = (x + v f - l) / (t_max f) + c. Without the division by the time the same flow moves the events apart:
    by v f, from v/8 to all of v.
    """
    g = torch.Generator().manual_seed(3)
    t = torch.randint(WINDOW_US // 8, WINDOW_US + 1, (500,), generator=g).sort().values
    x, y = torch.rand(2, 500, generator=g, dtype=torch.float64) * 10 + 23
    settings = dict(start_us=0, window_us=WINDOW_US, sensor=SENSOR, grid=SENSOR, t_max=T_MAX, landmark=fixed)
    still = tnt_coordinates(t, x, y, **settings)
    f = t.double() / WINDOW_US
    moved = tnt_coordinates(t, *move_by_flow(t, x, y, flow, start_us=0, window_us=WINDOW_US), **settings)
    both = still.kept & moved.kept
    assert both.sum() > 300
    for got, v in ((moved.u - still.u, flow[0]), (moved.v - still.v, flow[1])):
        assert (got[both] - v / T_MAX).abs().max() < 1e-12
        assert ((v * f).max() - (v * f).min()).abs() > 0.8 * abs(v)


def square(flow):
    """The outline of a square of 5 x 5 px about the centre, ON on two sides, all of it at each of 8 instants.

    Whole pixels, at rest and in motion, so that the stream, whose pixels are integers, can take it too.
    """
    side = torch.arange(-2, 3)
    offset = torch.cartesian_prod(side, side)
    offset = offset[offset.abs().max(1).values == 2]  # (16, 2)
    k = torch.arange(1, 9).repeat_interleave(len(offset))
    offset = offset.repeat(8, 1)
    x, y = 28 + offset[:, 0] + flow[0] * k // 8, 28 + offset[:, 1] + flow[1] * k // 8
    return dict(t=1_000 * k, x=x, y=y, p=(offset[:, 0] > offset[:, 1]).long())


SHIFT_X, SHIFT_Y = 8, -4  # v / t_max


def translated(f, step=1):
    """L by v / t_max, on a map of `step` grid pixels per cell."""
    return f.roll((SHIFT_Y // step, SHIFT_X // step), dims=(-2, -1))


@pytest.mark.parametrize("polarity", ["signed", "unsigned", "split"])
def test_proposition_2_for_the_volume(polarity):
    """V(TNT(L_v e)) = L_{v / t_max} V(TNT(e)): at 16 px right and 8 up per window and t_max = 2, by (8, -4) cells.

    The raw volumes differ by at least a whole event for every translation.
    """
    options = dict(AT, polarity=polarity, dtype=torch.float64)
    still, moving = (tnt_volume(**square(v), **options, landmark="center", t_max=T_MAX) for v in ((0, 0), FLOW))
    assert still.abs().sum() > 50
    assert moving.abs().sum().item() == pytest.approx(still.abs().sum().item())  # nothing fell off
    assert difference(moving, translated(still)) < 1e-12
    assert difference(moving, still) >= 1
    raw_still, raw_moving = (event_volume(**square(v), **options) for v in ((0, 0), FLOW))
    shifts = [(t_y, t_x) for t_y in range(-10, 3) for t_x in range(-2, 19)]
    assert min(difference(raw_moving, raw_still.roll(by, (-2, -1))) for by in shifts) >= 1


def test_proposition_2_in_the_stream():
    """The same for the event-by-event volume, to 1e-6: 128 events, one update each."""
    config = TNTConfig(
        window_us=WINDOW_US + 1,
        t_max=T_MAX * (WINDOW_US + 1) / WINDOW_US,
        bins=BINS,
        sensor=SENSOR,
        grid=SENSOR,
        landmark="center",
    )
    arrays = []
    for flow in ((0, 0), FLOW):
        columns = square(flow)
        events = events_of(*(columns[name].numpy() for name in "txyp"))
        volume = TNTVolume(config)
        volume.open(0)
        for i in range(len(events)):
            volume.update(events[i : i + 1])
        arrays.append(torch.from_numpy(volume.array.copy()))
    still, moving = arrays
    assert still.abs().sum() > 50
    assert difference(moving, translated(still)) < 1e-6
    assert difference(moving, still) >= 0.9


def test_the_classifiers_features_translate_with_the_flow():
    """Phi(V(TNT(L_v e))) = L Phi(V(TNT(e))): by (8, -4) cells after conv1, by (2, -1) after conv1, pool, conv2, pool.

    v / t_max is a multiple of 4, as two poolings ask for. The outermost cells, which see the zero padding, are
    left out. Features of the raw volumes agree nowhere near as well.
    """
    torch.manual_seed(0)
    network = Classifier(BINS, SENSOR).double().requires_grad_(False)
    options = dict(AT, dtype=torch.float64)

    def features(volume):
        first = network.conv1(volume).relu()
        return first, F.avg_pool2d(network.conv2(F.avg_pool2d(first, 2)).relu(), 2)

    pairs = {
        "tnt": [features(tnt_volume(**square(v), **options, landmark="center", t_max=T_MAX)) for v in ((0, 0), FLOW)],
        "raw": [features(event_volume(**square(v), **options)) for v in ((0, 0), FLOW)],
    }
    worst = {}
    for name, (still, moving) in pairs.items():
        for layer, step in ((0, 1), (1, 4)):
            a, b = moving[layer], translated(still[layer], step)
            reach_x, reach_y = SHIFT_X // step, -SHIFT_Y // step
            inner = (..., slice(2, -2 - reach_y), slice(reach_x + 2, -2))
            assert b[inner].std() > 0.01
            worst[name, layer] = difference(a[inner], b[inner]) / b[inner].std().item()
    assert worst["tnt", 0] < 1e-12 and worst["tnt", 1] < 1e-12
    assert worst["raw", 0] > 1 and worst["raw", 1] > 1
