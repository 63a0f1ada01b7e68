"""Scenes with known flow, plane fits by hand, and the flow that a network tells after an event."""

from __future__ import annotations

import numpy as np
import pytest

from async_tnt import EVENT_DTYPE, CompiledNetwork, Model, Output, Processor
from async_tnt.simulation import PixelModel

torch = pytest.importorskip("torch", reason="the network needs torch")

from examples.optical_flow.drawing import FINENESS  # noqa: E402
from examples.optical_flow.network import (  # noqa: E402
    HOP_US,
    WINDOW_US,
    flow_config,
    flow_network,
)
from examples.optical_flow.plane_fit import (  # noqa: E402
    PLANE_SETTINGS,
    POOLED_SETTINGS,
    PlaneFit,
    PlaneSettings,
    normal_flows,
)
from examples.optical_flow.scenes import (  # noqa: E402
    TRAINED,
    Motion,
    Scene,
    ground_of,
    random_object,
    random_scene,
)
from examples.optical_flow.sequences import (  # noqa: E402
    VALIDATION,
    KnownSequence,
    ages_us,
    network_way,
    sequences,
    zero_flow,
)
from examples.optical_flow.training import Example, mirrored, train_flow  # noqa: E402
from experiments.optical_flow import comparison  # noqa: E402
from experiments.tables.parts import results  # noqa: E402

SENSOR = (48, 40)

MOTIONS = {
    "a translation": Motion(complex(20, 20), complex(120, -50)),
    "a turn": Motion(complex(20, 20), 0j, turn=3.0),
    "a growth": Motion(complex(20, 20), 0j, growth=-2.0),
    "all, on a bent path": Motion(complex(30, 10), complex(60, 90), 12.0, 2.0, 1.5),
}


def smooth_ground(motion: Motion) -> Scene:
    """A ground of low waves in several directions, without objects."""
    side = FINENESS * 128
    y, x = np.mgrid[:side, :side] / side * 2 * np.pi
    picture = 0.5 + 0.1 * (np.sin(5 * x + 3 * y) + np.cos(4 * y - 3 * x) + np.sin(6 * x - y))
    return Scene(SENSOR, (ground_of(picture, motion, SENSOR),), 4.0, PixelModel())


def test_a_translation_of_known_speed_has_that_flow():
    flow = smooth_ground(MOTIONS["a translation"]).flow(0.02)
    assert flow.shape == (2, 40, 48)
    np.testing.assert_allclose(flow[0], 120.0)
    np.testing.assert_allclose(flow[1], -50.0)


def test_the_picture_moves_by_the_flow_of_a_translation():
    """120 and -50 px/s for .1 s are 12 and -5 pixels."""
    before, after = smooth_ground(MOTIONS["a translation"]).light(np.array([0.0, 0.1]))
    np.testing.assert_allclose(after[:-5, 12:], before[5:, :-12], atol=1e-9)


def test_a_turn_and_a_growth_have_the_flow_worked_out_by_hand():
    """At (30, 20), ten pixels to the right of the middle."""
    turn = smooth_ground(MOTIONS["a turn"]).flow(0.5)
    growth = smooth_ground(MOTIONS["a growth"]).flow(0.5)
    np.testing.assert_allclose(turn[:, 20, 30], (0.0, 30.0), atol=1e-5)
    np.testing.assert_allclose(growth[:, 20, 30], (-20.0, 0.0), atol=1e-5)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_flow_explains_how_the_light_changes(motion):
    """dL/dt + u dL/dx + v dL/dy = 0."""
    scene = smooth_ground(motion)
    time_s = 0.03
    before, light, after = scene.light(time_s + np.array([-5e-4, 0.0, 5e-4]))
    change = (after - before) / 1e-3
    slope_y, slope_x = np.gradient(light)
    u, v = scene.flow(time_s)
    left_over = (change + u * slope_x + v * slope_y)[1:-1, 1:-1]
    assert np.abs(change).max() > 1.0
    assert np.abs(left_over).mean() < 0.05 * np.abs(change).mean()


def test_the_foremost_layer_has_its_own_flow():
    rng = np.random.default_rng(0)
    ground, *_ = smooth_ground(Motion(0j, complex(-30, 0))).layers
    motion = Motion(complex(20, 20), complex(0, 100))
    shown = random_object(SENSOR, 0.1, 16.0, motion, TRAINED, 0.5, rng)
    flow = Scene(SENSOR, (ground, shown), 4.0, PixelModel()).flow(0.05)
    # the object's middle is at (20, 25) by now
    np.testing.assert_allclose(flow[:, 25, 20], (0.0, 100.0), atol=1e-4)
    np.testing.assert_allclose(flow[:, 5, 40], (-30.0, 0.0), atol=1e-4)


def test_a_scene_is_made_again_by_the_same_seed():
    first, second = (
        random_scene(SENSOR, 0.02, TRAINED, rng).events(20_000, rng)
        for rng in (np.random.default_rng(3), np.random.default_rng(3))
    )
    assert len(first) > 100
    np.testing.assert_array_equal(first, second)


# -- plane fits ------------------------------------------------------------------------------------

SETTINGS = PlaneSettings(
    radius=2, oldest_us=50_000, burst_us=5_000, off_us=2_000, share=0.5, fastest_px=500.0
)
Y, X = np.mgrid[-2:3, -2:3]


def normal_flow_of(patch_us, settings=SETTINGS):
    patch = np.asarray(patch_us, np.int64)
    return normal_flows(patch[None], np.array([100_000]), settings)[0]


def test_normal_flow_by_hand():
    """The edge needs 4 ms for a pixel in x and 2 ms in y: (4, 2) / (16 + 4) pixels in 1 ms."""
    np.testing.assert_allclose(normal_flow_of(100_000 + 4_000 * X + 2_000 * Y), (200.0, 100.0))


def test_an_edge_along_an_axis_has_a_finite_flow():
    np.testing.assert_allclose(normal_flow_of(100_000 - 5_000 * X), (-200.0, 0.0), atol=1e-6)


def test_points_far_from_the_plane_and_old_points_are_left_out():
    patch = 100_000 + 4_000 * X + 2_000 * Y
    patch[0, 1] -= 15_000
    patch[4, 4] = 1_000
    np.testing.assert_allclose(normal_flow_of(patch), (200.0, 100.0), rtol=1e-6)


@pytest.mark.parametrize(
    "patch",
    [
        np.full((5, 5), 100_000),  # infinitely fast
        100_000 + 1_000 * X,  # 1,000 px/s
        np.where(X < 0, 100_000 + 4_000 * X, 0),  # 10 of 25 pixels: less than half
    ],
)
def test_where_no_plane_is_found(patch):
    assert np.isnan(normal_flow_of(patch)).all()


def test_points_on_a_line_are_no_plane():
    few = PlaneSettings(radius=2, oldest_us=50_000, off_us=2_000, share=0.1)
    assert np.isnan(normal_flow_of(np.where(X == 0, 100_000 + 4_000 * Y, 0), few)).all()


def two_edges(first_us, x, y):
    """An edge that moves in x by a pixel in 10 ms, and one that moves in y by one in 20 ms."""
    events = []
    for row in range(-3, 4):
        for column in range(-3, 4):
            events.append((first_us + 10_000 * column, x + column, y + row, 1))
            events.append((first_us + 20_000 * row, x + column, y + row, 0))
    return np.array(sorted(events), EVENT_DTYPE)


def test_two_edges_tell_the_flow_that_one_does_not():
    settings = PlaneSettings(
        radius=1, oldest_us=90_000, share=0.9, pool_radius=0, pool_us=90_000, prior=1e-9
    )
    fit = PlaneFit(SENSOR, settings)
    fit.update(two_edges(100_000, 20, 20))
    np.testing.assert_allclose(fit.flow(100_000, 20, 20, 1), (100.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(fit.flow(100_000, 20, 20, 0), (0.0, 50.0), atol=1e-6)
    np.testing.assert_allclose(fit.pooled(100_000, 20, 20), (100.0, 50.0), atol=1e-4)


def test_pooled_flow_is_zero_where_nothing_is_found():
    fit = PlaneFit(SENSOR, SETTINGS)
    np.testing.assert_array_equal(fit.pooled(1_000, 0, 0), (0.0, 0.0))
    assert np.isnan(fit.flow(1_000, 47, 39, 1)).all()


def test_only_the_first_event_of_a_burst_counts():
    """Gaps of 4 ms continue a burst of 5 ms, a gap of 6 ms ends it."""
    fit = PlaneFit(SENSOR, SETTINGS)
    times_us = [20_000, 24_000, 28_000, 34_000, 35_000]
    place = 1, 5 + fit._rim, 7 + fit._rim
    found = []
    for t in times_us:
        fit.update(np.array([(t, 7, 5, 1)], EVENT_DTYPE))
        found.append(int(fit._times_us[place]))
    assert found == [20_000, 20_000, 20_000, 34_000, 34_000]


def test_the_example_has_the_settings_that_were_chosen():
    planes = results("flow")["planes"]
    chosen = {name: PlaneSettings(**plane["settings"]) for name, plane in planes.items()}
    assert chosen == {comparison.PLANE: PLANE_SETTINGS, comparison.POOLED: POOLED_SETTINGS}


# -- network and comparison ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model() -> Model:
    """A model with random weights."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Model.from_torch(flow_network().eval(), flow_config((64, 64)))


@pytest.fixture(scope="module")
def sequence() -> KnownSequence:
    (made,) = sequences(VALIDATION, TRAINED, 1, 25, seed=1)
    return made


@pytest.mark.parametrize("hop_us", [None, HOP_US])
def test_flow_is_that_right_after_the_event_and_of_a_whole_pass(model, sequence, hop_us):
    own = model.for_sensor(sequence.sensor)
    network = CompiledNetwork(own)
    processor = Processor[Output](own, hop_us=hop_us, start_us=0)
    told = network_way(model, hop_us)(sequence)
    ages = ages_us(sequence, hop_us)
    done = 0
    for k, number in enumerate(sequence.compared.tolist()):
        processor.every_events = None
        processor.push(sequence.events[done:number])
        processor.every_events = 1
        t, x, y, p = sequence.events[number].item()
        output = processor.push((t, x, y, p))[-1]
        done = number + 1
        np.testing.assert_array_equal(output.arrays[0][:, y, x], told[k])
        np.testing.assert_array_equal(output.arrays[0], network(processor.volume())[0])
        assert t - output.window_start_us == ages[k]
    assert ages.max() < WINDOW_US and ages.min() >= (0 if hop_us is None else HOP_US)
    assert np.ptp(told) > 0


@pytest.mark.parametrize("seed", range(8))
def test_mirrored_windows_have_mirrored_flow(seed):
    """Where the flow is the slope of the volume, it is so in a mirror.

    Inverted light inverts the volume alone.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:8, :8].astype(np.float32)
    volume = (3 * x + 5 * y)[None]
    flow = np.stack([np.full_like(x, 3), np.full_like(x, 5)])
    is_new = x > y + 1
    changed = mirrored(Example(volume, flow, is_new), rng)
    slope_y, slope_x = np.gradient(changed.volume[0])
    slope = np.stack([slope_x, slope_y])
    assert np.array_equal(slope, changed.flow) or np.array_equal(slope, -changed.flow)
    # the same places are new: those with these values
    new_values = np.abs(changed.volume[0][changed.is_new])
    np.testing.assert_array_equal(np.sort(new_values), np.sort(volume[0][is_new]))


def test_a_training_gives_a_model_of_flow():
    model = train_flow(steps=2, seed=1)
    assert model.output_shapes == {"output": (2, 64, 64)}
    assert model.record["steps"] == 2 and len(model.record["error_px"]) == 2
    same = train_flow(steps=2, seed=1)
    assert all(np.array_equal(model.weights[name], same.weights[name]) for name in model.weights)


def sequence_by_hand():
    events = np.zeros(2, EVENT_DTYPE)
    events["t"] = 31_000, 47_000
    true = np.array([[30.0, 40.0], [0.0, 10.0]])
    return KnownSequence((8, 8), events, np.array([0, 1]), true)


def test_errors_and_ages_by_hand():
    sequence = sequence_by_hand()
    assert ages_us(sequence, None).tolist() == [1_000, 17_000]
    assert ages_us(sequence, 15_000).tolist() == [16_000, 17_000]
    assert comparison.mean_error(zero_flow, [sequence]) == 30.0
    nothing = np.full((2, 2), np.nan)
    errors = comparison.endpoint_errors(nothing, sequence.true)
    np.testing.assert_array_equal(errors, (50.0, 10.0))


def test_a_comparison_by_hand():
    """The plane is along x and found once, at (30, 40); the network is 6 px/s off in x there."""
    sequence = sequence_by_hand()
    answers = {
        comparison.ZERO: [np.zeros((2, 2))],
        comparison.PLANE: [np.array([[20.0, 0.0], [np.nan, np.nan]])],
        comparison.OVERLAPPING: [np.array([[36.0, 40.0], [0.0, 10.0]])],
    }
    rows = comparison.by_sequence(answers, [sequence])
    assert rows[comparison.ZERO] == {"mean": 30.0, "sd": 0.0, "better": 1}
    assert rows[comparison.OVERLAPPING] == {"mean": 3.0, "sd": 0.0, "better": 0}
    found = comparison.where_a_plane_is_found(answers, [sequence])
    assert found["share"] == 0.5
    assert found["error"] == {
        comparison.PLANE: pytest.approx(np.hypot(10, 40)),
        comparison.OVERLAPPING: 6.0,
    }
    assert found["along"] == {comparison.PLANE: 10.0, comparison.OVERLAPPING: 6.0}
    ages = comparison.by_age(answers, [sequence])
    assert list(ages) == ["0-5", "15-20"]
    assert ages["0-5"][comparison.ZERO] == 50.0
