"""Pictures: what is read of them, and the events that a random camera in a random motion gives."""

import contextlib
import io
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import EpsImagePlugin, Image

from async_tnt.simulation import picture_scene
from async_tnt.simulation.measured_pixels import MeasuredPixels
from async_tnt.simulation.periodic_image import PeriodicImage
from async_tnt.simulation.picture_scene import (
    FINENESS,
    SceneSettings,
    _blurred,
    _crop,
    _frames_of,
    _posed,
    _random_ground,
    _rim,
    _texture,
    record_picture,
)
from async_tnt.simulation.pictures import FORMATS, SUFFIXES, Picture, read_picture
from async_tnt.simulation.random_motion import random_motion
from async_tnt.simulation.random_pixels import random_pixels
from async_tnt.simulation.simulator import PixelModel
from async_tnt.volume.events import EVENT_DTYPE

SETTINGS = SceneSettings((34, 34), 105_000)


def saved(path, values, **options):
    """Save a picture. Returns its path."""
    Image.fromarray(np.asarray(values)).save(path, **options)
    return path


def bar(ground=0, light=255, rows=slice(4, 16), columns=slice(8, 12)):
    """A picture of a bar, 12 x 4 pixels of 20 x 24."""
    values = np.full((20, 24), ground, np.uint8)
    values[rows, columns] = light
    return values


def test_luminance_by_hand(tmp_path):
    """sRGB 188 is half of the light. Rec. 709 sees .2126 of red, .7152 of green, .0722 of blue."""
    colours = np.zeros((4, 5, 3), np.uint8)
    colours[:, :] = 10, 20, 30
    colours[0, :4] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (188, 188, 188)
    picture = read_picture(saved(tmp_path / "a.png", colours))
    np.testing.assert_allclose(picture.light[0, :4], [0.2126, 0.7152, 0.0722, 0.503], atol=2e-3)
    # It is taken as a photograph, without a ground.
    assert picture.ground is None
    assert picture.cover.min() == 1


def test_the_object_is_cut_out(tmp_path):
    """An object of 12 x 4 pixels is cut out on a plain ground, or by its alpha channel."""
    plain = read_picture(saved(tmp_path / "a.png", bar(ground=255, light=0)))
    assert plain.light.shape == (12, 4)
    assert plain.cover.shape == (12, 4)
    assert plain.cover.min() == 1
    assert plain.ground == 1

    opaque = np.dstack([np.full((20, 24, 3), 90, np.uint8), bar()])
    cut = read_picture(saved(tmp_path / "b.png", opaque))
    assert cut.cover.shape == (12, 4)
    assert cut.cover.sum() == 48
    assert cut.ground is None


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32])
def test_a_deep_picture_has_the_shades_of_a_usual_one(tmp_path, dtype):
    """Its largest value is white. Without that, all values above 255 would be white."""
    shades = np.tile(np.linspace(0, 255, 24).astype(np.uint8), (20, 1))
    usual = read_picture(saved(tmp_path / "a.png", shades))
    deep = read_picture(saved(tmp_path / "b.tif", shades.astype(dtype) * dtype(257)))
    assert usual.light.max() == 1 and usual.light.mean() < 0.5
    np.testing.assert_allclose(deep.light, usual.light, atol=0.01)


def test_turned_and_large_pictures(tmp_path):

    exif = Image.Exif()
    exif[0x0112] = 6  # turned by a quarter
    turned = read_picture(saved(tmp_path / "c.png", bar(), exif=exif))
    assert turned.light.shape == (4, 12)

    large_bar = np.kron(bar(), np.ones((60, 60), np.uint8))
    large = read_picture(saved(tmp_path / "d.png", large_bar))
    assert max(large.light.shape) <= 512


@pytest.mark.parametrize(
    ("content", "message"), [(b"no picture", "not a picture"), (b"", "not a picture")]
)
def test_what_is_no_picture(tmp_path, content, message):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_picture(tmp_path / "a.png")
    with pytest.raises(ValueError, match="nothing is on this picture"):
        read_picture(saved(tmp_path / "b.png", np.full((9, 9), 77, np.uint8)))
    with pytest.raises(ValueError, match="at least 2 pixels, got 9x1"):
        read_picture(saved(tmp_path / "c.png", np.arange(9, dtype=np.uint8)[None] * 20))


@pytest.mark.parametrize("kind", ["BMP", "GIF", "JPEG", "PNG", "PPM", "TIFF", "WEBP"])
def test_every_promised_format_is_read_whatever_its_suffix(tmp_path, kind):
    for suffix in SUFFIXES:
        Image.fromarray(bar()).convert("RGB").save(tmp_path / f"a{suffix}", kind)
        assert read_picture(tmp_path / f"a{suffix}").ground == pytest.approx(0, abs=0.01)


def test_no_other_format_is_read_and_no_program_started(tmp_path, monkeypatch):
    """Pillow would start Ghostscript for PostScript, which can read and write files."""
    Image.init()
    monkeypatch.setattr(
        EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("a program was started")
    )
    others = 0
    for kind in sorted(set(Image.SAVE) - set(FORMATS) - {"MPO"}):
        content = io.BytesIO()
        with contextlib.suppress(Exception):  # Some need more than a picture of grey values.
            Image.fromarray(bar()).save(content, kind)
            (tmp_path / "2.png").write_bytes(content.getvalue())
            others += 1
            with pytest.raises(
                ValueError,
                match=r"not a picture: its first bytes are those of no known format \(BMP",
            ):
                read_picture(tmp_path / "2.png")
    assert others > 5
    Image.fromarray(bar()).save(tmp_path / "2.png", "EPS")
    with pytest.raises(ValueError, match="those of no known format"):
        read_picture(tmp_path / "2.png")


def test_a_picture_of_too_many_pixels_is_not_decoded(tmp_path):
    """Its header says how many, and nothing follows."""
    rule = "must have at most 50,000,000 pixels"
    for size, message in (
        ("10001 5000", f"not a picture: it {rule}, got 10001x5000; make it smaller"),
        ("100000 100000", f"{rule}, got 100000x100000|not a picture: Image size"),
        ("500 600", "not a picture: image file is truncated"),
    ):
        (tmp_path / "a.pgm").write_bytes(f"P5 {size} 255\n".encode())
        with pytest.raises(ValueError, match=message):
            read_picture(tmp_path / "a.pgm")


@given(
    kind=st.sampled_from(["png", "jpeg", "bmp", "gif"]),
    cut=st.integers(0, 2_000),
    at=st.integers(0, 2_000),
)
@settings(max_examples=60, deadline=None)
def test_damaged_pictures_are_refused_or_read(tmp_path_factory, kind, cut, at):
    content = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 255, (20, 24), np.uint8)
    Image.fromarray(noise).save(content, kind)
    damaged = bytearray(content.getvalue())
    damaged[at % len(damaged)] ^= 0x5A
    path = tmp_path_factory.mktemp("damaged") / f"a.{kind}"
    path.write_bytes(damaged[: max(1, len(damaged) - cut)])
    with contextlib.suppress(ValueError, OSError):
        assert 0 <= read_picture(path).light.min() <= read_picture(path).light.max() <= 1


def test_a_plain_ground_is_alike_on_all_four_sides(tmp_path):
    """Its luminance is the median: a single pixel that differs does not count."""
    values = bar(ground=100, light=255)
    values[0, 0] = 140
    plain = read_picture(saved(tmp_path / "a.png", values))
    assert plain.ground == pytest.approx(((100 / 255 + 0.055) / 1.055) ** 2.4, rel=1e-5)

    for column in (0, -1):
        side = bar(ground=100, light=255)
        side[1:-1, column] = 200
        assert read_picture(saved(tmp_path / "b.png", side)).ground is None
    noisy = bar(ground=100, light=255)
    noisy[::2] += 20  # by a tenth of the luminance
    assert read_picture(saved(tmp_path / "c.png", noisy)).ground is None


def test_what_is_half_transparent_is_no_object(tmp_path):
    alpha = bar()
    alpha[alpha == 0] = 120
    shown = np.dstack([np.full((20, 24, 3), 90, np.uint8), alpha])
    assert read_picture(saved(tmp_path / "a.png", shown)).cover.shape == (12, 4)


def test_dark_grey_by_hand(tmp_path):
    """Below sRGB 11, the light is proportional to the number: a 12.92th of it."""
    picture = read_picture(saved(tmp_path / "a.png", bar(ground=255, light=5)))
    assert picture.light[3, 2] == pytest.approx(5 / 255 / 12.92, rel=1e-5)


def test_a_large_picture_with_a_palette_is_averaged(tmp_path):
    """Groups of four pixels, black or white at random, mostly become grey."""
    board = np.random.default_rng(0).integers(0, 2, (1024, 1024), np.uint8)
    Image.fromarray(255 * board).convert("P").save(tmp_path / "a.png")
    light = read_picture(tmp_path / "a.png").light
    assert light.shape == (512, 512)
    assert np.mean((light > 0.02) & (light < 0.98)) > 0.8


def test_a_picture_of_floats_has_no_light_below_0(tmp_path):
    """Without any light there is nothing on it."""
    values = np.zeros((20, 24), np.float32)
    values[4:16, 8:12] = 7.0
    expected = read_picture(saved(tmp_path / "a.tiff", values))
    values[1, 1] = -300.0
    found = read_picture(saved(tmp_path / "a.tiff", values))
    np.testing.assert_array_equal(found.light, expected.light)
    for dark in (0.0, -2.0):
        with pytest.raises(ValueError, match="nothing is on this picture"):
            read_picture(saved(tmp_path / "a.tiff", np.full((4, 4), dark, np.float32)))


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_picture_of_floats_is_finite(tmp_path, wrong):
    values = bar().astype(np.float32)
    values[5, 9] = wrong
    with pytest.raises(ValueError, match="not a picture: a picture must have finite values"):
        read_picture(saved(tmp_path / "a.tiff", values))


# -- what is drawn at random -----------------------------------------------------------------------


@dataclass
class Drawn:
    """A recording before its events are simulated."""

    scene: PeriodicImage
    times_us: np.ndarray
    displacement: np.ndarray
    turn: np.ndarray
    pixels: PixelModel

    @property
    def centre(self):
        """The object's centre at half time, on the sensor."""
        half = self.times_us[-1] / 2
        moved = [np.interp(half, self.times_us, column) for column in self.displacement.T]
        return self.scene.centre + moved

    @property
    def light(self):
        """Luminance in the image's middle row, and of its corner, 1 for the brightest."""
        light = np.exp(self.scene.image)
        column, row = np.rint(self.scene.centre * FINENESS).astype(int)
        return light[row, column], light[0, 0]


@pytest.fixture
def drawn(monkeypatch):
    """A function that draws recordings, each with another seed, and simulates no event."""
    seen = []

    def no_events(*given):
        seen.append(Drawn(*given[:-1]))
        return np.empty(0, EVENT_DTYPE)

    monkeypatch.setattr(PeriodicImage, "events", no_events)

    def draw(picture, scene=SETTINGS, n=100):
        seen.clear()
        recordings(picture, n, scene)
        return list(seen)

    return draw


DISC = Picture(
    np.full((24, 24), 0.9, np.float32),
    (np.hypot(*(np.indices((24, 24)) - 11.5)) < 12).astype(np.float32),
    0.1,
)
"""A bright disc on a dark ground."""


def test_at_half_time_the_object_is_anywhere_on_the_sensor(drawn):
    """All of its 20 pixels, which are half of the sensor's shorter side."""
    found = drawn(DISC, SceneSettings((120, 40), 50_000, size=(0.5, 0.5)))
    x, y = np.array([one.centre for one in found]).T
    for places, side in ((x, 120), (y, 40)):
        first = 10 - 0.5
        last = side - 10 - 0.5
        assert first - 0.05 <= places.min() < first + 0.1 * side
        assert last - 0.1 * side < places.max() <= last + 0.05
        assert places.mean() == pytest.approx((side - 1) / 2, abs=0.1 * side)


def test_an_object_that_is_wider_than_high_may_be_nearer_to_the_upper_and_lower_border(drawn):
    """It is 20 x 10 pixels."""
    wide = Picture(np.full((12, 24), 0.9, np.float32), np.ones((12, 24), np.float32), 0.1)
    found = drawn(wide, SceneSettings((120, 40), 50_000, size=(0.5, 0.5)))
    y = np.array([one.centre[1] for one in found])
    assert 4.5 - 0.05 <= y.min() < 9 and 30 < y.max() <= 34.5 + 0.05


@pytest.mark.parametrize("follow", [False, True])
def test_other_copies_of_the_object_stay_off_the_sensor(drawn, follow):
    """The image repeats itself only beyond the sensor, the object and its motion, even when the
    object has turned and grown. A crop that follows the object needs no room for the motion."""
    scene = SceneSettings((60, 34), 50_000, size=(0.5, 0.5), follow=follow)
    for one in drawn(DISC, scene, n=20):
        centre = one.centre - one.scene.centre
        reach = np.ceil(np.abs(one.displacement - centre).max(axis=0) - 1e-6)
        gap = 0.5 * 17 if follow else np.maximum(0.5 * 17, 2 * reach)
        period = (np.array([60, 34]) + 17 + gap) * np.exp(0.15) / np.cos(np.radians(15))
        repeats = np.array(one.scene.image.shape[::-1]) / FINENESS
        assert (repeats >= period - 1e-9).all()
        if not follow:
            assert (repeats < period + 8).all()


def test_frames_of_a_crop_join_where_its_path_is_divided(drawn):
    """Each part begins with the last frame of the part before it."""
    times = [one.times_us for one in drawn(DISC, replace(SETTINGS, follow=True), n=20)]
    assert len(times) > 40
    end_us = 105_000
    for part in times:
        assert part[0] in (0, end_us) and (end_us == 105_000 or part[0] == end_us)
        end_us = part[-1]
    assert end_us == 105_000


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_a_sensor_is_cut_out_for_the_motion_and_is_no_larger_than_the_whole(
    drawn, monkeypatch, size
):
    """Lengths, in the object's longer side, are log-uniform from .1 to .8. There is no texture."""
    lengths = []

    def noting(length, *given, **settings):
        lengths.append(length / (60 * size))
        return random_motion(length, *given, **settings)

    monkeypatch.setattr(picture_scene, "random_motion", noting)
    scene = SceneSettings((72, 60), 50_000, size=(size, size), light="positive", cut_out=True)
    found = drawn(DISC, scene, n=40)
    sensors = np.array([one.scene.sensor for one in found])
    assert (sensors <= (72, 60)).all()
    assert (sensors >= np.minimum(1.4 * 60 * size, (72, 60))).all()
    assert 0.1 <= min(lengths) < 0.14 and 0.6 < max(lengths) <= 0.8
    assert np.median(lengths) == pytest.approx(np.sqrt(0.08), rel=0.35)
    assert max(one.scene.image[:4].std() for one in found) < 1e-3


def test_sizes_and_blurs_have_their_ranges(drawn, monkeypatch):
    """Both are uniform: sizes as shares of the sensor's shorter side, blurs in pixels."""
    sizes = []
    blurs = []

    def posed(picture, side, rng):
        sizes.append(side / FINENESS / 34)
        return _posed(picture, side, rng)

    def blurred(image, sigma):
        blurs.append(sigma / FINENESS)
        return image

    monkeypatch.setattr(picture_scene, "_posed", posed)
    monkeypatch.setattr(picture_scene, "_blurred", blurred)
    drawn(DISC)
    for values, low, high in ((sizes, 0.4, 0.8), (blurs, 0.3, 0.9)):
        span = high - low
        assert low <= min(values) < low + 0.1 * span and high - 0.1 * span < max(values) <= high
        assert np.mean(values) == pytest.approx((low + high) / 2, abs=0.1 * span)


def test_a_random_ground_is_chosen_for_the_mean_light_of_the_object_alone(drawn, monkeypatch):
    seen = []

    def noting(luminance, rng):
        seen.append(luminance)
        return 0.0

    monkeypatch.setattr(picture_scene, "_random_ground", noting)
    drawn(replace(DISC, ground=None), n=5)
    drawn(DISC, n=5)
    assert seen == pytest.approx([0.9] * 5, abs=0.02)


def test_a_thin_object_has_two_places_at_least():
    line = Picture(np.ones((2, 200), np.float32), np.ones((2, 200), np.float32), 0.1)
    light, cover = _posed(line, 40.0, np.random.default_rng(0))
    assert light.shape == cover.shape == (2, 40)


@pytest.mark.parametrize(("follow", "longest"), [(False, 0.5), (True, 4.0)])
def test_motions_and_turns_have_their_ranges(drawn, monkeypatch, follow, longest):
    """Lengths, as shares of the shorter side, are log-uniform."""
    lengths = []

    def noting(length, *given, **settings):
        lengths.append(length / 30)
        return random_motion(length, *given, **settings)

    monkeypatch.setattr(picture_scene, "random_motion", noting)
    found = drawn(DISC, SceneSettings((40, 30), 50_000, follow=follow))
    assert 0.06 <= min(lengths) < 0.07
    assert 0.8 * longest < max(lengths) <= longest
    assert np.median(lengths) == pytest.approx(np.sqrt(0.06 * longest), rel=0.35)
    # none at half time, and so less than the whole before and after it
    turned, grown = np.max([np.abs(one.turn).max(0) for one in found], axis=0)
    assert np.radians(8) < turned <= np.radians(15)
    assert 0.08 < grown <= 0.15
    assert {one.times_us[-1] for one in found} >= {50_000}


def test_a_recording_has_at_most_500_frames():
    """However long its way is."""
    motion = np.stack([np.linspace(0, 1_000, 4_001), np.zeros(4_001)], axis=1)
    at, displacement, _ = _frames_of(motion, 0 * motion)
    assert len(at) == 501
    np.testing.assert_allclose(np.diff(displacement[:, 0]), 2)


def test_contrast_is_2_to_15_and_light_and_dark_are_exchanged_in_half_of_the_recordings(drawn):
    """A ratio of light in the middle of a white disc to that of the black ground, or the other way
    round."""
    white = replace(DISC, light=DISC.cover, ground=0.0)
    ratios = {}
    for light in ("positive", "negative", "both"):
        scene = replace(SETTINGS, light=light)
        found = [np.divide(*one.light) for one in drawn(white, scene)]
        ratios[light] = np.log(found)
    for light, sign in (("positive", 1), ("negative", -1)):
        signed = sign * ratios[light]
        assert 0 < signed.min() < signed.max() <= np.log(15) + 1e-9
        assert np.median(signed) == pytest.approx(np.log(30) / 2, rel=0.2)
    assert 0.3 < np.mean(ratios["both"] > 0) < 0.7


def test_half_of_the_grounds_have_a_texture(drawn):
    """The texture changes the luminance by at most .15 of it."""
    spreads = []
    for one in drawn(replace(DISC, ground=0.5), replace(SETTINGS, light="positive")):
        light = np.exp(one.scene.image[:4])
        spreads.append(light.std())
    flat = np.array(spreads) < 1e-3
    assert 0.35 < flat.mean() < 0.65
    assert 0.02 < np.max(spreads) < 0.3


def test_around_the_object_is_its_ground(drawn):
    """Also in the corners of its square: a dark disc of 17 pixels on a bright ground."""
    dark = replace(DISC, light=0.1 * DISC.cover, ground=0.6)
    for one in drawn(dark, replace(SETTINGS, size=(0.5, 0.5), light="positive"), n=10):
        middle, ground = one.light
        column, row = np.rint(one.scene.centre * FINENESS).astype(int)
        corner = np.exp(one.scene.image[row - 15, column - 15])
        assert middle < ground
        assert abs(corner - ground) < abs(corner - middle)


def test_a_known_camera_records_pictures(drawn):
    camera = MeasuredPixels(noise_hz=7.0)
    for one in drawn(DISC, replace(SETTINGS, camera=camera), n=10):
        assert 7 / 1.26 < one.pixels.noise_hz < 7 * 1.26


@pytest.mark.parametrize("luminance", [0.0, 0.2, 0.49, 0.5, 0.51, 0.8, 1.0])
def test_a_ground_of_its_own_differs_from_the_object(luminance):
    """By a quarter at least; it is neither darker than black nor brighter than white."""
    rng = np.random.default_rng(0)
    grounds = np.array([_random_ground(luminance, rng) for _ in range(300)])
    assert np.abs(grounds - luminance).min() >= 0.25 - 1e-12
    assert 0 <= grounds.min() < grounds.max() <= 1


def test_a_photograph_fades_into_its_ground(drawn):
    """Within a tenth of its sides, and a picture with a ground of its own does not."""
    photograph = replace(DISC, cover=np.ones((24, 24), np.float32), ground=None)
    plain = replace(photograph, ground=0.1)
    covers = [_posed(one, 96, np.random.default_rng(0))[1] for one in (photograph, plain)]
    differ = covers[1] - covers[0]
    assert differ.min() > -1e-6
    assert differ.max() > 0.5
    assert np.abs(differ[20:-20, 20:-20]).max() < 1e-6
    # what was cut out of a picture has a border of its own
    for one in (DISC, replace(DISC, ground=None)):
        cut_out = _posed(one, 96, np.random.default_rng(0))[1]
        assert cut_out.sum() == pytest.approx(_posed(DISC, 96, np.random.default_rng(0))[1].sum())
    rim = _rim(np.ones((40, 10)))
    np.testing.assert_allclose(rim[:6, 5], [0.125, 0.375, 0.625, 0.875, 1, 1])
    np.testing.assert_allclose(rim, rim[::-1, ::-1])


def test_a_blur_is_a_gaussian_of_its_width():
    """An impulse gets this variance along each axis, and keeps its light."""
    impulse = np.zeros((48, 40))
    impulse[24, 20] = 1.0
    seen = _blurred(impulse, 2.0)
    assert seen.sum() == pytest.approx(1)
    y, x = np.indices(seen.shape)
    assert (seen * (y - 24) ** 2).sum() == pytest.approx(4, rel=1e-3)
    assert (seen * (x - 20) ** 2).sum() == pytest.approx(4, rel=1e-3)


def test_a_texture_has_deviation_1_and_less_power_at_higher_frequencies():
    """A quarter of the power at twice the frequency."""
    rng = np.random.default_rng(0)
    power = np.zeros((64, 33))
    for _ in range(100):
        field = _texture((64, 64), rng)
        assert field.std() == pytest.approx(1)
        assert field.mean() == pytest.approx(0, abs=1e-9)
        power += np.abs(np.fft.rfft2(field)) ** 2
    radius = np.hypot(np.fft.fftfreq(64)[:, None], np.fft.rfftfreq(64))
    bands = [power[(radius > low) & (radius < 1.2 * low)].mean() for low in (0.1, 0.2, 0.4)]
    np.testing.assert_allclose(np.divide(bands[:2], bands[1:]), 4, rtol=0.2)


def test_some_motions_turn_round_and_come_back():
    """What they have turned is less at the end than before, in as many as is said."""
    shares = np.linspace(0, 1, 400)

    def comes_back(seed, back):
        rng = np.random.default_rng(seed)
        motion, turn = random_motion(10.0, shares, rng, most_turn=1.0, back=back)
        way = turn[:, 0] - turn[0, 0]
        gone = np.abs(way)
        # what comes back stays where it began
        assert (way * way[gone.argmax()]).min() > -1e-9
        assert np.hypot(*motion.T).max() > 1
        return gone[-1] < 0.999 * gone.max()

    assert not any(comes_back(seed, 0.0) for seed in range(100))
    assert all(comes_back(seed, 1.0) for seed in range(100))
    assert 0.15 < np.mean([comes_back(seed, 0.25) for seed in range(400)]) < 0.35


def test_turns_and_growth_are_as_large_as_is_said():
    shares = np.linspace(0, 1, 52)
    rng = np.random.default_rng(0)
    drawn = [random_motion(1.0, shares, rng, most_turn=0.5, most_growth=2.0) for _ in range(300)]
    most = np.max([np.ptp(turn, axis=0) for _, turn in drawn], axis=0)
    assert 0.48 < most[0] <= 0.5
    assert 1.9 < most[1] <= 2


def test_unknown_cameras_have_their_ranges():
    """Thresholds, refractory time, bandwidth and noise are log-uniform; half of the cameras have no
    after-pulses, and half no hot pixels."""
    drawn = [random_pixels(np.random.default_rng(i)) for i in range(400)]

    def column(name):
        return np.array([getattr(one, name) for one in drawn])

    threshold = np.sqrt(column("threshold_on") * column("threshold_off"))
    for values, low, high in (
        (threshold, 0.1, 0.4),
        (column("refractory_us"), 100, 3_000),
        (column("bandwidth_hz"), 200, 5_000),
        (column("noise_hz"), 0.01, 3),
    ):
        assert low <= values.min() < 1.1 * low
        assert 0.9 * high < values.max() <= high
        assert np.median(values) == pytest.approx(np.sqrt(low * high), rel=0.25)
    for name, most in (("after_share", 1 / 3), ("hot_share", 1 / 500)):
        assert 0.4 < np.mean(column(name) == 0) < 0.6
        assert 0.9 * most < column(name).max() <= most
    ratio = column("threshold_on") / column("threshold_off")
    assert np.median(ratio) == pytest.approx(1, rel=0.1)
    assert np.mean(np.abs(np.log(ratio)) < np.log(1.4)) == pytest.approx(2 / 3, abs=0.07)
    for name, low, high in (("mismatch", 0.03, 0.25), ("noise_on_share", 0.1, 1.0)):
        assert low <= column(name).min() < low + 0.02 and high - 0.02 < column(name).max() <= high
    assert set(column("hot_hz")) == {50}
    assert 0 < column("leak_hz").min() < column("leak_hz").max() <= 0.3


def test_what_is_known_of_a_camera_takes_the_place_of_what_is_drawn():
    """The measured noise holds what leaks. No share is above 1."""
    camera = MeasuredPixels(noise_hz=0.2, noise_on_share=0.9, after_share=0.9)
    drawn = [random_pixels(np.random.default_rng(i), camera) for i in range(50)]
    assert {(one.noise_on_share, one.leak_hz) for one in drawn} == {(0.9, 0.0)}
    shares = [one.after_share for one in drawn]
    assert 0.9 / 1.26 < min(shares) < 0.8
    assert max(shares) == 1


@pytest.mark.parametrize("light", ["", "dark", None])
def test_an_unknown_light_is_refused(light):
    with pytest.raises(ValueError, match="`light` must be"):
        SceneSettings((34, 34), 1_000, light=light)


def recordings(picture, n=60, scene=SETTINGS):
    """n recordings of a picture, each with another seed."""
    return [record_picture(picture, scene, np.random.default_rng(i)).events for i in range(n)]


def test_recordings_are_events_of_the_sensor_and_repeat(tmp_path):
    picture = read_picture(saved(tmp_path / "a.png", bar()))
    scene = SceneSettings((48, 34), 50_000)
    found = recordings(picture, 20, scene)
    for events in found:
        assert (np.diff(events["t"]) >= 0).all()
        assert events["t"].max(initial=0) < 50_000
        assert events["x"].max(initial=0) < 48
        assert events["y"].max(initial=0) < 34
    for events, again in zip(found, recordings(picture, 20, scene), strict=True):
        np.testing.assert_array_equal(events, again)


def test_positives_and_negatives_have_opposite_signs(tmp_path):
    """With light and dark exchanged, pixels that began with ON begin with OFF.

    All random draws are the same.
    """
    picture = read_picture(saved(tmp_path / "a.png", bar()))
    firsts = []
    for light in ("positive", "negative"):
        scene = SceneSettings((34, 34), 105_000, light=light)
        image = np.zeros((20, 34, 34))
        for k, events in enumerate(recordings(picture, 20, scene)):
            # In reverse, so that a pixel's first event is written last.
            image[k, events["y"][::-1], events["x"][::-1]] = 2.0 * events["p"][::-1] - 1
        firsts.append(image.ravel())
    both = firsts[0] * firsts[1] != 0
    assert both.sum() > 2_000
    assert np.mean(firsts[0][both] == -firsts[1][both]) > 0.58


def test_a_crop_follows_the_object(tmp_path):
    """What moves along with the crop stays at its place, and what stands still leaves.

    The crop moves by 4 pixels to the right and 2 up in 8 us.
    """
    motion = np.stack([np.linspace(0, 4, 9), np.linspace(0, -2, 9)], axis=1)
    reach = np.array([4, 3])
    times = np.arange(9.0)
    moving = [(t, 4 + 10 + round(t / 2), 3 + 6 - round(t / 4), 1) for t in range(9)]
    still = [(t, 4, 3 + 9, 0) for t in range(9)]  # at the crop's left border
    events = _crop(np.array(sorted(moving + still), EVENT_DTYPE), times, motion, -reach, (20, 12))
    moved = events[events["p"] == 1]
    assert len(moved) == 9
    assert set(moved["x"]) == {10}
    assert set(moved["y"]) == {6}
    # Half a pixel is rounded to even.
    assert [(t, x) for t, x, _, p in events.tolist() if not p] == [(0, 0), (1, 0)]
    # The crop moves the other way, and sees what is left of where it began.
    at_the_end = np.array([(8, 1, 6, 1), (8, 1, 4, 1)], EVENT_DTYPE)
    assert _crop(at_the_end, times, -motion, -reach, (20, 12)).tolist() == [(8, 1, 1, 1)]


def extents_of(events_of_recordings, axis):
    """How far the events of each recording with more than 200 reach along an axis, in pixels."""
    return [
        np.ptp(np.quantile(events[axis], (0.1, 0.9)))
        for events in events_of_recordings
        if len(events) > 200
    ]


def test_a_crop_is_as_large_as_the_sensor(tmp_path):
    """And a followed object has its size of 12 pixels, in whatever way it goes."""
    picture = read_picture(saved(tmp_path / "a.png", bar(rows=slice(2, 18), columns=slice(4, 20))))
    found = recordings(picture, 60, SceneSettings((40, 30), 25_000, size=(0.4, 0.4), follow=True))
    for events in found:
        assert events["x"].max(initial=0) < 40
        assert events["y"].max(initial=0) < 30
    for axis in "xy":
        extents = extents_of(found, axis)
        assert len(extents) > 40
        assert 9 < np.median(extents) < 17


@pytest.mark.parametrize("height", [4, 8, 40, 96])
def test_a_plane_seen_from_aside_keeps_its_area(tmp_path, height):
    """A bar keeps it, too: its corners do not cross."""
    values = np.pad(np.full((height, 96), 255, np.uint8), 8)
    picture = read_picture(saved(tmp_path / "a.png", values))
    kept = []
    for i in range(50):
        cover = _posed(picture, 96, np.random.default_rng(i))[1]
        kept.append(cover.sum() / (96 * height))
    assert min(kept) > 0.35
    assert 0.6 < np.median(kept) < 0.9


def test_frames_are_closer_together_where_the_motion_is_faster():
    shares = np.linspace(0, 1, 4_001)
    motion = np.stack([30 * np.where(shares < 0.1, 10 * shares, 1.0), 0 * shares], axis=1)
    at, displacement, turn = _frames_of(motion, -motion / 10)
    np.testing.assert_allclose(turn, -displacement / 10)
    assert np.hypot(*np.diff(displacement, axis=0).T).max() < 0.51
    assert np.diff(at).max() < 0.02
    assert at[0] == 0
    assert at[-1] == 1
    assert len(at) == 60 + 52 + 1  # for 30 pixels, for the time, and the first


def test_the_object_has_the_stated_size(tmp_path):
    """Active pixels reach as far as the object does, and its motion."""
    picture = read_picture(saved(tmp_path / "a.png", bar(rows=slice(2, 18), columns=slice(4, 20))))
    camera = MeasuredPixels(refractory_us=1e-9, noise_hz=1e-9)
    for size, least, most in ((0.2, 8, 20), (0.6, 25, 45)):
        scene = SceneSettings((64, 64), 105_000, size=(size, size), camera=camera)
        found = recordings(picture, 60, scene)
        assert least < np.median(extents_of(found, "x")) < most
    for wrong in ((0, 0.5), (0.6, 0.4), (0.5, 1.2)):
        with pytest.raises(ValueError, match="`size` must be a range within"):
            SceneSettings((34, 34), 1_000, size=wrong)


def test_what_happens_at_the_end_of_a_motion_is_not_in_it():
    """An event that is rounded to the last time belongs to the motion that begins there."""
    rng = np.random.default_rng(0)
    image = PeriodicImage(rng.normal(size=(16, 16)), 1, 0.0, np.full(2, 8.0), (16, 16))
    pixels = PixelModel(0.1, 0.1, mismatch=0.0, refractory_us=0.0, noise_hz=0.0)
    for end_us in (10, 10.5, 11):
        moved = np.array([[0.0, 0.0], [3.0, 0.0]])
        events = image.events(np.array([0, end_us], float), moved, None, pixels, rng)
        # light that changes evenly gives events in every microsecond
        assert np.unique(events["t"]).tolist() == list(range(int(np.ceil(end_us))))


def test_a_sensor_of_very_many_columns_is_simulated_row_by_row(monkeypatch):
    """Frames may begin at any row."""
    rng = np.random.default_rng(0)
    image = PeriodicImage(rng.normal(size=(16, 16)), 1, 0.0, np.full(2, 8.0), (16, 12))
    moved = np.array([[0.0, 0.0], [3.0, 1.0]])
    whole = image.frames(moved)
    np.testing.assert_array_equal(image.frames(moved, first=5), whole[:, 5:])
    np.testing.assert_array_equal(image.frames(moved, None, 5, 2), whole[:, 5:7])
    monkeypatch.setattr("async_tnt.simulation.periodic_image.MOST_VALUES", 3)
    pixels = PixelModel(0.1, 0.1, refractory_us=0.0, noise_hz=0.0)
    events = image.events(np.array([0.0, 1_000.0]), moved, None, pixels, rng)
    assert np.unique(events["y"]).tolist() == list(range(12))
    assert (np.diff(events["t"]) >= 0).all()


def test_a_known_camera_keeps_to_what_is_known():
    camera = MeasuredPixels(1.2, 1 / 1.2, 800.0, 0.2, 0.9, 0.1)
    drawn = [random_pixels(np.random.default_rng(i), camera) for i in range(200)]
    ratios = np.array([one.threshold_on / one.threshold_off for one in drawn])
    assert 1.44 / 1.26 < ratios.min() < 1.2
    assert 1.7 < ratios.max() < 1.44 * 1.26
    assert all(0.2 / 1.26 < one.noise_hz < 0.2 * 1.26 for one in drawn)
    assert all(one.refractory_us <= 800 for one in drawn)

    # A refractory period that was measured from a few events; and no pixel was quiet.
    slow = MeasuredPixels(refractory_us=60_000.0)
    unknown = [random_pixels(np.random.default_rng(i), slow) for i in range(200)]
    assert 2_000 < max(one.refractory_us for one in unknown) <= 3_000
    noise = [one.noise_hz for one in unknown]
    assert min(noise) >= 0.01

    anything = [random_pixels(np.random.default_rng(i)) for i in range(200)]
    assert noise == [one.noise_hz for one in anything]
    assert max(noise) > 1
    assert min(noise) < 0.05
