"""Path and image of pictures that moved on known paths are recovered; noise gives no path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_scenes import SENSOR, WINDOW_US, blobs, noise, pictures, recorded, straight

from async_tnt.resynthesis import Reconstruction
from async_tnt.resynthesis.moving_image import cell_for
from async_tnt.resynthesis.paths import minimum_jerk
from async_tnt.resynthesis.pixels import MeasuredPixels
from async_tnt.simulation.simulator import PixelModel, simulate

PIXELS = MeasuredPixels()


@pytest.fixture(scope="module")
def reconstruction():
    return Reconstruction(SENSOR, WINDOW_US)


@pytest.mark.parametrize("profile", [lambda u: u, minimum_jerk, lambda u: np.clip(2 * u - 1, 0, 1)])
def test_paths_and_images_are_found(reconstruction, profile):
    """Net displacement within .8 pixels in the median; images correlate with what moved at .9 and more."""
    rng = np.random.default_rng(3)
    angle, length = rng.uniform(0, 2 * np.pi, 16), rng.uniform(4, 12, 16)
    nets = np.stack([length * np.cos(angle), length * np.sin(angle)], 1)
    scenes = [blobs(rng) for _ in nets]
    windows = [recorded(scene, straight(net, profile=profile), rng) for scene, net in zip(scenes, nets, strict=True)]
    errors, likeness = [], []
    for scene, net, (path, image) in zip(scenes, nets, reconstruction(windows, PIXELS), strict=True):
        assert not path.refused
        errors.append(np.linalg.norm(path.positions[-1] - net))
        moved = image.pictures(path.at(np.array([0.5])))[0]
        seen = pictures(scene, straight(net, profile=profile)[26:27])[0]  # half way
        likeness.append(np.corrcoef(moved.ravel(), seen.ravel())[0, 1])
    assert np.median(errors) < 0.8 and np.max(errors) < 2.5
    assert np.median(likeness) > 0.9 and np.min(likeness) > 0.7


def uniform(rng, n):
    return noise(rng, n)


def of_one_polarity(rng, n):
    t, x, y, p = noise(rng, n)
    return t, x, y, np.full_like(p, rng.integers(0, 2))


def in_pairs(rng, n):
    """Each event is followed by one of the other sign at its pixel."""
    t, x, y, _ = noise(rng, n // 2)
    return t.repeat(2), x.repeat(2), y.repeat(2), np.tile(np.array([0, 1], np.uint8), n // 2)


def at_hot_pixels(rng, n):
    t, x, y, p = noise(rng, n)
    hot, i = rng.integers(0, 34, (2, rng.integers(1, 6))), rng.random(n) < 0.7
    which = rng.integers(0, hot.shape[1], n)
    return t, np.where(i, hot[0][which], x).astype(np.uint16), np.where(i, hot[1][which], y).astype(np.uint16), p


def everywhere_at_once(rng, n):
    """The light flickers: most pixels are ON, then OFF, together."""
    t, x, y, _ = noise(rng, n)
    periods = rng.integers(3, 12)
    phase = rng.integers(0, 2 * periods, n)
    t = (phase * WINDOW_US // (2 * periods) + t % 500).astype(np.int64)
    order = np.argsort(t, kind="stable")
    return t[order], x, y, (phase[order] % 2).astype(np.uint8)


@pytest.mark.parametrize("make", [uniform, of_one_polarity, in_pairs, at_hot_pixels, everywhere_at_once])
def test_noise_has_no_path(reconstruction, make):
    """Of any number of events, from few to three for each pixel."""
    rng = np.random.default_rng(2)
    windows = [make(rng, int(np.exp(rng.uniform(np.log(50), np.log(3_000))))) for _ in range(40)]
    assert [path.refused for path, _ in reconstruction(windows, PIXELS)].count("") == 0


def side_by_side(rng, net, other):
    """Two objects on opposite sides of the middle, one of which moves by `net`, the other by `other`."""
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
    """One would be explained with the opposite contrast. Two that move together have a path: theirs."""
    rng = np.random.default_rng(3)
    angle, length = rng.uniform(0, 2 * np.pi, 40), rng.uniform(2, 6, 40)
    nets = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    apart = reconstruction([side_by_side(rng, net, -net) for net in nets], PIXELS)
    assert [path.refused for path, _ in apart].count("") <= 4
    together = list(reconstruction([side_by_side(rng, net, net) for net in nets], PIXELS))
    right = [path.positions[-1] @ net > 0 for net, (path, _) in zip(nets, together, strict=True) if not path.refused]
    assert len(right) >= 28 and all(right)


def test_few_events_are_enough(reconstruction):
    """Three of ten, on the way out and on the way back: most paths are found, and lead the right way."""
    rng = np.random.default_rng(4)
    windows, nets = [], []
    for k in range(40):
        angle, profile = rng.uniform(0, 2 * np.pi), (lambda u: u, lambda u: np.sin(np.pi * u) ** 2)[k % 2]
        nets.append(rng.uniform(4, 8) * np.array([np.cos(angle), np.sin(angle)]))
        window = recorded(blobs(rng), straight(nets[-1], profile=profile), rng)
        kept = rng.random(len(window[0])) < 0.3
        windows.append(tuple(column[kept] for column in window))
    found = [
        (path.positions.mean(0), net)
        for net, (path, _) in zip(nets, reconstruction(windows, PIXELS), strict=True)
        if not path.refused
    ]
    cosines = np.array([at @ net / np.linalg.norm(at) / np.linalg.norm(net) for at, net in found])
    assert len(found) >= 32 and (cosines > np.sqrt(0.5)).mean() >= 0.93


def flicker(rng):
    """A picture that stands still and changes its brightness."""
    strength = np.sin(np.linspace(0, 2 * np.pi * rng.uniform(0.5, 3), 53) + rng.uniform(0, 6))
    frames = pictures(blobs(rng), np.zeros((53, 2))) * strength[:, None, None]
    events = simulate(frames, np.linspace(0, WINDOW_US, 53), rng, PixelModel())
    return tuple(events[events["t"] < WINDOW_US][name].copy() for name in "txyp")


@pytest.mark.parametrize(
    ("make", "most"),
    [
        (lambda rng: noise(rng, 100), 0),
        (lambda rng: noise(rng, 3_000), 0),
        (flicker, 3),
    ],
)
def test_what_is_no_moving_picture_has_no_path(reconstruction, make, most):
    """Of twelve windows at most `most` are taken for one."""
    rng = np.random.default_rng(1)
    found = list(reconstruction([make(rng) for _ in range(12)], PIXELS))
    assert sum(not path.refused for path, _ in found) <= most
    assert all((image is None) == bool(path.refused) for path, image in found)
    assert all(np.isfinite(path.positions).all() and 0 <= path.explained <= 1 for path, _ in found)


@pytest.mark.parametrize("sensor", [(128, 96), (41, 20), (5, 3), (1, 1)])
def test_sensors_of_any_size(sensor):
    """Larger ones are averaged over cells; paths stay in pixels."""
    rng = np.random.default_rng(4)
    scale = min(sensor) / 34
    window = recorded(blobs(rng, sensor), straight((9 * scale, -5 * scale)), rng, sensor, window_us=10_000)
    reconstruction = Reconstruction(sensor, 10_000, cell_for([window], sensor))
    ((path, image),) = reconstruction([window], PIXELS)
    if min(sensor) >= 20:
        assert not path.refused and np.linalg.norm(path.positions[-1] - (9 * scale, -5 * scale)) < 2 * scale
        assert image.pictures(path.at(np.array([0.5]))).shape == (1, sensor[1], sensor[0])
    assert np.isfinite(path.positions).all()


@given(st.integers(0, 2**32 - 1), st.integers(0, 400), st.sampled_from([1, 10, 1_000]))
@settings(max_examples=25, deadline=None)
def test_any_events_are_accepted(seed, n, window_us):
    rng = np.random.default_rng(seed)
    t, x, y, p = noise(rng, n, (7, 5), window_us)
    if n and seed % 2:
        x[:], y[:] = x[0], y[0]  # one pixel that fires all the time
    ((path, _),) = Reconstruction((7, 5), window_us)([(t, x, y, p)], PIXELS)
    assert path.n_events == n and np.isfinite(path.positions).all()
