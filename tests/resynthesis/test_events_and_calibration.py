"""Pixels are measured, contrast is calibrated, and events of other motions are made.

These events are what the picture would have given.
"""

import numpy as np
import pytest
from moving_scenes import SENSOR, WINDOW_US, blobs, noise, recorded, straight, together

from async_tnt.resynthesis import calibration as calibration_module
from async_tnt.resynthesis.calibration import (
    _scale_thresholds,
    calibrate,
    describe,
    differing_numbers,
    side_by_side,
)
from async_tnt.resynthesis.moving_image import N_FRAMES
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.reconstruction import MovedImage, Reconstruction, SimulatedPixels
from async_tnt.simulation.measured_pixels import MeasuredPixels, is_after_pulse, measure_pixels
from async_tnt.simulation.periodic_image import PeriodicImage
from async_tnt.simulation.random_motion import random_motion
from async_tnt.simulation.simulator import PixelModel
from async_tnt.volume.events import EVENT_DTYPE

SHARES = np.linspace(0, 1, 52)


def windows_of(rng, pixels, n=24):
    length = rng.uniform(3, 9, n)
    angle = rng.uniform(0, 6.3, n)
    nets = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    return [recorded(blobs(rng), straight(net), rng, pixels=pixels) for net in nets]


@pytest.mark.parametrize("ratio", [0.7, 1.4])
def test_pixels_are_measured(ratio):
    """Measured pixels are near those that were simulated.

    ON against OFF is within 20 %, as refractory times hide more events of the lower threshold.
    Noise is within 30 %. The refractory time is below the measured bound.
    """
    pixels = PixelModel(0.2 * ratio**0.5, 0.2 / ratio**0.5, 0.1, 800.0, 0.5, 0.8)
    measured = measure_pixels(windows_of(np.random.default_rng(0), pixels), SENSOR, WINDOW_US)
    assert measured.step_on / measured.step_off == pytest.approx(ratio, rel=0.2)
    assert measured.step_on * measured.step_off == pytest.approx(1)
    assert measured.noise_hz == pytest.approx(0.5, rel=0.3)
    assert measured.noise_on_share == pytest.approx(0.8, abs=0.1)
    assert 800 <= measured.refractory_us < 4_000


def test_after_pulses_by_hand():
    """Within a millisecond, of the other sign, and at the same pixel."""
    rows = [
        (0, 3, 4, 1),
        (1_000, 3, 4, 0),
        (2_001, 3, 4, 1),
        (2_002, 3, 4, 1),
        (2_003, 4, 4, 0),
        (2_003, 3, 5, 0),
    ]
    t, x, y, p = np.array([*rows, (2_900, 3, 4, 0)]).T
    assert is_after_pulse((t, x, y, p)).tolist() == [False, True, False, False, False, False, True]


def columns(*rows):
    """Rows (t, x, y, p) as columns."""
    t, x, y, p = np.array(rows).T
    return t, x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8)


@pytest.mark.parametrize("n_windows", [1, 3])
def test_noise_after_pulses_and_intervals_by_hand(n_windows):
    """Two pixels of 9 x 5, each with eight silent neighbours: 29 pixels are quiet.

    An after-pulse belongs to neither. Intervals are between events of one sign: 3 ms.
    """
    first = (0, 1, 1, 1), (3_000, 1, 1, 1), (10_000, 1, 1, 0)
    second = (100, 7, 3, 0), (600, 7, 3, 1)  # the latter is an after-pulse
    window = columns(*sorted([*first, *second]))
    measured = measure_pixels([window] * n_windows, (9, 5), 20_000)
    assert measured.after_share == pytest.approx(1 / 4)
    assert measured.noise_hz == pytest.approx(-np.log(1 - 2 / 29) / 0.020)
    assert measured.noise_on_share == pytest.approx((2 / 3 + 0) / 2)
    assert measured.refractory_us == 3_000
    assert (measured.step_on, measured.step_off) == (1, 1)


@pytest.mark.parametrize(("n_on", "step_on"), [(100, 0.3**0.5), (10_000, 0.5)])
def test_a_ratio_of_thresholds_is_not_beyond_chance_nor_beyond_belief(n_on, step_on):
    """All events are ON. Of 100, there might have been 30 OFF events; and a ratio above 4 is not
    believed. No pixel is quiet, so that nothing is known of the noise."""
    rows = [(5 * k, k % 2, 0, 1) for k in range(n_on)]
    measured = measure_pixels([columns(*rows)], (2, 1), 100_000)
    assert measured.step_on == pytest.approx(step_on)
    assert measured.step_off == pytest.approx(1 / step_on)
    assert (measured.noise_hz, measured.noise_on_share) == (0, 0.5)


def test_a_sensor_whose_every_pixel_is_active_has_finite_noise():
    """At most 99 % of the pixels count as active."""
    measured = measure_pixels([columns((5, 0, 0, 1))], (1, 1), 1_000_000)
    assert measured.noise_hz == pytest.approx(np.log(100))
    assert measured.refractory_us == 0


def test_simulated_pixels_are_like_the_measured_ones():
    """Thresholds and refractory time vary about the measured ones from window to window."""
    measured = MeasuredPixels(
        1.25, 0.8, refractory_us=900.0, noise_hz=0.7, noise_on_share=0.3, after_share=0.2
    )
    rng = np.random.default_rng(0)
    drawn = [SimulatedPixels(measured, scale=0.3).draw(rng) for _ in range(500)]
    same = {(one.noise_hz, one.noise_on_share, one.after_share) for one in drawn}
    assert same == {(0.7, 0.3, 0.2)}
    on = np.array([one.threshold_on for one in drawn])
    off = np.array([one.threshold_off for one in drawn])
    refractory_us = np.array([one.refractory_us for one in drawn])
    np.testing.assert_allclose(on / off, 1.25 / 0.8)
    assert np.median(on) == pytest.approx(0.3 * 1.25, rel=0.03)
    assert np.log(on).std() == pytest.approx(0.1, rel=0.15)
    assert np.mean(refractory_us) == pytest.approx(900, rel=0.05)
    assert 540 <= refractory_us.min() < 600 and 1_200 < refractory_us.max() <= 1_260


def test_numbers_of_windows_by_hand():
    """Pixel (1, 1) has events at 0, 2 and 6 ms, and pixel (5, 0) has one.

    In the next window pixel (1, 1) has two events, 8 ms apart. The last window has none.
    """
    first = [(0, 1, 1, 1), (2_000, 1, 1, 1), (3_000, 5, 0, 0), (6_000, 1, 1, 0)]
    second = [(0, 1, 1, 0), (8_000, 1, 1, 1)]
    windows = [np.array(rows, EVENT_DTYPE) for rows in (first, second, [])]
    expected = {
        "events per window": 6 / 3,
        "active pixels": 100 * (2 + 1 + 0) / 3 / 100,
        "events per active pixel": 6 / 3,
        "same-pixel interval, 5 %": 2.2,  # of 2, 4 and 8 ms
        "same-pixel interval, median": 4.0,
        "ON share": 100 * 3 / 6,
    }
    assert describe(windows, (25, 4)) == pytest.approx(expected)
    assert all(np.isnan(value) for value in describe([], (10, 10)).values())  # without a warning


@pytest.fixture(scope="module")
def calibrated():
    windows = windows_of(np.random.default_rng(1), PixelModel(), 32)
    reconstruction = Reconstruction(SENSOR, WINDOW_US)
    return windows, reconstruction, calibrate(reconstruction, windows, seed=0)


def test_the_recorded_motion_is_matched(calibrated):
    """Events within 2 %, active pixels within 15 %, intervals within 20 %."""
    _, _, calibration = calibrated
    bounds = {
        "events per window": 0.02,
        "active pixels": 0.15,
        "same-pixel interval, 5 %": 0.2,
        "same-pixel interval, median": 0.2,
    }
    for name, within in bounds.items():
        expected = calibration.match["recorded"][name]
        assert calibration.match["resynthesized"][name] == pytest.approx(expected, rel=within), name
    assert 3 < calibration.length < 9


def test_nothing_that_moves_is_an_error():
    """It tells the reasons, the most frequent one first."""
    rng = np.random.default_rng(0)
    windows = [noise(rng, 20), *[noise(rng, 500)] * 3]
    message = r"no motion was found in any of 4 windows \(ambiguous direction 3, few events 1\): "
    with pytest.raises(ValueError, match=message):
        calibrate(Reconstruction(SENSOR, WINDOW_US), windows, seed=0)


def test_thresholds_are_scaled_until_there_are_as_many_events():
    """By draws that the seed alone decides, others for each image."""

    class Image:
        """It has 1,000 events at the scale 1."""

        def __init__(self):
            self.drawn = set()

        def as_recorded(self, distribution, rng):
            self.drawn.add(rng.random())
            return np.zeros(round(1_000 / distribution.scale), EVENT_DTYPE)

    drawn = []
    for seed in (0, 1):
        images = [Image(), Image()]
        pixels, events = _scale_thresholds(SimulatedPixels(MeasuredPixels()), images, 500, seed)
        assert pixels.scale == pytest.approx(4, rel=0.005)
        assert [len(one) for one in events] == pytest.approx([250, 250], abs=2)
        drawn += [image.drawn for image in images]
    assert [len(numbers) for numbers in drawn] == [1] * 4
    assert len(set.union(*drawn)) == 4


def test_thresholds_that_are_too_high_for_any_event_are_lowered():
    class Image:
        def as_recorded(self, distribution, rng):
            n = round(10 / distribution.scale) if distribution.scale < 0.5 else 0
            return np.zeros(n, EVENT_DTYPE)

    pixels, events = _scale_thresholds(SimulatedPixels(MeasuredPixels()), [Image()], 100, 0)
    assert pixels.scale == pytest.approx(0.1) and len(events[0]) == 100


def test_the_refractory_time_whose_intervals_are_most_alike_is_chosen(monkeypatch):
    """Longer and shorter intervals count alike, by their ratio. The paths' median length is kept.
    Events of the neighbouring windows, if any, have no effect where a window tells its path."""
    rng = np.random.default_rng(5)
    nets = [(4.0, 0.0), (0.0, 5.0), (9.0, 0.0)]
    windows = [recorded(blobs(rng), straight(net), rng) for net in nets]
    ratios = {0.0: 0.25, 0.25: 0.75, 0.5: 1.25, 0.75: 3.0}

    def as_if_scaled(pixels, images, n_events, seed):
        return pixels, [pixels]

    def described(of_windows, sensor):
        numbers = describe(recorded_events, sensor)
        if not isinstance(of_windows[0], SimulatedPixels):
            recorded_events[:] = of_windows
            return describe(of_windows, sensor)
        share = of_windows[0].measured.refractory_us / measured.refractory_us
        ratio = ratios[round(share, 2)]
        return {name: number * ratio for name, number in numbers.items()}

    recorded_events = []
    monkeypatch.setattr(calibration_module, "_scale_thresholds", as_if_scaled)
    monkeypatch.setattr(calibration_module, "describe", described)
    measured = measure_pixels(windows, SENSOR, WINDOW_US)
    reconstruction = Reconstruction(SENSOR, WINDOW_US)
    t, x, y, p = noise(rng, 50)
    earlier_and_later = [(t - WINDOW_US, x, y, p), (t + WINDOW_US, x, y, p)]
    wider = [together(window, *earlier_and_later) for window in windows]
    lengths = [path.length for path, _ in reconstruction(windows, measured)]
    for given in (windows, wider):
        found = calibrate(reconstruction, given, seed=0)
        assert found.pixels.measured.refractory_us == pytest.approx(0.5 * measured.refractory_us)
        assert found.pixels.measured.step_on == measured.step_on
        assert found.length == pytest.approx(np.median(lengths))
        assert sum(map(len, recorded_events)) == sum(len(window[0]) for window in windows)
        for name, number in found.match["recorded"].items():
            assert found.match["resynthesized"][name] == pytest.approx(1.25 * number)


def test_a_table_of_descriptions_by_hand():
    """Units stand beside names; a missing number is a dash."""
    recorded = {"events per window": 1234.567, "same-pixel interval, 5 %": 1.0}
    name = "a long name of what is only in one of them"
    other = {"same-pixel interval, 5 %": 2.347, name: 3.0}
    lines = side_by_side({"recorded": recorded, "again": other}).splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["events", "per", "window", "1234.57", "-"],
        ["same-pixel", "interval,", "5", "%", "[ms]", "1.00", "2.35"],
        [*name.split(), "-", "3.00"],
    ]
    assert {len(line) for line in lines} == {len(name) + 2 * (len("recorded") + 3)}
    assert lines[0].split() == ["recorded", "again"]
    assert side_by_side({}) == " " * 36


def test_numbers_that_differ_by_a_third_are_unlike():
    """Either way. Intervals below a microsecond are alike."""
    recorded = {"a": 4.0, "b": 4.0, "c": 3.0, "d": 3.0, "e": 0.0, "f": 0.0}
    found = {"a": 3.0, "b": 3.01, "c": 4.0, "d": 3.99, "e": 1e-3, "f": 2e-3}
    assert differing_numbers({"recorded": recorded, "resynthesized": found}) == ["a", "c", "f"]
    assert differing_numbers({"recorded": found, "resynthesized": recorded}) == ["a", "c", "f"]


def test_other_motions_are_half_to_double_as_long_and_nearer_to_the_middle(monkeypatch):
    """The object's centre, 12 pixels beside the sensor's, comes up to there, and 3 pixels beside
    the way."""
    model = Reconstruction(SENSOR, WINDOW_US).model
    y, x = np.mgrid[: model.shape[0], : model.shape[1]]
    centre = np.array([28.5, 16.5])
    spot = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 18)
    image = MovedImage(model, spot, MotionPath(np.zeros((N_FRAMES, 2))))
    displacements = []
    monkeypatch.setattr(
        MovedImage, "events", lambda self, displacement, *_: displacements.append(displacement)
    )
    rng = np.random.default_rng(0)
    motions = []
    for _ in range(500):
        _, motion = image.moved(6.0, SimulatedPixels(MeasuredPixels()), rng)
        np.testing.assert_allclose(motion, displacements[-1] - displacements[-1][0], atol=1e-9)
        motions.append(motion)
    lengths = np.array([np.hypot(*motion[-1]) for motion in motions])
    assert 3 <= lengths.min() < 3.2
    assert 11 < lengths.max() < 12 * np.hypot(1, 0.4)
    at_half_time = centre + np.array([shown[25:27].mean(0) for shown in displacements])
    assert 13.5 - 0.2 < at_half_time[:, 0].min() < 15
    assert 30 < at_half_time[:, 0].max() < 31.5 + 0.2
    assert np.abs(at_half_time[:, 1] - 16.5).max() == pytest.approx(3, abs=0.2)


@pytest.mark.parametrize("span", [1, 3])
def test_the_recorded_motion_is_that_of_the_window_alone(monkeypatch, span):
    """It begins where the image is at the window's start, and turns nowhere."""
    model = Reconstruction(SENSOR, WINDOW_US).model
    steps = np.stack([np.arange(1.0, N_FRAMES + 1), np.zeros(N_FRAMES)], axis=1)
    path = MotionPath(steps, span=span)
    seen = []
    monkeypatch.setattr(MovedImage, "events", lambda self, *given: seen.append(given))
    pixels = SimulatedPixels(MeasuredPixels())
    image = MovedImage(model, np.random.default_rng(0).normal(size=model.shape), path)
    image.as_recorded(pixels, np.random.default_rng(0))
    ((displacement, turn, given_pixels, _),) = seen
    first = N_FRAMES * (span - 1) / 2 / span
    np.testing.assert_allclose(displacement[:, 0], first + N_FRAMES / span * SHARES)
    assert not displacement[:, 1].any() and not turn.any() and given_pixels is pixels


def test_an_image_is_before_the_sensor_wherever_it_was_on_the_torus():
    """Its equivalent place that is nearest to the sensor's middle."""
    model = Reconstruction(SENSOR, WINDOW_US).model
    rows, columns = model.shape
    y, x = np.mgrid[:rows, :columns]
    spot = np.exp(-((x - 16) ** 2 + (y - 17) ** 2) / 18)
    still = MotionPath(np.zeros((N_FRAMES, 2)))
    for column in (0, 30, -16):  # the last one is 4 columns before the torus' end
        image = MovedImage(model, np.roll(spot, column, axis=1), still)
        expected = (16 + column - 16.5 + columns / 2) % columns + 16.5 - columns / 2
        assert image.picture.centre == pytest.approx([expected, 17], abs=0.05)


def centroid(events):
    return np.array([events["x"].mean(), events["y"].mean()])


def test_other_motions_have_their_polarity(calibrated):
    """Objects are dark, so OFF events come first where they go.

    So OFF minus ON centroids point along the new motion.
    """
    windows, reconstruction, calibration = calibrated
    agree = []
    for i, (_, image) in enumerate(reconstruction(windows[:12], calibration.pixels.measured)):
        if image is None:
            continue
        for seed in range(4):
            rng = np.random.default_rng((i, seed))
            events, motion = image.moved(calibration.length, calibration.pixels, rng)
            assert (np.diff(events["t"]) >= 0).all()
            assert events["t"].min() >= 0 and events["t"].max() < WINDOW_US
            between = centroid(events[events["p"] == 0]) - centroid(events[events["p"] == 1])
            agree.append(between @ motion[-1] > 0)
    assert np.mean(agree) > 0.9


def test_each_polarity_comes_at_its_own_threshold(calibrated):
    """An ON event takes a quarter of the contrast of an OFF event.

    So there are about four ON events for each OFF event.
    """
    windows, reconstruction, calibration = calibrated
    images = [
        image
        for _, image in reconstruction(windows[:8], calibration.pixels.measured)
        if image is not None
    ]

    def on_for_each_off(step_on):
        measured = MeasuredPixels(step_on=step_on, step_off=1 / step_on)
        pixels = SimulatedPixels(measured, calibration.pixels.scale)
        recordings = [image.as_recorded(pixels, np.random.default_rng(0)) for image in images]
        p = np.concatenate(recordings)["p"]
        return p.sum() / (p == 0).sum()

    for step_on in (0.5, 2.0):
        times_more = on_for_each_off(step_on) / on_for_each_off(1.0)
        assert times_more == pytest.approx(step_on**-2, rel=0.4)


def test_a_large_sensor_is_simulated_in_bands_of_rows(calibrated, monkeypatch):
    """The same picture, in several bands: as many events, everywhere, in order."""
    windows, reconstruction, calibration = calibrated
    ((_, image),) = reconstruction(windows[:1], calibration.pixels.measured)
    whole = image.as_recorded(calibration.pixels, np.random.default_rng(0))
    most = 52 * 34 * 5
    monkeypatch.setattr("async_tnt.simulation.periodic_image.MOST_VALUES", most)
    frames = PeriodicImage.frames
    sizes = []

    def noting(*given):
        made = frames(*given)
        sizes.append(made.size)
        return made

    monkeypatch.setattr(PeriodicImage, "frames", noting)
    bands = image.as_recorded(calibration.pixels, np.random.default_rng(0))
    assert max(sizes) <= most
    assert sum(sizes) == 52 * 34 * 34
    assert (np.diff(bands["t"]) >= 0).all() and len(bands) == pytest.approx(len(whole), rel=0.1)
    rows = [np.bincount(events["y"], minlength=34) for events in (whole, bands)]
    assert np.corrcoef(*rows)[0, 1] > 0.97


def test_random_motions_keep_to_their_ranges():
    rng = np.random.default_rng(0)
    drawn = [random_motion(6.0, SHARES, rng) for _ in range(2_000)]
    motions = np.array([motion for motion, _ in drawn])
    turns = np.array([turn for _, turn in drawn])
    net = motions[:, -1] - motions[:, 0]
    lengths = np.hypot(*net.T)
    assert 6 - 1e-9 <= lengths.min() < 6.01 and 6.4 < lengths.max() <= 6 * np.hypot(1, 0.4)
    directions = np.histogram(np.arctan2(net[:, 1], net[:, 0]), 8, (-np.pi, np.pi))[0]
    assert directions.min() > 190 and directions.max() < 310
    start_later = np.mean(np.hypot(*(motions[:, 3] - motions[:, 0]).T) < 1e-9)
    assert 0.2 < start_later < 0.5
    at_half_time = [np.interp(0.5, SHARES, motion[:, 0]) for motion in motions]
    np.testing.assert_allclose(at_half_time, 0, atol=0.1)
    turned = np.abs(turns[:, -1] - turns[:, 0]).max(0)
    most = np.array([np.radians(6), 0.06])
    assert (turned > 0.98 * most).all() and (turned <= most).all()


def test_half_of_the_motions_are_even_half_straight_and_half_last_the_whole_window():
    """Those that go sideways do so during a half of their way, which begins in its first half."""
    rng = np.random.default_rng(0)
    shares = np.linspace(0, 1, 201)
    even = []
    straight_ones = []
    lasts = []
    bent = []
    for _ in range(600):
        motion, turn = random_motion(6.0, shares, rng)
        way = (turn[:, 0] - turn[0, 0]) / (turn[-1, 0] - turn[0, 0])  # from 0 to 1
        steps = np.diff(way)
        moves = steps > 1e-12
        lasts.append(moves.mean())
        even.append(np.ptp(steps[moves][1:-1]) < 1e-9)
        # what is left of the motion without the straight way
        net = motion[-1] - motion[0]
        is_straight = np.hypot(*net) < 6 + 1e-9
        straight_ones.append(is_straight)
        rest = motion - motion[0] - way[:, None] * net
        if is_straight:
            assert np.abs(rest).max() < 1e-9
        elif even[-1]:
            # before and after the bend the rest changes as evenly as the way does
            slopes = np.diff(rest, axis=0)[moves][1:-1]
            is_bending = np.abs(np.diff(slopes, axis=0)).max(axis=1) > 1e-9
            bent.append(is_bending.mean())
    for values in (even, straight_ones, np.array(lasts) > 0.99):
        assert 0.43 < np.mean(values) < 0.57
    assert 0.39 < min(lasts) < 0.45
    assert len(bent) > 100 and 0.4 < np.median(bent) < 0.55


@pytest.mark.parametrize("turn, growth", [(np.pi / 6, 0.0), (0.0, np.log(1.3)), (-0.4, -0.2)])
def test_an_image_turns_and_grows_about_its_centre(turn, growth):
    """The moments of a long spot.

    Its centre only moves, its longer axis turns, and both axes grow.
    """
    model = Reconstruction((48, 48), WINDOW_US).model
    y, x = np.mgrid[: model.shape[0], : model.shape[1]]
    spot = np.exp(-(((x - 20) / 5) ** 2 + ((y - 25) / 3) ** 2) / 2)
    image = MovedImage(model, spot, MotionPath(np.zeros((N_FRAMES, 2))))
    (picture,) = image.picture.frames(np.array([[4.0, -2.0]]), np.array([[turn, growth]]))
    places = np.stack(np.meshgrid(np.arange(48), np.arange(48)), -1).reshape(-1, 2)
    weights = picture.ravel() / picture.sum()
    centre = weights @ places
    np.testing.assert_allclose(centre, [24, 23], atol=0.05)
    size, axes = np.linalg.eigh((places - centre).T @ (weights[:, None] * (places - centre)))
    np.testing.assert_allclose(np.sqrt(size), np.exp(growth) * np.array([3, 5]), rtol=0.02)
    assert np.tan(turn) == pytest.approx(axes[1, 1] / axes[0, 1], abs=0.01)


def test_noise_does_not_count_where_on_is_compared_with_off():
    """A third more events, all ON, anywhere: the thresholds are as without them, within 5 %."""
    rng = np.random.default_rng(0)
    scenes = [
        recorded(blobs(rng, n=1), straight(net), rng, pixels=PixelModel(noise_hz=0.0))
        for net in [(6, 3)] * 24
    ]
    noisy = [together(scene, (*noise(rng, 80)[:3], np.ones(80, np.uint8))) for scene in scenes]
    expected = measure_pixels(scenes, SENSOR, WINDOW_US)
    measured = measure_pixels(noisy, SENSOR, WINDOW_US)
    assert measured.step_on == pytest.approx(expected.step_on, rel=0.05)
