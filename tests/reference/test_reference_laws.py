"""What holds for every stream.

These are sums, derivatives, finite values, and agreement with plain Python loops.

The loops are written from the equations alone. Up to the volume's sums both do the same float64
operations in the same order, so that those comparisons ask for equality. Landmark `line` is
compared with exact rational arithmetic.
"""

from fractions import Fraction
from itertools import product

import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from tnt_reference import (
    event_volume,
    fitted_flow,
    landmark,
    objects_on_map,
    tnt_coordinates,
    tnt_volume,
)
from tnt_reference.transform import BORDER_TOLERANCE

LANDMARKS = ("center", "running", "line", "window")
POLARITIES = ("signed", "unsigned", "split")
WINDOW = dict(start_us=1_000, window_us=5_000, sensor=(12, 9), grid=(8, 7))
VOLUME = dict(WINDOW, bins=5)
ATOL_LANDMARK = 1e-9  # grid pixels, the bound of the theory
# a dozen events of weight 1: only the order of float64 sums and products differs
ATOL_VOLUME = 1e-12


@pytest.mark.parametrize(
    "options",
    [
        {"transform": None},
        {"landmark": "running"},
        {"landmark": "line", "remove_flow": True, "t_max": 2.0},
        {"landmark": "window", "polarity": "split"},
        {"landmark": "given"},
    ],
    ids=str,
)
def test_gradients(options):
    """The events are real-valued, away from the edges of cells and border; each has a landmark."""
    g = torch.Generator().manual_seed(1)

    def drawn(low, high):
        column = torch.rand(4, generator=g, dtype=torch.float64) * (high - low) + low
        return column.requires_grad_()

    t = drawn(3_000, 5_900)
    x = drawn(2, 9)
    y = drawn(2, 6)
    l_x = drawn(4.0, 4.3)
    l_y = drawn(2.8, 3.0)
    p = torch.tensor([1, 0, 1, 1])

    def volume(t, x, y, l_x, l_y):
        if "transform" in options:
            return event_volume(t, x, y, p, **VOLUME, dtype=torch.float64)
        given = {"landmark": torch.stack([l_x, l_y], 1)} if options["landmark"] == "given" else {}
        return tnt_volume(t, x, y, p, **VOLUME, **{**options, **given}, dtype=torch.float64)

    assert volume(t, x, y, l_x, l_y).abs().sum() > 1
    assert torch.autograd.gradcheck(volume, (t, x, y, l_x, l_y), fast_mode=True)


@pytest.mark.parametrize("name", [*LANDMARKS, (1.0, 2.0)], ids=str)
def test_degenerate_input_gives_finite_values_and_gradients(name):
    for times in ([], [1_000], [1_001], [2_000] * 5, [0, 999, 6_001]):
        n = len(times)
        t = torch.tensor(times, dtype=torch.float64, requires_grad=True)
        x = torch.tensor([11, 3, 3, 4, 0][:n], dtype=torch.float64, requires_grad=True)
        y = torch.tensor([8, 4, 4, 4, 0][:n], dtype=torch.float64, requires_grad=True)
        u, v, _ = tnt_coordinates(t, x, y, **WINDOW, landmark=name)
        assert u.isfinite().all() and v.isfinite().all()
        assert fitted_flow(t, x, y, **WINDOW).shape == (n, 2)
        for remove_flow in {False, name == "line"}:
            volume = tnt_volume(
                t, x, y, [1, 0, 1, 0, 1][:n], **VOLUME, landmark=name, remove_flow=remove_flow
            )
            assert volume.shape == (5, 7, 8) and volume.isfinite().all()
            loss = (volume * volume).sum() + u.sum() + v.sum()
            gradients = torch.autograd.grad(loss, (t, x, y), retain_graph=True, allow_unused=True)
            assert all(gradient is None or gradient.isfinite().all() for gradient in gradients)


# -- against loops ---------------------------------------------------------------------------------


@st.composite
def windows(draw):
    """A window's settings and up to 12 events.

    Events are unsorted, repeated, at the ends, outside, or far from 0.
    """
    window_us = draw(st.sampled_from([1, 2, 7, 800, 105_000]))
    start_us = draw(st.sampled_from([0, -5, 123, 1_700_000_000_123_457]))
    sensor = draw(st.tuples(st.integers(2, 12), st.integers(2, 12)))
    grid = draw(st.tuples(st.integers(2, 7), st.integers(2, 7)))
    dt = st.one_of(
        st.integers(-2, window_us + 2), st.sampled_from([0, 1, window_us - 1, window_us])
    )
    event = st.tuples(
        dt, st.integers(0, sensor[0] - 1), st.integers(0, sensor[1] - 1), st.booleans()
    )
    events = draw(st.lists(event, min_size=draw(st.sampled_from([0, 1, 12])), max_size=12))
    t = [start_us + since_us for since_us, _, _, _ in events]
    x = [column for _, column, _, _ in events]
    y = [row for _, _, row, _ in events]
    p = [is_on for _, _, _, is_on in events]
    where = dict(start_us=start_us, window_us=window_us, sensor=sensor, grid=grid)
    return (t, x, y, p), where


def line(x, f):
    """(intercept, slope) of the ridge line through these points, exactly."""
    mean_x = Fraction(sum(x), len(x))
    mean_f = sum(f) / len(f)
    c_xf = sum((a - mean_x) * (b - mean_f) for a, b in zip(x, f, strict=True))
    m = c_xf / (sum((b - mean_f) ** 2 for b in f) + 1)
    return mean_x - m * mean_f, m


def k(a):
    return max(0.0, 1.0 - abs(a))


def volume_of(placed, bins, grid, polarity):
    """The volume of events that are `placed`, (b, v, u, is_on) each.

    It visits every cell for every event.
    """
    volume = torch.zeros(
        2 * bins if polarity == "split" else bins, grid[1], grid[0], dtype=torch.float64
    )
    for b, v, u, is_on in placed:
        sign = -1.0 if polarity == "signed" and not is_on else 1.0
        first = bins if polarity == "split" and not is_on else 0
        for i_b, i_y, i_x in product(range(bins), range(grid[1]), range(grid[0])):
            volume[first + i_b, i_y, i_x] += sign * k(i_b - b) * k(i_y - v) * k(i_x - u)
    return volume


@given(windows(), st.sampled_from(LANDMARKS))
def test_landmarks(window, name):
    """Centroids are equal to the last bit, as (S / n) (W - 1) / (Ws - 1) is written.

    The kernels do the same operations.
    """
    (t, x, y, _), where = window
    start, length, sensor, grid = where.values()
    rows = landmark(name, t, x, y, **where)
    flow = fitted_flow(t, x, y, **where)
    inside = [i for i in range(len(t)) if start <= t[i] <= start + length]
    for i, (axis, column) in product(inside, enumerate((x, y))):
        members = [j for j in inside if j <= i or name == "window"]
        of_members = [column[j] for j in members]
        got = rows[i, axis].item()
        if name == "center":
            assert got == (grid[axis] - 1) / 2
        elif name == "line":
            scale = Fraction(grid[axis] - 1, sensor[axis] - 1)
            intercept, slope = line(of_members, [Fraction(t[j] - start, length) for j in members])
            assert got == pytest.approx(float(intercept * scale), abs=ATOL_LANDMARK, rel=0)
            assert flow[i, axis].item() == pytest.approx(
                float(slope * scale), abs=ATOL_LANDMARK, rel=0
            )
        else:
            assert got == sum(of_members) / len(members) * (grid[axis] - 1) / (sensor[axis] - 1)


@example(  # rounding puts the second event just off the grid
    (
        ([1, 1], [5, 4], [0, 0], [False, False]),
        dict(start_us=0, window_us=7, sensor=(8, 2), grid=(2, 2)),
    ),
    "line, flow removed",
    1,
    1,
    "signed",
)
@given(
    windows(),
    st.sampled_from(["raw", "line, flow removed", *LANDMARKS]),
    st.sampled_from([0.5, 1, 2.0, 3.7, 8.0]),
    st.integers(1, 5),
    st.sampled_from(POLARITIES),
)
def test_volumes(window, kind, t_max, bins, polarity):
    (t, x, y, p), where = window
    start, length, sensor, grid = where.values()
    how = dict(
        landmark=kind.removesuffix(", flow removed"),
        remove_flow=kind == "line, flow removed",
        t_max=t_max,
    )
    options = dict(where, bins=bins, polarity=polarity, dtype=torch.float64)
    if kind == "raw":
        got = event_volume(t, x, y, p, **options)
    else:
        rows = landmark(how["landmark"], t, x, y, **where).tolist()
        flow = fitted_flow(t, x, y, **where).tolist()
        u, v, kept = tnt_coordinates(t, x, y, **where, **how)
        got = tnt_volume(t, x, y, p, **options, **how)
    placed = []
    for i in range(len(t)):
        dt = t[i] - start
        tau = t_max * dt / length
        at = [column[i] * (grid[a] - 1) / (sensor[a] - 1) for a, column in enumerate((x, y))]
        is_kept = 0 <= dt <= length
        if kind != "raw" and is_kept and tau > 0:
            at = [
                at[a] - rows[i][a] - how["remove_flow"] * flow[i][a] * (dt / length) for a in (0, 1)
            ]
            at = [at[a] / tau + (grid[a] - 1) / 2 for a in (0, 1)]
            on_grid = [min(max(a, 0.0), side - 1.0) for a, side in zip(at, grid, strict=True)]
            is_kept = all(abs(a - b) <= BORDER_TOLERANCE for a, b in zip(at, on_grid, strict=True))
            at = on_grid if is_kept else at
            assert [u[i].item(), v[i].item()] == at
        if kind != "raw":
            is_kept = is_kept and tau > 0
            assert kept[i].item() == is_kept
        if is_kept:
            placed.append(((bins - 1) * dt / length, at[1], at[0], p[i]))
    torch.testing.assert_close(
        got, volume_of(placed, bins, grid, polarity), rtol=0, atol=ATOL_VOLUME
    )


def test_equal_logits_on_a_map_are_equally_likely_objects():
    """To the bit, however many there are: so that the first of them comes first."""
    for seed in range(300):
        g = torch.Generator().manual_seed(seed)
        n = int(torch.randint(3, 60, (1,), generator=g))
        maps = torch.zeros(4, 3, 2 * n + 1)
        maps[:3, 1, 1::2] = 1 + torch.rand(3, 1, generator=g)
        maps[3] = 1.0
        objects = objects_on_map(maps)
        assert len({found.probability for found in objects}) == 1
        assert [found.column for found in objects] == sorted(found.column for found in objects)
        assert len(objects) == n
