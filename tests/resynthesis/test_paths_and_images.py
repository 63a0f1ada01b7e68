"""Path and image of pictures that moved on known paths are recovered; noise gives no path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_scenes import SENSOR, WINDOW_US, blobs, noise, pictures, recorded, straight, together

from async_tnt.resynthesis.moving_image import N_FRAMES, cell_for
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.reconstruction import Reconstruction, SimulatedPixels
from async_tnt.simulation.measured_pixels import MeasuredPixels, part_of
from async_tnt.simulation.random_motion import minimum_jerk
from async_tnt.simulation.simulator import PixelModel, simulate
from experiments.found_paths import NOISE, noise_windows

PIXELS = MeasuredPixels()


@pytest.fixture(scope="module")
def reconstruction():
    return Reconstruction(SENSOR, WINDOW_US)


def n_paths(found):
    """How many windows have a path that is not refused."""
    return sum(not path.refused for path, _ in found)


@pytest.mark.parametrize("profile", [lambda u: u, minimum_jerk, lambda u: np.clip(2 * u - 1, 0, 1)])
def test_paths_and_images_are_found(reconstruction, profile):
    """The net displacement is within .8 pixels in the median.

    The images' correlation with what moved is .9 or more.
    """
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, 2 * np.pi, 16)
    length = rng.uniform(4, 12, 16)
    nets = np.stack([length * np.cos(angle), length * np.sin(angle)], 1)
    scenes = [blobs(rng) for _ in nets]
    windows = [
        recorded(scene, straight(net, profile=profile), rng)
        for scene, net in zip(scenes, nets, strict=True)
    ]
    errors = []
    likeness = []
    found = reconstruction(windows, PIXELS)
    for scene, net, (path, image) in zip(scenes, nets, found, strict=True):
        assert not path.refused
        errors.append(np.linalg.norm(path.positions[-1] - net))
        moved = image.picture.frames(path.at(np.array([0.5])))[0]
        seen = pictures(scene, straight(net, profile=profile)[26:27])[0]  # half way
        likeness.append(np.corrcoef(moved.ravel(), seen.ravel())[0, 1])
    assert np.median(errors) < 0.8 and np.max(errors) < 2.5
    assert np.median(likeness) > 0.9 and np.min(likeness) > 0.7


def test_neighbours_tell_what_a_window_does_not():
    """A third of a slow motion has too few events.

    With the events before and after, its own part of the path is found, and its image where it
    is halfway through the window.
    """
    rng = np.random.default_rng(5)
    third = WINDOW_US // 3
    net = np.array([6.0, 0.0])
    scenes = [blobs(rng) for _ in range(16)]
    whole = [recorded(scene, straight(net), rng) for scene in scenes]
    wide = []
    for t, *rest in whole:
        kept = rng.random(len(t)) < 0.3
        wide.append((t[kept] - third, *[column[kept] for column in rest]))
    thirds = Reconstruction(SENSOR, third)
    alone = list(thirds([part_of(window, third) for window in wide], PIXELS))
    found = list(thirds(wide, PIXELS))
    assert n_paths(alone) < 4
    assert n_paths(found) > 10
    for scene, (path, image) in zip(scenes, found, strict=True):
        if path.span == 3 and not path.refused:
            np.testing.assert_allclose(path.at(np.array([1.0]))[0], net / 3, atol=1.5)
            moved = image.picture.frames(path.window_start + path.at(np.array([0.5])))[0]
            seen = pictures(scene, [net / 2])[0]
            assert np.corrcoef(moved.ravel(), seen.ravel())[0, 1] > 0.6
            assert image.as_recorded(SimulatedPixels(PIXELS), rng)["t"].max() < third


def test_where_neighbours_do_not_help_the_windows_own_reason_is_told():
    """Few events between two windows of noise, which would be refused as noise."""
    rng = np.random.default_rng(3)
    parts = (-WINDOW_US, 2000), (0, 20), (WINDOW_US, 2000)
    times = [np.sort(rng.integers(first_us, first_us + WINDOW_US, n)) for first_us, n in parts]
    t = np.concatenate(times)
    x = rng.integers(0, SENSOR[0], len(t)).astype(np.uint16)
    y = rng.integers(0, SENSOR[1], len(t)).astype(np.uint16)
    p = rng.integers(0, 2, len(t)).astype(np.uint8)
    window = t, x, y, p
    ((path, image),) = Reconstruction(SENSOR, WINDOW_US)([window], PIXELS)
    assert (path.refused, path.n_events, path.span, image) == ("few events", 20, 1, None)


STEPS = np.stack([np.arange(1.0, N_FRAMES + 1), np.zeros(N_FRAMES)], 1)
"""A pixel to the right in each part of a window."""


@pytest.mark.parametrize("span", [1, 3])
def test_a_windows_part_of_a_path_begins_at_0(span):
    """The middle one of three windows has a third of the way.

    The first third lies before it.
    """
    path = MotionPath(STEPS, span=span)
    at = path.at(np.array([0, 0.5, 1]))
    np.testing.assert_allclose(at, [(share * N_FRAMES / span, 0) for share in (0, 0.5, 1)])
    np.testing.assert_allclose(path.window_start, (N_FRAMES * (span - 1) / 2 / span, 0))
    assert path.length == pytest.approx(N_FRAMES / span)


@pytest.mark.parametrize(
    ("measured", "reason"),
    [
        ({}, ""),
        # no less than enough
        ({"n_events": 50, "margin": 6.0, "agreement": 0.0, "explained": 0.0}, ""),
        ({"n_events": 49}, "few events"),
        ({"positions": 0.005 * STEPS}, "no motion"),
        ({"margin": 5.99}, "ambiguous direction"),
        ({"agreement": -0.01}, "several objects"),
        # few events need explain little: their square
        ({"events_a_cell": 0.5, "explained": 0.25}, ""),
        ({"events_a_cell": 0.5, "explained": 0.24}, "noise"),
        ({"events_a_cell": 7.0, "explained": 0.5}, ""),  # and many at most half
        ({"events_a_cell": 7.0, "explained": 0.49}, "noise"),
    ],
)
def test_why_a_path_is_refused_by_hand(measured, reason):
    assert MotionPath(**{"positions": STEPS} | measured).refused == reason


@pytest.mark.parametrize("kind", NOISE)
def test_noise_has_no_path(reconstruction, kind):
    """Few events have no path, and neither have three for each pixel."""
    rng = np.random.default_rng(2)
    windows = noise_windows(kind, 40, rng)
    assert n_paths(reconstruction(windows, PIXELS)) == 0


def side_by_side(rng, net, other):
    """Two objects on opposite sides of the middle.

    One of them moves by `net`, the other one by `other`.
    """
    angle = rng.uniform(0, np.pi)
    beside = 9 * np.array([np.cos(angle), np.sin(angle)])
    scenes = [blobs(rng, n=2, spread=3.0) for _ in range(2)]
    paths = straight(net), straight(other)
    light = sum(
        pictures(lambda x, y, s=scene, at=at: s(x - at[0], y - at[1]), path)
        for scene, at, path in zip(scenes, (beside, -beside), paths, strict=True)
    )
    events = simulate(light, np.linspace(0, WINDOW_US, 53), rng, PixelModel())
    return tuple(events[events["t"] < WINDOW_US][name].copy() for name in "txyp")


def test_two_objects_that_move_oppositely_have_no_path(reconstruction):
    """One would be explained with the opposite contrast.

    Two that move together have a path: theirs.
    """
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, 2 * np.pi, 40)
    length = rng.uniform(2, 6, 40)
    nets = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    apart = reconstruction([side_by_side(rng, net, -net) for net in nets], PIXELS)
    assert n_paths(apart) <= 4
    together = list(reconstruction([side_by_side(rng, net, net) for net in nets], PIXELS))
    right = [
        path.positions[-1] @ net > 0
        for net, (path, _) in zip(nets, together, strict=True)
        if not path.refused
    ]
    assert len(right) >= 28 and all(right)


def test_few_events_are_enough(reconstruction):
    """Three of ten windows, on the way out and on the way back.

    Most paths are found, and lead the right way.
    """
    rng = np.random.default_rng(4)
    profiles = (lambda u: u, lambda u: np.sin(np.pi * u) ** 2)
    windows = []
    nets = []
    for k in range(40):
        profile = profiles[k % 2]
        angle = rng.uniform(0, 2 * np.pi)
        nets.append(rng.uniform(4, 8) * np.array([np.cos(angle), np.sin(angle)]))
        window = recorded(blobs(rng), straight(nets[-1], profile=profile), rng)
        kept = rng.random(len(window[0])) < 0.3
        windows.append(tuple(column[kept] for column in window))
    cosines = []
    for net, (path, _) in zip(nets, reconstruction(windows, PIXELS), strict=True):
        if not path.refused:
            mean = path.positions.mean(0)
            cosines.append(mean @ net / np.linalg.norm(mean) / np.linalg.norm(net))
    assert len(cosines) >= 32 and np.mean(np.array(cosines) > np.sqrt(0.5)) >= 0.93


def flicker(rng):
    """A picture that stands still and changes its brightness."""
    strength = np.sin(np.linspace(0, 2 * np.pi * rng.uniform(0.5, 3), 53) + rng.uniform(0, 6))
    frames = pictures(blobs(rng), np.zeros((53, 2))) * strength[:, None, None]
    events = simulate(frames, np.linspace(0, WINDOW_US, 53), rng, PixelModel())
    return tuple(events[events["t"] < WINDOW_US][name].copy() for name in "txyp")


def test_a_picture_that_stands_still_has_no_path(reconstruction):
    """At most three of twelve windows are taken for a moving picture."""
    rng = np.random.default_rng(1)
    found = list(reconstruction([flicker(rng) for _ in range(12)], PIXELS))
    assert n_paths(found) <= 3
    assert all((image is None) == bool(path.refused) for path, image in found)
    assert all(np.isfinite(path.positions).all() and 0 <= path.explained <= 1 for path, _ in found)


@pytest.mark.parametrize(
    ("sensor", "reach", "cell"),
    [
        # a sixteenth of what moves, but at most 80 cells and at least 40 along the sensor
        ((400, 300), (100, 20), 6),
        ((400, 300), (20, 100), 6),
        ((400, 300), (20, 20), 5),
        ((400, 300), (250, 20), 10),
        ((401, 300), (20, 20), 6),
        ((80, 60), (40, 40), 2),
        ((80, 60), (20, 20), 1),
        ((34, 34), (34, 34), 1),
    ],
)
def test_cells_by_hand(sensor, reach, cell):
    """Some events far away do not count."""
    middle = np.linspace(-0.5, 0.5, 71)[:, None] * reach
    corners = np.repeat([[0, 0], sensor], 14, axis=0)
    x, y = np.concatenate([middle + np.array(sensor) / 2, corners]).T
    window = np.arange(len(x)), x, y, np.ones(len(x))
    nothing = tuple(column[:0] for column in window)
    assert cell_for([window, nothing, window], sensor) == cell
    assert cell_for([nothing], sensor) == -(-max(sensor) // 80)


def test_after_pulses_tell_nothing_of_the_image():
    rng = np.random.default_rng(0)
    t, x, y, p = noise(rng, 40)
    # far apart, each with an after-pulse
    t = 2_500 * np.arange(40)
    window = t, x, y, p
    pulsed = together(window, (t + 500, x, y, 1 - p))
    model = Reconstruction(SENSOR, WINDOW_US).model
    expected = model.frames([window], PIXELS)
    assert expected.any()
    np.testing.assert_array_equal(model.frames([pulsed], PIXELS), expected)


@pytest.mark.parametrize("sensor", [(128, 96), (41, 20), (5, 3), (1, 1)])
def test_sensors_of_any_size(sensor):
    """Larger ones are averaged over cells; paths stay in pixels."""
    rng = np.random.default_rng(4)
    scale = min(sensor) / 34
    net = np.array((9 * scale, -5 * scale))
    window = recorded(blobs(rng, sensor), straight(net), rng, sensor, window_us=10_000)
    reconstruction = Reconstruction(sensor, 10_000, cell_for([window], sensor))
    ((path, image),) = reconstruction([window], PIXELS)
    if min(sensor) >= 20:
        assert not path.refused
        assert np.linalg.norm(path.positions[-1] - net) < 2 * scale
        assert image.picture.frames(path.at(np.array([0.5]))).shape == (1, sensor[1], sensor[0])
    assert np.isfinite(path.positions).all()


@given(st.integers(0, 2**32 - 1), st.integers(0, 400), st.sampled_from([1, 10, 1_000]))
@settings(max_examples=25, deadline=None)
def test_any_events_are_accepted(seed, n, window_us):
    rng = np.random.default_rng(seed)
    t, x, y, p = noise(rng, n, (7, 5), window_us)
    if n and seed % 2:
        # one pixel that fires all the time
        x[:] = x[0]
        y[:] = y[0]
    ((path, _),) = Reconstruction((7, 5), window_us)([(t, x, y, p)], PIXELS)
    assert path.n_events == n and np.isfinite(path.positions).all()
