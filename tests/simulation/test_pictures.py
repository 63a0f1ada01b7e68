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
    Image.fromarray(np.asarray(values)).save(path, **options)
    return path


def bar(ground=0, light=255, rows=slice(4, 16), columns=slice(8, 12)):
    values = np.full((20, 24), ground, np.uint8)
    values[rows, columns] = light
    return values


def test_luminance_by_hand(tmp_path):
    """sRGB 188 is half of the light; of pure red, green and blue Rec. 709 sees .2126, .7152,
    .0722."""
    colours = np.zeros((4, 5, 3), np.uint8)
    colours[:, :] = 10, 20, 30
    colours[0, :4] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (188, 188, 188)
    picture = read_picture(saved(tmp_path / "a.png", colours))
    np.testing.assert_allclose(picture.light[0, :4], [0.2126, 0.7152, 0.0722, 0.503], atol=2e-3)
    assert picture.ground is None and picture.cover.min() == 1  # a photograph


def test_the_object_is_cut_out(tmp_path):
    """On a plain ground or by its alpha channel: 12 x 4 pixels."""
    plain = read_picture(saved(tmp_path / "a.png", bar(ground=255, light=0)))
    assert (
        plain.light.shape == plain.cover.shape == (12, 4)
        and plain.ground == 1
        and plain.cover.min() == 1
    )
    opaque = np.dstack([np.full((20, 24, 3), 90, np.uint8), bar()])
    cut = read_picture(saved(tmp_path / "b.png", opaque))
    assert cut.cover.shape == (12, 4) and cut.cover.sum() == 48 and cut.ground is None


def test_deep_turned_and_large_pictures(tmp_path):
    deep = read_picture(saved(tmp_path / "a.png", bar().astype(np.uint16) * 257))
    np.testing.assert_allclose(
        deep.light, read_picture(saved(tmp_path / "b.png", bar())).light, atol=0.01
    )
    exif = Image.Exif()
    exif[0x0112] = 6  # turned by a quarter
    assert read_picture(saved(tmp_path / "c.png", bar(), exif=exif)).light.shape == (4, 12)
    assert (
        max(
            read_picture(
                saved(tmp_path / "d.png", np.kron(bar(), np.ones((60, 60), np.uint8)))
            ).light.shape
        )
        <= 512
    )


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
        with contextlib.suppress(Exception):  # some need more than a picture of grey values
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
    for size, message in (
        (
            "10001 5000",
            "not a picture: it must have at most 50,000,000 pixels, got 10001x5000; make it "
            "smaller",
        ),
        (
            "100000 100000",
            "must have at most 50,000,000 pixels, got 100000x100000|not a picture: Image size",
        ),
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
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (20, 24), np.uint8)).save(
        content, kind
    )
    damaged = bytearray(content.getvalue())
    damaged[at % len(damaged)] ^= 0x5A
    path = tmp_path_factory.mktemp("damaged") / f"a.{kind}"
    path.write_bytes(damaged[: max(1, len(damaged) - cut)])
    with contextlib.suppress(ValueError, OSError):
        assert 0 <= read_picture(path).light.min() <= read_picture(path).light.max() <= 1


def recordings(picture, n=60, scene=SETTINGS):
    return [record_picture(picture, scene, np.random.default_rng(i)) for i in range(n)]


def test_recordings_are_events_of_the_sensor_and_repeat(tmp_path):
    picture = read_picture(saved(tmp_path / "a.png", bar()))
    found = recordings(picture, 20, SceneSettings((48, 34), 50_000))
    assert all(
        (np.diff(events["t"]) >= 0).all() and events["t"].max(initial=0) < 50_000
        for events in found
    )
    assert all(
        events["x"].max(initial=0) < 48 and events["y"].max(initial=0) < 34 for events in found
    )
    for events, again in zip(
        found, recordings(picture, 20, SceneSettings((48, 34), 50_000)), strict=True
    ):
        np.testing.assert_array_equal(events, again)


def test_positives_and_negatives_have_opposite_signs(tmp_path):
    """The same draws, light and dark exchanged: where one begins with ON, the other begins with
    OFF."""
    picture = read_picture(saved(tmp_path / "a.png", bar()))
    firsts = []
    for light in ("positive", "negative"):
        image = np.zeros((20, 34, 34))
        for k, events in enumerate(
            recordings(picture, 20, SceneSettings((34, 34), 105_000, light=light))
        ):
            image[k, events["y"][::-1], events["x"][::-1]] = 2.0 * events["p"][::-1] - 1
        firsts.append(image.ravel())
    both = firsts[0] * firsts[1] != 0
    assert both.sum() > 2_000 and np.mean(firsts[0][both] == -firsts[1][both]) > 0.58


def test_a_crop_follows_the_object(tmp_path):
    """What moves along, by 4 pixels to the right and 2 up in 8 us, stays at its place; what stands
    still leaves."""
    motion = np.stack([np.linspace(0, 4, 9), np.linspace(0, -2, 9)], axis=1)
    reach, times = np.array([4, 3]), np.arange(9.0)
    moving = [(t, 4 + 10 + round(t / 2), 3 + 6 - round(t / 4), 1) for t in range(9)]
    still = [(t, 4, 3 + 9, 0) for t in range(9)]  # at the crop's left border
    events = _crop(np.array(sorted(moving + still), EVENT_DTYPE), times, motion, -reach, (20, 12))
    assert {(x, y) for _, x, y, p in events.tolist() if p} == {(10, 6)} and (
        events["p"] == 1
    ).sum() == 9
    # half a pixel is rounded to even
    assert [(t, x) for t, x, _, p in events.tolist() if not p] == [(0, 0), (1, 0)]
    # the other way: left of where the crop began
    at_the_end = np.array([(8, 1, 6, 1), (8, 1, 4, 1)], EVENT_DTYPE)
    assert _crop(at_the_end, times, -motion, -reach, (20, 12)).tolist() == [(8, 1, 1, 1)]
    picture = read_picture(saved(tmp_path / "a.png", bar(rows=slice(2, 18), columns=slice(4, 20))))
    found = recordings(picture, 60, SceneSettings((40, 30), 25_000, size=(0.4, 0.4), follow=True))
    assert all(one["x"].max(initial=0) < 40 and one["y"].max(initial=0) < 30 for one in found)
    for axis in "xy":  # 12 pixels, in whatever way they go
        extents = [np.ptp(np.quantile(one[axis], (0.1, 0.9))) for one in found if len(one) > 200]
        assert len(extents) > 40 and 9 < np.median(extents) < 17


@pytest.mark.parametrize("height", [4, 8, 40, 96])
def test_a_plane_seen_from_aside_keeps_its_area(tmp_path, height):
    """Of a bar, too: its corners do not cross."""
    picture = read_picture(
        saved(tmp_path / "a.png", np.pad(np.full((height, 96), 255, np.uint8), 8))
    )
    kept = [
        _posed(picture, 96, np.random.default_rng(i))[1].sum() / (96 * height) for i in range(50)
    ]
    assert min(kept) > 0.35 and 0.6 < np.median(kept) < 0.9


def test_frames_are_closer_together_where_the_motion_is_faster():
    shares = np.linspace(0, 1, 4_001)
    motion = np.stack([30 * np.where(shares < 0.1, 10 * shares, 1.0), 0 * shares], axis=1)
    at, displacement, turn = _frames_of(motion, -motion / 10)
    np.testing.assert_allclose(turn, -displacement / 10)
    assert np.hypot(*np.diff(displacement, axis=0).T).max() < 0.51 and np.diff(at).max() < 0.02
    # 60 for 30 pixels, 52 for the time, and the first
    assert (at[0], at[-1], len(at)) == (0, 1, 113)


def test_the_object_has_the_stated_size(tmp_path):
    """Active pixels reach as far as the object does, and its motion."""
    picture = read_picture(saved(tmp_path / "a.png", bar(rows=slice(2, 18), columns=slice(4, 20))))
    reaches, camera = [], MeasuredPixels(refractory_us=1e-9, noise_hz=1e-9)
    for size in (0.2, 0.6):
        found = recordings(
            picture, 60, SceneSettings((64, 64), 105_000, size=(size, size), camera=camera)
        )
        reaches.append(
            np.median(
                [np.ptp(np.quantile(one["x"], (0.1, 0.9))) for one in found if len(one) > 200]
            )
        )
    assert 8 < reaches[0] < 20 and 25 < reaches[1] < 45
    for wrong in ((0, 0.5), (0.6, 0.4), (0.5, 1.2)):
        with pytest.raises(ValueError, match="`size` must be a range within"):
            SceneSettings((34, 34), 1_000, size=wrong)


def test_a_known_camera_keeps_to_what_is_known():
    camera = MeasuredPixels(1.2, 1 / 1.2, 800.0, 0.2, 0.9, 0.1)
    drawn = [random_pixels(np.random.default_rng(i), camera) for i in range(200)]
    ratios = np.array([one.threshold_on / one.threshold_off for one in drawn])
    assert 1.44 / 1.26 < ratios.min() < 1.2 and 1.7 < ratios.max() < 1.44 * 1.26
    assert all(0.2 / 1.26 < one.noise_hz < 0.2 * 1.26 and one.refractory_us <= 800 for one in drawn)
    slow = MeasuredPixels(refractory_us=60_000.0)  # of a few events; and no pixel was quiet
    unknown = [random_pixels(np.random.default_rng(i), slow) for i in range(200)]
    assert (
        2_000 < max(one.refractory_us for one in unknown) <= 3_000
        and min(one.noise_hz for one in unknown) >= 0.01
    )
    anything = [random_pixels(np.random.default_rng(i)) for i in range(200)]
    assert [one.noise_hz for one in unknown] == [one.noise_hz for one in anything]
    assert (
        max(one.noise_hz for one in anything) > 1 and min(one.noise_hz for one in anything) < 0.05
    )
