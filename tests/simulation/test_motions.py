"""The motions of N-MOVING-MNIST: where they lead, how fast, and that they differ."""

import numpy as np
import pytest

from async_tnt.simulation.motions import motions_of
from async_tnt.simulation.trajectories import nmnist_saccades

RNG = np.random.default_rng(0)
STRAIGHT = [motion for kind in ("constant", "bell") for motion in motions_of(kind)]


def name_of(motion):
    return f"{motion.kind} {motion.name}"


@pytest.mark.parametrize("kind", ["constant", "bell"])
def test_thirty_motions_ten_directions_three_distances(kind):
    moving = motions_of(kind)
    assert [motion.index for motion in moving] == list(range(30))
    names = [motion.name for motion in moving]
    assert names == sorted(names) and len(set(names)) == 30
    assert {motion.direction_deg for motion in moving} == {0, 36, 72, 108, 144, 180, 216, 252, 288, 324}
    assert {motion.distance_px for motion in moving} == {3, 5, 8}
    assert {motion.kind for motion in moving} == {kind} and {motion.duration_us for motion in moving} == {105_000}


def test_no_two_motions_lead_the_same_way():
    """Displacements are at least 3 px x 2 sin(18 degrees) = 1.85 px apart."""
    for kind in ("constant", "bell"):
        ends = np.array([np.subtract(*path_ends(motion)) for motion in motions_of(kind)])
        apart = np.linalg.norm(ends[:, None] - ends[None], axis=2)[~np.eye(30, dtype=bool)]
        assert apart.min() == pytest.approx(6 * np.sin(np.radians(18)))


def path_ends(motion):
    x, y = motion.trajectory(RNG).position(np.array([0, motion.duration_us]))
    return np.array([x[1], y[1]]), np.array([x[0], y[0]])


@pytest.mark.parametrize(
    ("name", "by_hand"),
    [
        ("000deg-5px", (5, 0)),
        ("180deg-3px", (-3, 0)),
        ("036deg-8px", (6.4721, 4.7023)),  # 8 cos 36, 8 sin 36: to the right and down
        ("252deg-8px", (-2.4721, -7.6085)),
    ],
)
@pytest.mark.parametrize("kind", ["constant", "bell"])
def test_displacement_by_hand(kind, name, by_hand):
    (motion,) = [motion for motion in motions_of(kind) if motion.name == name]
    end, start = path_ends(motion)
    np.testing.assert_allclose(end - start, by_hand, atol=1e-4)


@pytest.mark.parametrize("motion", STRAIGHT, ids=name_of)
def test_the_image_is_centred_at_half_time(motion):
    np.testing.assert_allclose(motion.trajectory(RNG).position(52_500), (3, 3))
    elsewhere = motion.trajectory(RNG, image=(10, 20), sensor=(100, 50))
    np.testing.assert_allclose(elsewhere.position(52_500), (45, 15))


@pytest.mark.parametrize("motion", STRAIGHT, ids=name_of)
def test_digits_stay_on_the_sensor(motion):
    # most digits leave the outermost ring of MNIST's 28 x 28 pixels empty
    x, y = motion.trajectory(RNG).position(np.arange(0, 105_001, 500))
    assert min(x.min(), y.min()) + 1 >= 0 and max(x.max(), y.max()) + 26 <= 33


@pytest.mark.parametrize("motion", [*STRAIGHT, *motions_of("nmnist")], ids=name_of)
def test_flow_is_the_derivative_of_position(motion):
    trajectory = motion.trajectory(np.random.default_rng(1))
    t_us = np.linspace(100.0, motion.duration_us - 100.0, 499)
    for axis in (0, 1):
        slope = (trajectory.position(t_us + 1.0)[axis] - trajectory.position(t_us - 1.0)[axis]) / 2e-6
        np.testing.assert_allclose(trajectory.flow(t_us)[axis], slope, atol=0.02)  # px/s; see test_trajectories


def test_constant_motions_have_one_flow_and_bells_a_saccades():
    constant, bell = motions_of("constant")[1], motions_of("bell")[1]  # 5 px to the right
    assert constant.flow_times_us.tolist() == [52_500]
    for t_us in (0, 52_500, 105_000):
        np.testing.assert_allclose(constant.trajectory(RNG).flow(t_us), (5 / 0.105, 0))
    assert bell.flow_times_us.tolist() == list(range(0, 105_001, 3_500))
    vx, _ = bell.trajectory(RNG).flow(np.array([0, 52_500, 105_000]))
    np.testing.assert_allclose(vx, [0, 15 / 8 * 5 / 0.105, 0])


def test_nmnists_motion_is_its_saccades_centred_on_any_sensor():
    (motion,) = motions_of("nmnist")
    assert motion.name == "nmnist" and motion.duration_us == 308_000
    assert motion.direction_deg is None and motion.distance_px is None
    assert motion.flow_times_us[[0, 1, -1]].tolist() == [0, 3_500, 308_000]
    trajectory = motion.trajectory(np.random.default_rng(4))
    assert trajectory == nmnist_saccades(np.random.default_rng(4)) != nmnist_saccades()
    moved = motion.trajectory(np.random.default_rng(4), sensor=(44, 54))
    np.testing.assert_allclose(np.subtract(moved.start, trajectory.start), (5, 10))


def test_unknown_kinds_are_refused():
    with pytest.raises(ValueError, match="must be one of 'constant', 'bell', 'nmnist', got 'circles'"):
        motions_of("circles")
