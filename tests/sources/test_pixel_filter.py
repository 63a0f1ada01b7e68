"""The filter equals its NumPy twin and counts what it drops.

Which pixels a model sees is a value that can be sent.
"""

import hashlib
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import nasty_streams, random_events

import async_tnt
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.sources.pixels.pixel_filter import PixelCounts, PixelFilter
from async_tnt.sources.pixels.pixel_masks import load_mask, save_mask
from async_tnt.sources.pixels.pixels import Pixels

SENSORS = [(34, 34), (7, 5), (2, 2), (300, 200), (40, 1)]


def twin(events, sensor, roi, mask, crop):
    """The definition, in NumPy: kept events, and how many were masked and outside."""
    left, top, width, height = roi or (0, 0, *sensor)
    x = events["x"].astype(int)
    y = events["y"].astype(int)
    inside = (x >= left) & (x < left + width) & (y >= top) & (y < top + height)
    masked = inside & (mask[y, x] if mask is not None else False)
    kept = events[inside & ~masked].copy()
    if crop:
        kept["x"] -= left
        kept["y"] -= top
    return kept, int(masked.sum()), int((~inside).sum())


@st.composite
def filters(draw):
    """Sensor, region, mask and crop of a filter."""
    sensor = draw(st.sampled_from(SENSORS))
    width, height = sensor
    roi = None
    if draw(st.booleans()):
        left = draw(st.integers(0, width - 1))
        top = draw(st.integers(0, height - 1))
        roi = (left, top, draw(st.integers(1, width - left)), draw(st.integers(1, height - top)))
    mask = None
    if draw(st.booleans()):
        share = draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))
        mask = np.random.default_rng(draw(st.integers(0, 99))).random((height, width)) < share
    return sensor, roi, mask, roi is not None and draw(st.booleans())


@given(st.data(), filters())
def test_filter_equals_numpy(data, settings):
    sensor, roi, mask, crop = settings
    pixel_filter = PixelFilter(sensor, roi, mask, crop=crop)
    total = np.zeros(4, int)
    for _ in range(data.draw(st.integers(1, 3))):
        events = data.draw(nasty_streams(sensor, 1000, 5))
        before = events.tobytes()
        kept, masked, outside = twin(events, sensor, roi, mask, crop)
        got = pixel_filter(events)
        assert got.dtype == async_tnt.EVENT_DTYPE and got.tobytes() == kept.tobytes()
        assert events.tobytes() == before
        total += (len(events), len(kept), masked, outside)
        assert pixel_filter.counts == PixelCounts(*total)
    assert pixel_filter.sensor == (roi[2:] if crop else sensor)
    pixel_filter.reset()
    assert pixel_filter.counts == PixelCounts()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"sensor": (30, 40_000)},
            r"`sensor` must have sides in \[1, 32768\] pixels, got \(30, 40000\)",
        ),
        (
            {"roi": (5, 19, 3, 2)},
            r"`roi` .* must lie on the sensor of 30x20 pixels, .* got \(5, 19, 3, 2\)",
        ),
        (
            {"roi": (-1, 0, 3, 2)},
            r"`roi` .* must lie on the sensor of 30x20 .*, x and y at least 0, .* "
            r"got \(-1, 0, 3, 2\)",
        ),
        (
            {"roi": (0, -1, 3, 2)},
            r"`roi` .* must lie on the sensor of 30x20 .*, got \(0, -1, 3, 2\)",
        ),
        (
            {"roi": (28, 5, 3, 2)},
            r"`roi` .* must lie on the sensor of 30x20 .*, got \(28, 5, 3, 2\)",
        ),
        ({"roi": (5, 5, 0, 1)}, r"`roi` .* must lie on the sensor of 30x20 .*, got \(5, 5, 0, 1\)"),
        ({"roi": (5, 5, 1, 0)}, r"`roi` .* must lie on the sensor of 30x20 .*, got \(5, 5, 1, 0\)"),
        (
            {"roi": (5, 5, 3.0, 1)},
            r"`roi` must be \(x, y, width, height\) in whole pixels, got \(5, 5, 3.0, 1\)",
        ),
        ({"crop": True}, r"`crop` belongs to `roi`: the region that .* the sensor"),
        (
            {"mask": np.zeros((30, 20), bool)},
            r"a mask of a 30x20 sensor must be .* \(30, 20\); transpose it with .T",
        ),
        (
            {"mask": np.zeros((30, 21), bool)},
            r"a mask of a 30x20 sensor must be .*; got shape \(30, 21\)",
        ),
        (
            {"mask": np.zeros((20, 30), np.uint8)},
            r"a mask of a 30x20 .* got uint8 of shape \(20, 30\)",
        ),
    ],
)
def test_wrong_arguments(settings, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        PixelFilter(**({"sensor": (30, 20)} | settings))


def test_a_mask_that_was_loaded_is_the_callers_own(tmp_path):
    """Its file may be written again, and the array be changed."""
    path = tmp_path / "mask.npy"
    save_mask(path, np.ones((2, 3), bool))
    mask = load_mask(path, (3, 2))
    save_mask(path, np.zeros((2, 3), bool))
    mask[1, 2] = False
    assert type(mask) is np.ndarray
    assert mask.tolist() == [[True, True, True], [True, True, False]]
    assert not load_mask(path).any()


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros((2, 0), bool), r"got shape \(2, 0\)"),
        (np.zeros((1, 32_769), bool), r"got shape \(1, 32769\)"),
        (np.zeros(5, bool), r"got shape \(5,\)"),
        ([[True]], "got list"),
    ],
)
def test_what_no_mask_of_any_sensor_can_be_is_refused(tmp_path, mask, message):
    rule = r"a mask must be a bool array of shape \(height, width\), sides in \[1, 32768\]; "
    with pytest.raises(ValueError, match=f"^{rule}{message}$"):
        save_mask(tmp_path / "mask.npy", mask)
    assert not list(tmp_path.iterdir())


# -- which pixels, as a value ----------------------------------------------------------------------


def test_pixels_go_to_another_process_with_their_mask(tmp_path):
    mask = np.random.default_rng(0).random((720, 1280)) < 1e-4
    save_mask(tmp_path / "hot.npy", mask)
    pixels = Pixels((10, 20, 34, 34), True, tmp_path / "hot.npy")
    sent = pickle.dumps(pixels)
    assert len(sent) < 3000
    received = pickle.loads(sent)
    assert received == pixels
    assert hash(received) == hash(pixels)
    assert received.about == pixels.about
    np.testing.assert_array_equal(received.mask_of((1280, 720)), mask)
    assert received.mask.name == str(tmp_path / "hot.npy")


def test_pixels_of_equal_masks_are_equal_wherever_the_masks_are_from(tmp_path):
    mask = np.random.default_rng(0).random((20, 30)) < 0.1
    save_mask(tmp_path / "hot.npy", mask)
    pixels = Pixels(mask=mask)
    assert pixels == Pixels(mask=np.asfortranarray(mask))
    assert pixels == Pixels(mask=str(tmp_path / "hot.npy"))
    assert pixels == replace(pixels, roi=None)
    assert pixels != Pixels(mask=~mask)
    # the same bytes in another shape
    assert Pixels(mask=np.zeros((20, 30), bool)) != Pixels(mask=np.zeros((30, 20), bool))
    assert pixels != Pixels()


def test_pixels_give_the_filter_of_a_camera():
    mask = np.random.default_rng(0).random((20, 30)) < 0.5
    events = random_events(200, sensor=(30, 20))
    kept = Pixels((3, 4, 10, 9), True, mask).filter_of((30, 20))(events)
    assert 0 < len(kept) < len(events)
    np.testing.assert_array_equal(
        kept, PixelFilter((30, 20), (3, 4, 10, 9), mask, crop=True)(events)
    )
    assert Pixels(sensor=(30, 20)).filter_of((30, 20)) is None


def test_about_names_all_that_decides_which_events_count():
    """Results of evaluations contain this value.

    Results of earlier versions are continued only if it is the same.
    """
    mask = np.zeros((2, 3), bool)
    zeros = "b0f66adc83641586"  # sha256 of six zero bytes
    assert hashlib.sha256(bytes(6)).hexdigest().startswith(zeros)
    assert Pixels((0, 0, 2, 2), True, mask, (3, 2)).about == {
        "roi": "0,0,2,2",
        "crop": True,
        "mask": f"3x2 {zeros}",
    }
    assert Pixels(sensor=(3, 2)).about == {"sensor": "3x2"}
    assert Pixels().about == {}


ROI = (10, 4, 40, 40)


@pytest.mark.parametrize(
    ("pixels", "model", "found", "message"),
    [
        (
            Pixels(),
            (40, 40),
            (60, 48),
            "the model is for 40x40; train .*, or cut out a part: `roi` X,Y,40,40",
        ),
        (
            Pixels(),
            (40, 40),
            (40, 39),
            r"a: a .* 40x39 .*, but the model is for 40x40; train one .* train\)$",
        ),
        (
            Pixels((3, 4, 34, 34), True, np.zeros((48, 60), bool)),
            (34, 34),
            (50, 50),
            "but mask is a mask of 60x48$",
        ),
        (
            Pixels((3, 4, 34, 34), True, np.zeros((48, 60), bool), (60, 48)),
            (34, 34),
            (50, 50),
            "but `sensor` says 60x48$",
        ),
        (
            Pixels(mask=np.zeros((48, 60), bool)),
            (34, 34),
            (60, 48),
            "^mask is a mask of 60x48 pixels, but the model is for 34x34; train one",
        ),
        (
            Pixels(sensor=(60, 48)),
            (34, 34),
            (60, 48),
            "^`sensor` says 60x48 pixels, but the model is for 34x34; train one",
        ),
        (
            Pixels(ROI, True),
            (34, 34),
            (60, 48),
            "^`crop`: the model is for 34x34 pixels, got a region of 40x40; give `roi` X,Y,34,34$",
        ),
        (
            Pixels(ROI, True),
            (40, 40),
            None,
            "the camera's pixels, which `crop` needs: give `sensor`$",
        ),
    ],
)
def test_a_camera_that_is_not_the_expected_one_is_refused_with_its_origin(
    pixels, model, found, message
):
    with pytest.raises(ValueError, match=message):
        ModelPixels(pixels, model).filter_of("a", found)


@pytest.mark.parametrize(
    ("pixels", "model", "message"),
    [
        (Pixels(ROI), (40, 40), "^`roi` .* must lie on the sensor of 40x40 pixels"),
        (Pixels(ROI, True, sensor=(45, 60)), (40, 40), "^`roi` .* on the sensor of 45x60 pixels"),
    ],
)
def test_a_region_off_the_expected_camera_is_refused_before_a_source_is_opened(
    pixels, model, message
):
    with pytest.raises(ValueError, match=message):
        ModelPixels(pixels, model)


@pytest.mark.parametrize(
    ("pixels", "model", "message"),
    [
        (
            Pixels(ROI, True),
            (40, 40),
            r"^a\.npy: `roi` .* on the sensor of 45x60 pixels.*, got \(10",
        ),
        (
            Pixels(mask=np.zeros((48, 61), bool)),
            (60, 48),
            r"^mask is a mask of 61x48 pixels, but the model is for 60x48; train one .*, or cut",
        ),
        (
            Pixels((0, 0, 60, 48), False, np.zeros((60, 45), bool)),
            (45, 60),
            r"^`roi` .* on the sensor of 45x60 pixels",
        ),
    ],
)
def test_what_does_not_fit_a_camera_names_the_source_if_one_is_open(pixels, model, message):
    with pytest.raises(ValueError, match=message):
        ModelPixels(pixels, model).filter_of("a.npy", (45, 60))


def test_a_mask_must_have_the_size_that_is_stated():
    with pytest.raises(
        ValueError,
        match=r"^mask: a mask of 3x2 pixels, but the camera's are given as 4x2 \(`sensor`\)$",
    ):
        Pixels(mask=np.zeros((2, 3), bool), sensor=(4, 2))


def test_what_was_left_out_is_told_of_all_sources_together():
    events = random_events(200, sensor=(30, 20))
    wide = random_events(100, sensor=(60, 48), seed=1)
    sees = ModelPixels(Pixels((3, 4, 10, 9), True), (10, 9))
    n_left = 0
    for found, packet in (((30, 20), events), ((60, 48), wide), ((30, 20), events)):
        assert sees.filter_of("a", found) is sees.filter_of("b", found)
        n_left += len(sees.filter_of("a", found)(packet))
    assert 0 < n_left < 100 and sees.summary() == f"{500 - n_left} outside of the region"


def test_of_region_and_mask_each_has_its_own_number():
    mask = np.zeros((20, 30), bool)
    mask[5, 4:6] = True
    sees = ModelPixels(Pixels((3, 4, 10, 9), True, mask), (10, 9))
    assert sees.summary() == ""  # nothing came
    packet = ([1, 2, 3, 4, 5], [4, 5, 6, 2, 3], [5, 5, 5, 5, 3], [1] * 5)
    assert sees.filter_of("a", (30, 20))(packet).tolist() == [(3, 3, 1, 1)]
    assert sees.summary() == "2 outside of the region, 2 of masked pixels"
