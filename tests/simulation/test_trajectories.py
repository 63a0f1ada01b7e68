"""Motion: positions by hand, and flow as the positions' derivative."""

import numpy as np
import pytest

from async_tnt.simulation.trajectories import ConstantVelocity, Saccade, Saccades, nmnist_saccades

TRAJECTORIES = [
    ConstantVelocity((40.0, -25.0)),
    ConstantVelocity.towards(120.0, 55.0),
    Saccades((1.0, 2.0), (Saccade(0, 50_000, 3.0, -1.0), Saccade(30_000, 70_000, -2.0, 4.0)), 105_000),
    nmnist_saccades(),
    nmnist_saccades(np.random.default_rng(1)),
]


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
def test_flow_is_the_derivative_of_position(trajectory):
    t_us = np.linspace(100.0, trajectory.duration_us - 100.0, 997)
    for axis in (0, 1):
        slope = (trajectory.position(t_us + 1.0)[axis] - trajectory.position(t_us - 1.0)[axis]) / 2e-6
        # 0.02 px/s: the flow's largest second derivative, some 1e6 px/s^3, times (1 us)^2, and rounding
        np.testing.assert_allclose(trajectory.flow(t_us)[axis], slope, atol=0.02)


def test_constant_velocity_by_hand():
    dx, dy = ConstantVelocity((100.0, -50.0), start=(3.0, 4.0)).position(np.array([0, 10_000, 50_000]))
    np.testing.assert_allclose(dx, [3.0, 4.0, 8.0])
    np.testing.assert_allclose(dy, [4.0, 3.5, 1.5])


@pytest.mark.parametrize(("angle", "direction"), [(0, (1, 0)), (90, (0, 1)), (180, (-1, 0)), (270, (0, -1))])
def test_towards_an_angle_passes_the_centre_at_half_time(angle, direction):
    motion = ConstantVelocity.towards(angle, 50.0, centre=(3.0, 2.0), duration_us=100_000)
    np.testing.assert_allclose(motion.position(50_000), (3.0, 2.0))
    np.testing.assert_allclose(motion.flow(0), 50.0 * np.array(direction), atol=1e-12)


def test_saccade_by_hand():
    # s(1/4) = 10/64 - 15/256 + 6/1024 = 0.103515625; peak speed 15/8 of the mean, halfway
    saccade = Saccade(10_000, 40_000, 1.0, 0.0)
    np.testing.assert_allclose(
        saccade.progress([0, 10_000, 20_000, 30_000, 50_000, 90_000]), [0, 0, 0.103515625, 0.5, 1, 1]
    )
    np.testing.assert_allclose(saccade.speed([10_000, 30_000, 50_000]), [0, 1.875 / 0.04, 0])


def test_nmnist_goes_round_a_triangle_of_about_5_px_a_side():
    dx, dy = nmnist_saccades().position(np.array([0, 92_000, 222_000, 308_000]))
    sides = np.stack([np.diff(dx), np.diff(dy)], axis=1)
    down, up, left = sides
    assert down[1] > 5 and 1 < down[0] < 2.5
    assert up[1] < -4 and up[0] > 3
    assert left[0] < -5 and abs(left[1]) < 1
    np.testing.assert_allclose(sides.sum(axis=0), 0.0, atol=0.5)


def test_delays_are_random_but_reproducible():
    one, again, other = (nmnist_saccades(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one == again and one != other


@pytest.mark.parametrize(
    ("build", "complaint"),
    [
        (lambda: ConstantVelocity((np.nan, 0.0)), "`velocity` must be two finite numbers, got"),
        (
            lambda: ConstantVelocity((0.0, 0.0), duration_us=0),
            "`duration_us` must be a positive number of microseconds, got 0",
        ),
        (lambda: Saccade(0, -5, 1.0, 1.0), "`duration_us` must be a positive number of microseconds, got -5"),
        (lambda: Saccades((1.0,), (), 10), r"`start` must be two finite numbers, got \(1\.0,\)"),
    ],
)
def test_impossible_motion_is_refused(build, complaint):
    with pytest.raises(ValueError, match=complaint):
        build()
