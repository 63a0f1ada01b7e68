"""The motions of N-MOVING-MNIST: where they lead, and that events follow them."""

import numpy as np
import pytest

from experiments.motions import KINDS, motions_of
from experiments.trajectories import nmnist_saccades

RNG = np.random.default_rng(0)
STRAIGHT = {f"{kind} {motion.name}": motion for kind in KINDS if kind != "nmnist" for motion in motions_of(kind)}
of_straight = pytest.mark.parametrize("motion", STRAIGHT.values(), ids=STRAIGHT)


@of_straight
def test_a_digit_is_displaced_as_stated_from_the_centre_or_through_it(motion):
    x, y = motion.trajectory(RNG).position(np.arange(0, 105_001, 500))
    angle = np.radians(motion.direction_deg)  # to the right and, as y grows downwards, down
    by_hand = motion.distance_px * np.cos(angle), motion.distance_px * np.sin(angle)
    np.testing.assert_allclose((x[-1] - x[0], y[-1] - y[0]), by_hand, atol=1e-9)
    at_centre_us = 0 if "centre" in motion.kind else 52_500
    np.testing.assert_allclose(motion.trajectory(RNG).position(at_centre_us), (3, 3))
    elsewhere = motion.trajectory(RNG, image=(10, 20), sensor=(100, 50))
    np.testing.assert_allclose(elsewhere.position(at_centre_us), (45, 15))
    if at_centre_us:  # stays on the sensor: most digits leave the outermost ring of MNIST's 28 x 28 pixels empty
        assert min(x.min(), y.min()) + 1 >= 0 and max(x.max(), y.max()) + 26 <= 33


def test_nmnists_motion_is_its_saccades_centred_on_any_sensor():
    (motion,) = motions_of("nmnist")
    assert motion.duration_us == 308_000
    assert motion.flow_times_us[[0, 1, -1]].tolist() == [0, 3_500, 308_000]
    trajectory, other = (motion.trajectory(np.random.default_rng(seed)) for seed in (4, 5))
    assert trajectory == nmnist_saccades(np.random.default_rng(4)) != other  # delays are drawn
    moved = motion.trajectory(np.random.default_rng(4), sensor=(44, 54))
    np.testing.assert_allclose(np.subtract(moved.start, trajectory.start), (5, 10))
