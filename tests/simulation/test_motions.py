"""Motion: positions by hand, and flow as their derivative."""

import numpy as np
import pytest

from async_tnt.simulation.trajectories import ConstantVelocity, Saccade, Saccades, nmnist_saccades

TRAJECTORIES = {
    "constant": ConstantVelocity((40.0, -25.0)),
    "overlapping saccades": Saccades(
        (1.0, 2.0), (Saccade(0, 50_000, 3.0, -1.0), Saccade(30_000, 70_000, -2.0, 4.0)), 105_000
    ),
    "N-MNIST": nmnist_saccades(),
    "N-MNIST delayed": nmnist_saccades(np.random.default_rng(1)),
}


@pytest.mark.parametrize("trajectory", TRAJECTORIES.values(), ids=TRAJECTORIES)
def test_flow_is_the_derivative_of_position(trajectory):
    t_us = np.linspace(100.0, trajectory.duration_us - 100.0, 499)
    for axis in (0, 1):
        slope = (trajectory.position(t_us + 1.0)[axis] - trajectory.position(t_us - 1.0)[axis]) / 2e-6
        # 0.02 px/s: the flow's largest second derivative, some 1e6 px/s^3, times (1 us)^2, and rounding
        np.testing.assert_allclose(trajectory.flow(t_us)[axis], slope, atol=0.02)


def test_saccade_by_hand():
    # s(1/4) = 10/64 - 15/256 + 6/1024 = 0.103515625; peak speed 15/8 of the mean, halfway
    saccade = Saccade(10_000, 40_000, 1.0, 0.0)
    progress = saccade.progress([0, 10_000, 20_000, 30_000, 50_000, 90_000])
    np.testing.assert_allclose(progress, [0, 0, 0.103515625, 0.5, 1, 1])
    np.testing.assert_allclose(saccade.speed([10_000, 30_000, 50_000]), [0, 1.875 / 0.04, 0])


def test_nmnist_goes_round_a_triangle_of_about_5_px_a_side():
    dx, dy = nmnist_saccades().position(np.array([0, 92_000, 222_000, 308_000]))
    sides = np.stack([np.diff(dx), np.diff(dy)], axis=1)
    np.testing.assert_allclose(sides, [(1.4, 5.4), (4.0, -5.1), (-5.3, -0.3)], atol=0.2)
    np.testing.assert_allclose(sides.sum(axis=0), 0.0, atol=0.5)
