"""What motion an event camera sees, on simulated events: which polarity, and along which edges.

A pixel follows log luminance L; for a pattern that moves with velocity v, dL/dt = -v . grad L.
"""

import numpy as np
from moving_scenes import noiseless_events

from experiments.motions.scene import Scene, render
from experiments.motions.trajectories import ConstantVelocity

SENSOR = (34, 34)
THRESHOLD = 0.19  # of log luminance; log 5 = 1.609 holds 8 of them


def events_of_motion(image, start, end):
    """Events of noiseless pixels that see an image move.

    It moves from displacement `start` to `end`, both (x, y) in pixels, in 100 ms.
    """
    velocity = (10 * (end[0] - start[0]), 10 * (end[1] - start[1]))  # pixels per second
    motion = ConstantVelocity(velocity, start, 100_000)
    times = np.linspace(0, 100_000, 101)
    scene = Scene(contrast=5.0, gamma=1.0)
    light = render(image, *motion.position(times), scene=scene, sensor=SENSOR)
    return noiseless_events(light, times, THRESHOLD, THRESHOLD)


def counts(events, polarity):
    """Events of one polarity per pixel, (34, 34)."""
    chosen = events[events["p"] == polarity]
    return np.bincount(chosen["y"] * 34 + chosen["x"], minlength=34 * 34).reshape(34, 34)


def test_reversed_motion_flips_the_polarity_at_each_pixel():
    """n_ON(v) = n_OFF(-v) and n_OFF(v) = n_ON(-v), pixel by pixel.

    For dL/dt = -v . grad L, and -v for v gives -dL/dt. The square is wider than the way it goes, so
    one edge alone passes over a pixel, and the pixel's light only rises or only falls. A pixel that
    the edge passes altogether gives floor(log 5 / C) = 8 events.
    """
    square = np.zeros((28, 28))
    square[8:20, 8:20] = 1
    for start, end in (((0.0, 3.0), (6.0, 3.0)), ((3.0, 6.0), (3.0, 0.0))):
        there = events_of_motion(square, start, end)
        back = events_of_motion(square, end, start)
        on = counts(there, 1)
        off = counts(there, 0)
        np.testing.assert_array_equal(counts(back, 0), on)
        np.testing.assert_array_equal(counts(back, 1), off)
        assert on.max() == off.max() == 8 and not (on * off).any()
        assert min((on > 0).sum(), (off > 0).sum()) >= 60


def test_an_edge_parallel_to_the_motion_gives_no_events():
    """dL/dt = -v . grad L = 0 where v is along the edge.

    A bar that moves along its length gives events at its ends only. Across its length, it gives the
    same number in each column, and as many if it also moves to the side (the aperture problem).
    """
    bar = np.zeros((28, 28))
    bar[12:16, 3:25] = 1  # 22 px long, on sensor columns 6-27 at displacement (3, y)
    middle = slice(13, 21)  # 4 px and more from the ends wherever it goes

    def events_by_column(start, end):
        return np.bincount(events_of_motion(bar, start, end)["x"], minlength=34)

    along = events_by_column((0.0, 3.0), (6.0, 3.0))
    across = events_by_column((3.0, 0.0), (3.0, 6.0))
    slanting = events_by_column((3.0, 0.0), (8.0, 6.0))
    assert along.sum() > 300 and along[middle].sum() == 0
    assert along[:11].sum() == along[23:].sum() == along.sum() / 2
    assert across[middle].min() == across[middle].max() > 50
    np.testing.assert_array_equal(slanting[middle], across[middle])
