"""Path and image of pictures that moved on known paths are recovered; noise gives no path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_scenes import SENSOR, WINDOW_US, blobs, noise, pictures, recorded, straight, together

from async_tnt.resynthesis import paths as paths_module
from async_tnt.resynthesis import reconstruction as reconstruction_module
from async_tnt.resynthesis.moving_image import N_FRAMES, MovingImage, cell_for
from async_tnt.resynthesis.paths import MotionPath, PathFinder
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
    # the image is also found if its path is known
    k = next(k for k, (path, _) in enumerate(found) if path.span == 3 and not path.refused)
    again = thirds.image(wide[k], PIXELS, found[k][0])
    np.testing.assert_allclose(again.picture.image, found[k][1].picture.image, atol=1e-9)


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


def test_windows_are_processed_in_batches(reconstruction, monkeypatch):
    """A window without events of its neighbours is searched once, alone."""
    rng = np.random.default_rng(1)
    windows = [recorded(blobs(rng), straight(net), rng) for net in ((6, 0), (0, 5), (-4, 4))]
    windows.insert(1, noise(rng, 20))
    expected = list(reconstruction(windows, PIXELS))
    spans = []
    frames = MovingImage.frames

    def noting(self, given, pixels, span=1):
        spans.append((len(given), span))
        return frames(self, given, pixels, span)

    monkeypatch.setattr(MovingImage, "frames", noting)
    monkeypatch.setattr(reconstruction_module, "BATCH", 3)
    found = list(reconstruction(windows, PIXELS))
    assert spans == [(3, 1), (1, 1)]
    for (path, _), (expected_path, _) in zip(found, expected, strict=True):
        np.testing.assert_allclose(path.positions, expected_path.positions, atol=1e-9)
        assert (path.refused, path.n_events) == (expected_path.refused, expected_path.n_events)


def test_halves_of_a_picture_are_left_right_above_and_below_the_middle_of_its_events():
    """Here of 24 x 10 pixels in cells of two pixels."""
    rng = np.random.default_rng(0)
    window = noise(rng, 60, (24, 10))
    reconstruction = Reconstruction((24, 10), WINDOW_US, cell=2)
    model = reconstruction.model

    def band_of(*windows):
        return model.band_of(model.spectra(model.frames(windows, PIXELS)))

    nothing = tuple(column[:0] for column in window)
    band = band_of(window, nothing)
    frames = model.frames([window, nothing], PIXELS)
    halves = reconstruction._halves([window, nothing], frames, band)
    for k, places in enumerate(window[1:3]):
        is_first = places // 2 < int(np.median(places)) // 2
        assert 15 < is_first.sum() < 45
        for half, is_in in ((2 * k, is_first), (2 * k + 1, ~is_first)):
            (expected,) = band_of(tuple(column[is_in] for column in window))
            np.testing.assert_allclose(halves[0, half], expected, atol=1e-9)
    assert np.abs(halves[1]).max() < 1e-9


def made_band(n, seed=0):
    """A model of 12 x 9 pixels, its path finder, and the spectra of n random windows."""
    model = MovingImage((12, 9), WINDOW_US)
    frames = np.cumsum(np.random.default_rng(seed).normal(0, 0.7, (n, N_FRAMES, 9, 12)), axis=1)
    return model, PathFinder(model), model.band_of(model.spectra(frames))


def test_scores_are_the_evidence_of_the_dictionarys_paths():
    model, finder, band = made_band(2)
    scores = finder.scores(band)
    assert scores.shape == (2, len(finder.dictionary))
    for n in range(2):
        for d in range(0, len(finder.dictionary), 97):
            expected, _, _ = model.evidence(band[n : n + 1], finder.dictionary[d])
            assert scores[n, d] == pytest.approx(expected, rel=1e-4, abs=1e-3)


def test_a_margin_is_that_over_paths_that_lead_the_other_way():
    """A perpendicular path does not lead the other way, however its numbers are rounded."""
    _, finder, _ = made_band(1)
    ways = finder.dictionary.mean(axis=1)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for best in range(0, len(ways), 41):
        along = ways @ ways[best]
        scores = np.where(along < -0.1, 2.0, np.where(np.abs(along) < 1e-6, 9.0, 8.0))
        scores[best] = 10.0
        scores[along.argmin()] = 7.0
        assert finder._margin(scores) == 3


def test_a_step_of_the_search_is_at_most_one_cell(monkeypatch):
    monkeypatch.setattr(paths_module, "MOST_STEPS", 1)
    model, finder, _ = made_band(1)
    y, x = np.mgrid[:9, :12]
    scene = np.exp(-((x - 5.5) ** 2 + (y - 4) ** 2) / 8)
    moved = [np.roll(scene, k // 3, axis=1) - scene for k in range(1, N_FRAMES + 1)]
    band = model.band_of(model.spectra(20 * np.array([moved])))
    first = 0.3 * np.stack([np.arange(1.0, N_FRAMES + 1), np.zeros(N_FRAMES)], axis=1) / N_FRAMES
    path, _ = finder.refine(band, first)
    assert np.abs(path - first).max() == pytest.approx(1)


def test_each_step_of_the_search_gains_evidence_beyond_what_the_prior_subtracts(monkeypatch):
    """From paths far from the likeliest one. The evidence is returned without the prior."""
    for seed in range(6):
        model, finder, band = made_band(1, seed)
        rng = np.random.default_rng(seed)
        first = finder.dictionary[rng.integers(len(finder.dictionary))] + rng.normal(size=(1, 2))
        reached = [model.evidence(band, first)[0] - finder._bending(first)]
        for n_steps in range(1, 7):
            monkeypatch.setattr(paths_module, "MOST_STEPS", n_steps)
            path, evidence = finder.refine(band, first)
            assert evidence == pytest.approx(model.evidence(band, path)[0])
            reached.append(evidence - finder._bending(path))
        assert (np.diff(reached) > -1e-9).all() and reached[-1] > reached[0]


def test_the_explained_share_is_what_the_likeliest_image_leaves_less():
    """Over all frequencies of the band, positive and negative ones."""
    model, _, band = made_band(1)
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, 0.3, (N_FRAMES, 2)), axis=0)
    frames = np.cumsum(np.random.default_rng(0).normal(0, 0.7, (N_FRAMES, 9, 12)), axis=0)
    spectra = np.moveaxis(np.fft.fft2(frames, model.shape, norm="ortho"), 0, -1)
    left = 0.0
    power = 0.0
    for i, qy in enumerate(2 * np.pi * np.fft.fftfreq(model.shape[0])):
        for j, qx in enumerate(2 * np.pi * np.fft.fftfreq(model.shape[1])):
            if max(abs(qx), abs(qy)) <= np.pi / 2:
                signal = model.whitening @ spectra[i, j]
                motion = model.whitening @ (np.exp(-1j * path @ (qx, qy)) - 1)
                prior = 16 * (4 - 2 * np.cos(qx) - 2 * np.cos(qy) + 1 / 16)
                image = (motion.conj() @ signal) / ((np.abs(motion) ** 2).sum() + prior)
                left += (np.abs(signal - motion * image) ** 2).sum()
                power += (np.abs(signal) ** 2).sum()
    assert model.explained(band[0], path) == pytest.approx(1 - left / power)


def test_curvature_is_that_of_the_squared_errors_for_fixed_images():
    """In the Gauss-Newton approximation: J^T J of the whitened errors, by hand."""
    model, _, band = made_band(2)
    path = np.cumsum(np.random.default_rng(3).normal(0, 0.3, (N_FRAMES, 2)), axis=0)
    _, _, curvature = model.evidence(band, path)
    qx, qy = model.band_frequencies
    q = np.array([(x, y) for y in qy for x in qx])
    weights = np.tile(model.band_weights, len(qy))
    phases = np.exp(-1j * q @ path.T)
    white = (phases - 1) @ model.whitening.T
    expected = np.zeros((2 * N_FRAMES, 2 * N_FRAMES))
    for spectrum in band:
        image = (white.conj() * spectrum).sum(axis=1)
        image /= (np.abs(white) ** 2).sum(axis=1) + model.band_prior
        # errors by the points and axes of the path: (F, K, K, 2)
        change = -1j * image[:, None, None] * phases[:, :, None] * q[:, None]
        slopes = (model.whitening[:, :, None] * change[:, None]).reshape(len(q), N_FRAMES, -1)
        expected += np.einsum("f,fka,fkb->ab", weights, slopes.conj(), slopes).real
    np.testing.assert_allclose(curvature, expected, atol=1e-9 * np.abs(expected).max())


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
    assert path.events_a_cell == n / 35
