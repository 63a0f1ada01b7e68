"""Pictures: what is read of them, and the events that a random camera in a random motion gives."""

import contextlib
import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import EpsImagePlugin, Image

from async_tnt.simulation.measured_pixels import MeasuredPixels
from async_tnt.simulation.picture_scene import (
    SceneSettings,
    _crop,
    _frames_of,
    _posed,
    record_picture,
)
from async_tnt.simulation.pictures import FORMATS, SUFFIXES, read_picture
from async_tnt.simulation.random_pixels import random_pixels
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


def test_deep_turned_and_large_pictures(tmp_path):
    deep = read_picture(saved(tmp_path / "a.png", bar().astype(np.uint16) * 257))
    usual = read_picture(saved(tmp_path / "b.png", bar()))
    np.testing.assert_allclose(deep.light, usual.light, atol=0.01)

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


def recordings(picture, n=60, scene=SETTINGS):
    """n recordings of a picture, each with another seed."""
    return [record_picture(picture, scene, np.random.default_rng(i)) for i in range(n)]


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
