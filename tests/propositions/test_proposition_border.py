"""What the transform costs: an object shrinks like 1 / tau, and what lies beyond the border is lost."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from made import events_of, random_events
from tnt_reference import tnt_coordinates

from async_tnt import TNTConfig, TNTVolume

WINDOW_US = 105_000
T_MAX = (0.5, 1.0, 2.0, 3.0, 4.0, 8.0, 16.0)


def counts(events, t_max, sensor=(34, 34)):
    volume = TNTVolume(TNTConfig(window_us=WINDOW_US, t_max=t_max, landmark="center", sensor=sensor, grid=sensor))
    volume.open(0)
    volume.update(events)
    return volume.counts


@pytest.mark.parametrize("t_max", T_MAX)
def test_an_event_is_lost_exactly_where_tau_is_less_than_its_distance_from_the_landmark(t_max):
    """Kept iff |x - c| / tau <= c and |y - c| / tau <= c, in the stream, by whole numbers:
    |2 x - 33| T <= 33 t_max dt. Of 5,000 events anywhere, and of those that come, for each column and each row, at the
    last microsecond before tau is enough and at the first at which it is."""
    enough = [abs(2 * k - 33) * WINDOW_US / (33 * Fraction(t_max)) for k in range(34)]
    near = [
        (t, *xy, 1)
        for k, dt in enumerate(enough)
        for t in (math.ceil(dt) - 1, math.ceil(dt), math.floor(dt))
        for xy in ((k, 16), (17, k))
        if t < WINDOW_US
    ]
    assert len(near) > 60
    events = np.concatenate([random_events(5_000, duration_us=WINDOW_US), events_of(*zip(*near, strict=True))])
    n_kept = sum(
        dt > 0 and max(abs(2 * x - 33), abs(2 * y - 33)) * WINDOW_US <= 33 * Fraction(t_max) * dt
        for dt, x, y, _ in events.tolist()
    )
    got = counts(events, t_max)
    assert 0 < got.kept == n_kept
    assert got.dropped_outside + got.dropped_tau_zero == len(events) - n_kept > 0


def test_the_share_kept_of_events_from_everywhere():
    """Of events uniform over time and a continuous image, the share min(1, tau)^2 is kept at tau; over the window

        1 - 2 / (3 t_max)  for t_max >= 1,        t_max^2 / 3  for t_max <= 1.

    91.7 % at 8, a third at 1. Within 1 % for 50,000 events on 346 x 260 pixels.
    """
    events = random_events(50_000, seed=1, duration_us=WINDOW_US, sensor=(346, 260))
    kept = [counts(events, t_max, (346, 260)).kept / 50_000 for t_max in T_MAX]
    assert kept == pytest.approx([t**2 / 3 if t <= 1 else 1 - 2 / (3 * t) for t in T_MAX], abs=0.01)


@pytest.mark.parametrize("t_max", [1.0, 2.0, 8.0])
def test_an_object_is_compressed_by_tau(t_max):
    """Size (standard deviation of u and of v) over size at rest is 1 / tau at every instant, to 1e-12: at the window's
    end 1 / t_max. Identity at f = 1 / t_max, and about any landmark and under any flow."""
    shape = torch.rand(2, 200, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 10 - 5
    n_compared = 0
    for k in (2, 4, 8, 16):
        f, t = k / 16, torch.full((200,), k * 1_000)
        for place, landmark in ((28.0, "center"), (20.0, (21.5, 19.0)), (28.0 + 6 * f, (28.0, 28.0))):
            x, y = shape + place
            at = dict(start_us=0, window_us=16_000, sensor=(57, 57), grid=(57, 57))
            moved = tnt_coordinates(t, x, y, **at, t_max=t_max, landmark=landmark)
            if moved.kept.all():
                n_compared += 1
                for got, still in ((moved.u, x), (moved.v, y)):
                    assert (got.std() / still.std()).item() == pytest.approx(1 / (t_max * f), rel=1e-12)
    assert n_compared >= 6
