"""The motion model L_v is a group that acts on events; and undoing the flow makes a moving object still."""

import numpy as np
import pytest
import tnt_reference
from hypothesis import given
from hypothesis import strategies as st
from made import nasty_streams, random_events

from async_tnt.representations.motion import move_by_flow, undo_flow

AT = dict(start_us=1_000, window_us=1 << 16)  # 2**16 us: every fraction f is exact in float64
EXACT = [(8, -3), (-1.75, 12.125)]
ANY = [(5 / 3, 0.1), (255.9, -129.3)]


def stream():
    events = random_events(500, duration_us=AT["window_us"], start_us=AT["start_us"], sensor=(346, 260))
    return events["t"], events["x"], events["y"]


def act(flow, points, **at):
    """L_v on (t, x, y)."""
    t, x, y = points
    return (t, *move_by_flow(t, x, y, flow, **(at or AT)))


def difference(a, b):
    return max(np.abs(np.subtract(p, q)).max() for p, q in zip(a, b, strict=True))


def test_by_hand():
    """A quarter, the half, the end of a window of 800 us from 1000 us on; and an event before it, at f = -1/2."""
    t, x, y = [1_200, 1_400, 1_800, 600], [10, 10, 10, 10], [20, 20, 20.5, 20]
    at = dict(start_us=1_000, window_us=800)
    moved = move_by_flow(t, x, y, (8, -4), **at)
    assert [column.tolist() for column in moved] == [[12, 14, 18, 6], [19, 18, 16.5, 22]]
    back = undo_flow(t, *moved, (8, -4), **at)
    assert [column.tolist() for column in back] == [[10, 10, 10, 10], [20, 20, 20.5, 20]]


@pytest.mark.parametrize("v", EXACT + ANY, ids=str)
@pytest.mark.parametrize("w", EXACT + ANY, ids=str)
def test_a_group_that_acts_on_events(v, w):
    """L_v L_w = L_(v + w) = L_w L_v and L_-v L_v = L_0: to the last bit where f is k / 2**16, and v and w are m / 8;
    otherwise to 2e-13 px, four units in the last place of 346 + 256."""
    exact = v in EXACT and w in EXACT
    at = AT if exact else dict(start_us=1_000, window_us=105_000)
    bound = 0 if exact else 2e-13
    points = stream()
    both = act(v, act(w, points, **at), **at)
    assert difference(both, points) > 1
    assert difference(both, act(np.add(v, w), points, **at)) <= bound
    assert difference(both, act(w, act(v, points, **at), **at)) <= bound
    assert difference(act(np.negative(v), act(v, points, **at), **at), points) <= bound


@given(st.data())
def test_equals_reference_bit_for_bit(data):
    """Both do the operations of the equation, in its order."""
    start_us = data.draw(st.sampled_from([0, 123_456_789, 1_700_000_000_000_000]))
    window_us = data.draw(st.sampled_from([1, 7, 800, 105_000]))
    events = data.draw(nasty_streams((34, 34), 2 * window_us, start_us))
    flow = data.draw(st.tuples(*[st.floats(-50, 50)] * 2))
    t, x, y = (events[name] for name in "txy")
    got = move_by_flow(t, x, y, flow, start_us=start_us, window_us=window_us)
    twin = tnt_reference.move_by_flow(t, x, y, flow, start_us=start_us, window_us=window_us)
    assert [column.tobytes() for column in got] == [column.numpy().tobytes() for column in twin]


@pytest.mark.parametrize(
    ("bad", "error", "message"),
    [
        (dict(flow=(1, 2, 3)), ValueError, r"`flow` must be two finite numbers \(v_x, v_y\) in pixels per window"),
        (dict(flow=(1, float("nan"))), ValueError, r"`flow` must be two finite numbers .* got \(1, nan\)"),
        (dict(t=[0.5]), TypeError, r"`t` must be integer microseconds, got float64"),
        (dict(t=[-1]), ValueError, r"`t` must be in \[0, 2\*\*62\) microseconds, got -1 to -1"),
        (dict(t=[1, 2]), ValueError, r"t, x and y must have equal lengths, got 2, 1, 1"),
        (dict(x=["a"]), TypeError, r"`x` must be numbers, got <U1"),
        (dict(y=[float("inf")]), ValueError, r"`y` must be finite, got inf at event 0"),
        (dict(window_us=0), ValueError, r"`window_us` must be in \[1, 3600000000\], got 0"),
    ],
    ids=str,
)
def test_bad_arguments(bad, error, message):
    with pytest.raises(error, match=message):
        move_by_flow(**dict(t=[5], x=[1], y=[1], flow=(1, 1), start_us=0, window_us=10) | bad)


def test_no_events_and_unsigned_times():
    assert [c.tolist() for c in move_by_flow([], [], [], (1, 1), **AT)] == [[], []]
    x, _ = move_by_flow(np.array([500], np.uint64), [1], [1], (65_536.0, 0), **AT)
    assert x.tolist() == [1 - 500]  # 500 us before the window: no wrap-around
