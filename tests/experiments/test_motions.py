"""The motions of N-MOVING-MNIST: where they lead, and that events follow them."""

import numpy as np
import pytest

from experiments.motions.kinds import KINDS, motions_of
from experiments.motions.simulated_digits import simulate_digit
from experiments.motions.trajectories import nmnist_saccades

RNG = np.random.default_rng(0)
STRAIGHT = {
    f"{kind} {motion.name}": motion
    for kind in KINDS
    if kind not in ("nmnist", "beyond")
    for motion in motions_of(kind)
}
of_straight = pytest.mark.parametrize("motion", STRAIGHT.values(), ids=STRAIGHT)


@of_straight
def test_a_digit_is_displaced_as_stated_from_the_centre_or_through_it(motion):
    x, y = motion.trajectory(RNG).position(np.arange(0, 105_001, 500))
    # An angle of 0 is to the right, and 90 degrees are down, as y grows downwards.
    angle = np.radians(motion.direction_deg)
    by_hand = motion.distance_px * np.cos(angle), motion.distance_px * np.sin(angle)
    np.testing.assert_allclose((x[-1] - x[0], y[-1] - y[0]), by_hand, atol=1e-9)
    at_centre_us = 0 if "centre" in motion.kind else 52_500
    np.testing.assert_allclose(motion.trajectory(RNG).position(at_centre_us), (3, 3))
    elsewhere = motion.trajectory(RNG, image=(10, 20), sensor=(100, 50))
    np.testing.assert_allclose(elsewhere.position(at_centre_us), (45, 15))
    # stays on the sensor: most digits leave the outermost ring of MNIST's 28 x 28 pixels empty
    if at_centre_us:
        assert min(x.min(), y.min()) + 1 >= 0 and max(x.max(), y.max()) + 26 <= 33


def test_motions_beyond_those_that_are_resynthesized():
    """The motions are 14 px through the centre, 5 px and back, and a loop.

    The first one has a constant velocity. The first side of the loop is 4 px.
    """
    moving = motions_of("beyond")
    assert [motion.name for motion in moving[:4]] == [
        "000deg-14px",
        "000deg-back",
        "000deg-loop",
        "036deg-14px",
    ]
    for motion in moving:
        path = np.stack(motion.trajectory(RNG).position(np.linspace(0, 105_000, 211)), axis=1)
        angle = np.radians(motion.direction_deg)
        along = (path - path[0]) @ (np.cos(angle), np.sin(angle))
        if motion.shape == "line":
            np.testing.assert_allclose(along, np.linspace(0, 14, 211), atol=1e-9)
            continue
        np.testing.assert_allclose(path[-1], path[0], atol=1e-9)
        assert along.max() == pytest.approx(motion.distance_px, abs=0.01) and along.min() > -0.01
        across = (path - path[0]) @ (-np.sin(angle), np.cos(angle))
        assert np.ptp(across) == pytest.approx(4 if motion.shape == "loop" else 0, abs=0.01)


# Every fourth motion: they have all distances.
@pytest.mark.parametrize("motion", motions_of()[::4], ids=lambda motion: motion.name)
def test_events_move_as_stated_by_cross_correlation(motion):
    """Events of the window's first fifth are correlated with those of its last fifth.

    .8 of the displacement lies between them.
    """
    rng = np.random.default_rng(motion.index)
    image = np.zeros((28, 28))
    image[9:19, 10:12] = 1.0
    image[9:11, 10:18] = 1.0
    image[14:16, 12:20] = 1.0
    trajectory = motion.trajectory(rng, sensor=(64, 64))
    events = simulate_digit(image, rng, trajectory=trajectory, sensor=(64, 64))
    counts = [np.zeros((64, 64)) for _ in range(2)]
    for count, some in zip(
        counts, (events[events["t"] < 21_000], events[events["t"] >= 84_000]), strict=True
    ):
        np.add.at(count, (some["y"], some["x"]), np.where(some["p"], 1.0, -1.0))
    spectra = [np.fft.fft2(count) for count in counts]
    correlation = np.fft.fftshift(np.fft.ifft2(spectra[0].conj() * spectra[1]).real)
    row, column = np.unravel_index(correlation.argmax(), correlation.shape)
    around = np.maximum(correlation[row - 1 : row + 2, column - 1 : column + 2], 0)
    dy = np.average(np.indices((3, 3))[0] - 1, weights=around)
    dx = np.average(np.indices((3, 3))[1] - 1, weights=around)
    angle = np.radians(motion.direction_deg)
    by_hand = 0.8 * motion.distance_px * np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose((column - 32 + dx, row - 32 + dy), by_hand, atol=0.8)


def test_nmnists_motion_is_its_saccades_centred_on_any_sensor():
    (motion,) = motions_of("nmnist")
    assert motion.duration_us == 308_000
    assert motion.flow_times_us[[0, 1, -1]].tolist() == [0, 3_500, 308_000]
    trajectory = motion.trajectory(np.random.default_rng(4))
    assert trajectory == nmnist_saccades(np.random.default_rng(4))
    # delays are drawn
    assert trajectory != motion.trajectory(np.random.default_rng(5))
    moved = motion.trajectory(np.random.default_rng(4), sensor=(44, 54))
    np.testing.assert_allclose(np.subtract(moved.start, trajectory.start), (5, 10))
