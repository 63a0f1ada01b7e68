"""The filter equals its NumPy twin and counts what it drops; which pixels a model sees, as values
that can be sent."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import nasty_streams

import async_tnt
from async_tnt.sources.pixels.pixel_filter import PixelCounts, PixelFilter
from async_tnt.sources.pixels.pixel_masks import PackedMask
from async_tnt.sources.pixels.pixel_selection import PixelSelection, PixelSelector

SENSORS = [(34, 34), (7, 5), (2, 2), (300, 200), (40, 1)]


def twin(events, sensor, roi, mask, crop):
    """The definition, in NumPy: kept events, and how many were masked and outside."""
    left, top, width, height = roi or (0, 0, *sensor)
    x, y = events["x"].astype(int), events["y"].astype(int)
    inside = (x >= left) & (x < left + width) & (y >= top) & (y < top + height)
    masked = inside & (mask[y, x] if mask is not None else False)
    kept = events[inside & ~masked].copy()
    if crop:
        kept["x"] -= left
        kept["y"] -= top
    return kept, int(masked.sum()), int((~inside).sum())


@st.composite
def filters(draw):
    width, height = sensor = draw(st.sampled_from(SENSORS))
    roi = None
    if draw(st.booleans()):
        left, top = draw(st.integers(0, width - 1)), draw(st.integers(0, height - 1))
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
            r"`roi` .* must lie on the sensor of 30x20 .*, x and y at least 0, .* got \(-1, 0, 3, 2\)",
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
            {"mask": np.zeros((20, 30), np.uint8)},
            r"a mask of a 30x20 .* got uint8 of shape \(20, 30\)",
        ),
    ],
)
def test_wrong_arguments(settings, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        PixelFilter(**({"sensor": (30, 20)} | settings))


# -- selections of pixels --------------------------------------------------------------------------


def test_a_selection_goes_to_another_process_with_its_mask():
    mask = np.random.default_rng(0).random((720, 1280)) < 1e-4
    selection = PixelSelection((10, 20, 34, 34), True, PackedMask.of(mask, "hot.npy"))
    assert selection == PixelSelection(
        (10, 20, 34, 34), True, PackedMask.of(np.asfortranarray(mask))
    )
    sent = pickle.dumps(selection)
    assert len(sent) < 3000
    received = pickle.loads(sent)
    assert (
        received == selection
        and hash(received) == hash(selection)
        and received.about == selection.about
    )
    np.testing.assert_array_equal(received.mask.pixels((1280, 720)), mask)
    assert received.mask.name == "hot.npy"


ROI = (10, 4, 40, 40)
MASK = PackedMask.of(np.zeros((48, 60), bool), "hot.npy")


@pytest.mark.parametrize(
    ("selection", "model", "found", "message"),
    [
        (
            PixelSelection(),
            (40, 40),
            (60, 48),
            "the model is for 40x40; train .*, or cut out a part: `roi` X,Y,40,40",
        ),
        (
            PixelSelection(),
            (40, 40),
            (40, 39),
            r"a: a .* 40x39 .*, but the model is for 40x40; train one .* train\)$",
        ),
        (
            PixelSelection((3, 4, 34, 34), True, MASK),
            (34, 34),
            (50, 50),
            "but hot.npy is a mask of 60x48$",
        ),
        (
            PixelSelection(ROI, True),
            (40, 40),
            None,
            "the camera's pixels, which `crop` needs: give `sensor`$",
        ),
    ],
)
def test_a_camera_that_is_not_the_expected_one_is_refused_with_its_origin(
    selection, model, found, message
):
    with pytest.raises(ValueError, match=message):
        PixelSelector(selection, model).filter_of("a", found)
