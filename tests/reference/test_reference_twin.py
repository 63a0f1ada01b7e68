"""Random nasty streams: the torch reference against plain Python loops, written from the equations alone.

Up to the volume's sums both do the same float64 operations in the same order, so those tests ask for
equality, not for closeness. Landmark `line` is checked against exact rational arithmetic.
"""

from fractions import Fraction
from math import floor

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tnt_reference import event_volume, fitted_flow, landmark, tnt_coordinates, tnt_volume
from tnt_reference.coordinates import bin_position

ATOL_LANDMARK = 1e-9  # grid pixels, as the design promises
ATOL_VOLUME = 1e-12  # a dozen events of weight 1: only the order of float64 sums and products differs


@st.composite
def windows(draw):
    """A window's settings and up to 12 events: unsorted, repeated, at the ends, outside, far from 0."""
    window_us = draw(st.sampled_from([1, 2, 7, 800, 105_000]))
    start_us = draw(st.sampled_from([0, -5, 123, 1_700_000_000_123_457]))
    sensor = draw(st.tuples(st.integers(2, 12), st.integers(2, 12)))
    grid = draw(st.tuples(st.integers(2, 7), st.integers(2, 7)))
    dt = st.one_of(st.integers(-2, window_us + 2), st.sampled_from([0, 1, window_us - 1, window_us]))
    event = st.tuples(dt, st.integers(0, sensor[0] - 1), st.integers(0, sensor[1] - 1), st.booleans())
    events = draw(st.lists(event, max_size=12))
    t, x, y, p = ([e[k] for e in events] for k in range(4))
    return ([start_us + a for a in t], x, y, p), dict(start_us=start_us, window_us=window_us, sensor=sensor, grid=grid)


def landmark_twin(name, t, x, axis, start_us, window_us, sensor, grid):
    """(landmark, flow) of each event inside the window, in grid pixels, along one axis; None outside."""
    scale = Fraction(grid[axis] - 1, sensor[axis] - 1)
    inside = [start_us <= a <= start_us + window_us for a in t]
    rows = []
    for i in range(len(t)):
        if not inside[i]:
            rows.append(None)
            continue
        members = [j for j in range(len(t)) if inside[j] and (j <= i or name == "window")]
        f = [Fraction(t[j] - start_us, window_us) for j in members]
        mean_f = sum(f) / len(f)
        mean_x = Fraction(sum(x[j] for j in members), len(members))
        if name == "center":
            rows.append((Fraction(grid[axis] - 1, 2), 0))
        elif name == "line":
            c_xf = sum((x[j] - mean_x) * (f[k] - mean_f) for k, j in enumerate(members))
            c_ff = sum((g - mean_f) ** 2 for g in f)
            m = c_xf / (c_ff + 1)
            rows.append(((mean_x - m * mean_f) * scale, m * scale))
        else:
            rows.append((mean_x * scale, 0))
    return rows


def k(a):
    return max(0.0, 1.0 - abs(a))


def volume_twin(placed, bins, grid, polarity):
    """placed: (b, v, u, is_on) of each kept event. Visits every cell for every event."""
    volume = torch.zeros(2 * bins if polarity == "split" else bins, grid[1], grid[0], dtype=torch.float64)
    for b, v, u, is_on in placed:
        s = -1.0 if polarity == "signed" and not is_on else 1.0
        first = bins if polarity == "split" and not is_on else 0
        for i_b in range(bins):
            for i_y in range(grid[1]):
                for i_x in range(grid[0]):
                    volume[first + i_b, i_y, i_x] += s * k(i_b - b) * k(i_y - v) * k(i_x - u)
    return volume


def assert_volumes_agree(got, expected):
    torch.testing.assert_close(got, expected, rtol=0, atol=ATOL_VOLUME)


@settings(deadline=None, max_examples=150, derandomize=True)
@given(windows(), st.sampled_from(["center", "running", "line", "window"]))
def test_landmarks(window, name):
    (t, x, y, _), where = window
    rows = landmark(name, t, x, y, **where)
    flow = fitted_flow(t, x, y, **where)
    for axis, column in ((0, x), (1, y)):
        for i, expected in enumerate(landmark_twin(name, t, column, axis, **where)):
            if expected is not None:
                assert rows[i, axis].item() == pytest.approx(float(expected[0]), abs=ATOL_LANDMARK, rel=0)
                if name == "line":
                    assert flow[i, axis].item() == pytest.approx(float(expected[1]), abs=ATOL_LANDMARK, rel=0)


@settings(deadline=None, max_examples=150, derandomize=True)
@given(windows())
def test_running_and_window_round_as_the_equation_is_written(window):
    """(S / n) (W - 1) / (Ws - 1) to the last bit: the kernels do the same operations."""
    (t, x, y, _), where = window
    start, end = where["start_us"], where["start_us"] + where["window_us"]
    for name in ("running", "window"):
        rows = landmark(name, t, x, y, **where)
        for axis, column in ((0, x), (1, y)):
            for i in range(len(t)):
                members = [j for j in range(len(t)) if start <= t[j] <= end and (j <= i or name == "window")]
                if start <= t[i] <= end:
                    mean = sum(column[j] for j in members) / len(members)
                    expected = mean * (where["grid"][axis] - 1) / (where["sensor"][axis] - 1)
                    assert rows[i, axis].item() == expected


@pytest.mark.parametrize("bins", [2, 4, 6, 9])
def test_bin_position_rounds_as_the_equation_is_written(bins):
    """((B - 1) dt) / window: on a whole bin the event lies on it, where (B - 1)(dt / window) may miss it."""
    for window_us in (49, 105_000):
        dt = torch.randint(0, window_us + 1, (500,), generator=torch.Generator().manual_seed(3)).double()
        assert bin_position(dt, window_us, bins).tolist() == [(bins - 1) * a / window_us for a in dt.tolist()]


@settings(deadline=None, max_examples=150, derandomize=True)
@given(
    windows(),
    st.sampled_from(["center", "running", "line", "window"]),
    st.booleans(),
    st.sampled_from([0.5, 1, 2.0, 3.7, 8.0]),
    st.integers(1, 5),
    st.sampled_from(["signed", "unsigned", "split"]),
)
def test_transformed_volume(window, name, remove_flow, t_max, bins, polarity):
    (t, x, y, p), where = window
    remove_flow = remove_flow and name == "line"
    start, length, sensor, grid = where.values()
    rows = landmark(name, t, x, y, **where).tolist()  # tested above
    flow = fitted_flow(t, x, y, **where).tolist()
    u, v, kept = tnt_coordinates(t, x, y, **where, t_max=t_max, landmark=name, remove_flow=remove_flow)
    placed = []
    for i in range(len(t)):
        dt = t[i] - start
        tau = t_max * dt / length
        if not (0 <= dt <= length and tau > 0):
            assert not kept[i]
            continue
        at = []
        for axis, column in ((0, x), (1, y)):
            from_landmark = column[i] * (grid[axis] - 1) / (sensor[axis] - 1) - rows[i][axis]
            if remove_flow:
                from_landmark = from_landmark - flow[i][axis] * (dt / length)
            at.append(from_landmark / tau + (grid[axis] - 1) / 2)
        assert [u[i].item(), v[i].item()] == at
        assert kept[i].item() == all(0 <= a <= side - 1 for a, side in zip(at, grid, strict=True))
        if kept[i]:
            placed.append(((bins - 1) * dt / length, at[1], at[0], p[i]))
    got = tnt_volume(
        t,
        x,
        y,
        p,
        **where,
        bins=bins,
        t_max=t_max,
        polarity=polarity,
        landmark=name,
        remove_flow=remove_flow,
        dtype=torch.float64,
    )
    assert_volumes_agree(got, volume_twin(placed, bins, grid, polarity))


@settings(deadline=None, max_examples=100, derandomize=True)
@given(windows(), st.integers(1, 5), st.sampled_from(["signed", "unsigned", "split"]))
def test_raw_volume(window, bins, polarity):
    (t, x, y, p), where = window
    start, length, sensor, grid = where.values()
    placed = [
        (
            (bins - 1) * (t[i] - start) / length,
            y[i] * (grid[1] - 1) / (sensor[1] - 1),
            x[i] * (grid[0] - 1) / (sensor[0] - 1),
            p[i],
        )
        for i in range(len(t))
        if 0 <= t[i] - start <= length
    ]
    got = event_volume(t, x, y, p, **where, bins=bins, polarity=polarity, dtype=torch.float64)
    assert_volumes_agree(got, volume_twin(placed, bins, grid, polarity))


def test_the_strategy_reaches_kept_events():
    """Guards the tests above against agreeing on empty volumes."""
    counts = []

    @settings(deadline=None, max_examples=100, derandomize=True, database=None)
    @given(windows())
    def count(window):
        (t, x, y, _), where = window
        counts.append(int(tnt_coordinates(t, x, y, **where).kept.sum()))

    count()
    assert sum(n > 0 for n in counts) > 30
    assert max(counts) >= 5
    assert floor(sum(counts) / len(counts)) >= 1
