"""The motions of N-MOVING-MNIST: where they lead, and that events follow them."""

import numpy as np
import pytest

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.trajectories import nmnist_saccades
from experiments.motions import KINDS, flow_of, motions_of

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


@pytest.mark.parametrize("motion", list(STRAIGHT.values())[::7], ids=list(STRAIGHT)[::7])
def test_events_follow_the_stated_flow(motion):
    """Moved back by the flow that a set states, events of a polarity lie on edges: sharper than by any other flow."""
    y, x = np.mgrid[:28, :28]
    discs = sum(np.clip(2.5 - np.hypot(x - a, y - b), 0.0, 1.0) for a, b in ((9, 8), (18, 11), (12, 19), (19, 18)))
    trajectory = motion.trajectory(RNG)
    events = simulate_digit(discs, np.random.default_rng(0), trajectory=trajectory)[::2]  # half of them is enough
    t_us = np.array([0, *motion.flow_times_us, 105_000])
    flow = flow_of(trajectory, motion.flow_times_us)[[0, *range(len(motion.flow_times_us)), -1]]
    steps = (flow[1:] + flow[:-1]) / 2 * np.diff(t_us)[:, None] * 1e-6
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    by = np.stack([np.interp(events["t"], t_us, path[:, k]) for k in (0, 1)], axis=1)
    sign = 2.0 * events["p"] - 1.0

    def sharpness(flow):
        x, y = events["x"] - flow[:, 0], events["y"] - flow[:, 1]
        distance2 = np.square(x[:, None] - x) + np.square(y[:, None] - y)
        return sign @ np.exp(-distance2) @ sign

    turned = [by @ np.array([[c, s], [-s, c]]) for c, s in ((0.6, 0.8), (0.6, -0.8))]
    others = [scale * by for scale in (-1.0, 0.0, 0.4, 1.8)]
    assert sharpness(by) > max(map(sharpness, [*others, *turned]))


def test_nmnists_motion_is_its_saccades_centred_on_any_sensor():
    (motion,) = motions_of("nmnist")
    assert motion.duration_us == 308_000
    assert motion.flow_times_us[[0, 1, -1]].tolist() == [0, 3_500, 308_000]
    trajectory, other = (motion.trajectory(np.random.default_rng(seed)) for seed in (4, 5))
    assert trajectory == nmnist_saccades(np.random.default_rng(4)) != other  # delays are drawn
    moved = motion.trajectory(np.random.default_rng(4), sensor=(44, 54))
    np.testing.assert_allclose(np.subtract(moved.start, trajectory.start), (5, 10))
