"""What the transform costs: objects shrink like 1 / tau, and what is beyond the border is lost."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from made import events_of, opened, random_events
from tnt_reference import tnt_coordinates

from async_tnt import TNTConfig

WINDOW_US = 105_000


@pytest.mark.parametrize("t_max", [0.5, 1.0, 3.0, 8.0])
def test_an_event_is_lost_exactly_where_tau_is_less_than_its_distance_from_the_landmark(t_max):
    """Kept iff |x - c| / tau <= c and |y - c| / tau <= c.

    In the stream this is decided by whole numbers: |2 x - 33| T <= 33 t_max dt. There are 5,000
    events anywhere. And for each column and each row, there are events at the last microsecond
    before tau is enough, and at the first at which it is.
    """
    near = []
    for k in range(34):
        enough = abs(2 * k - 33) * WINDOW_US / (33 * Fraction(t_max))
        for t in (math.ceil(enough) - 1, math.ceil(enough), math.floor(enough)):
            if t < WINDOW_US:
                near += [(t, k, 16, 1), (t, 17, k, 1)]
    assert len(near) > 60
    anywhere = random_events(5_000, duration_us=WINDOW_US)
    events = np.concatenate([anywhere, events_of(*zip(*near, strict=True))])

    n_kept = 0
    for dt, x, y, _ in events.tolist():
        distance = max(abs(2 * x - 33), abs(2 * y - 33))
        n_kept += dt > 0 and distance * WINDOW_US <= 33 * Fraction(t_max) * dt
    got = opened(TNTConfig(window_us=WINDOW_US, t_max=t_max, landmark="center"), events).counts
    assert 0 < got.kept == n_kept
    assert got.dropped_outside + got.dropped_tau_zero == len(events) - n_kept > 0


def test_an_object_is_compressed_by_tau():
    """Its size over its size at rest is 1 / tau at every instant, to 1e-12.

    The size is the standard deviation of u, and of v. At the window's end the ratio is 1 / t_max.
    This holds about any landmark and under any flow.
    """
    generator = torch.Generator().manual_seed(0)
    shape = torch.rand(2, 200, generator=generator, dtype=torch.float64) * 10 - 5
    at = dict(start_us=0, window_us=16_000, sensor=(57, 57), grid=(57, 57))
    for t_max, f in ((2.0, 0.5), (2.0, 1.0), (8.0, 0.25), (8.0, 1.0)):
        t = torch.full((200,), int(f * 16_000))
        for place, landmark in (
            (28.0, "center"),
            (20.0, (21.5, 19.0)),
            (28.0 + 6 * f, (28.0, 28.0)),
        ):
            x, y = shape + place
            moved = tnt_coordinates(t, x, y, **at, t_max=t_max, landmark=landmark)
            assert moved.kept.all()
            for got, still in ((moved.u, x), (moved.v, y)):
                assert (got.std() / still.std()).item() == pytest.approx(1 / (t_max * f), rel=1e-12)
