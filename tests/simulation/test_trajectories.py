"""Motion: positions by hand."""

import numpy as np

from async_tnt.simulation.trajectories import Saccade, nmnist_saccades


def test_saccade_by_hand():
    progress = Saccade(10_000, 40_000, 1.0, 0.0).progress([0, 10_000, 20_000, 30_000, 50_000, 90_000])
    np.testing.assert_allclose(progress, [0, 0, 10 / 64 - 15 / 256 + 6 / 1024, 0.5, 1, 1])  # s(1/4), then halfway


def test_nmnist_goes_round_a_triangle_of_about_5_px_a_side():
    dx, dy = nmnist_saccades().position(np.array([0, 92_000, 222_000, 308_000]))
    sides = np.stack([np.diff(dx), np.diff(dy)], axis=1)
    np.testing.assert_allclose(sides, [(1.4, 5.4), (4.0, -5.1), (-5.3, -0.3)], atol=0.2)
    np.testing.assert_allclose(sides.sum(axis=0), 0.0, atol=0.5)
