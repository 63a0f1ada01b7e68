"""The filter equals its NumPy twin and counts what it drops."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, nasty_streams, random_events

import async_tnt
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelCounts, PixelFilter

SENSORS = [(34, 34), (7, 5), (2, 2), (1280, 720), (40, 1)]


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


def test_the_borders_of_a_region_by_hand():
    x, y = np.meshgrid(np.arange(10), np.arange(8))
    events = events_of(np.arange(80), x.ravel(), y.ravel(), np.ones(80))
    kept = PixelFilter((10, 8), roi=(2, 3, 4, 2))(events)
    assert {(int(x), int(y)) for _, x, y, _ in kept} == {(x, y) for x in (2, 3, 4, 5) for y in (3, 4)}
    assert PixelFilter((10, 8), roi=(9, 7, 1, 1), crop=True)(events).tolist() == [(79, 0, 0, 1)]


@pytest.mark.parametrize("nothing", [None, (), [], np.empty(0), ([], [], [], []), random_events(0)])
def test_events_may_be_in_any_form(nothing):
    got = PixelFilter((34, 34))(nothing)
    assert got.size == 0 and got.dtype == async_tnt.EVENT_DTYPE
    assert PixelFilter((34, 34))((5, 1, 2, -1)).tolist() == [(5, 1, 2, 0)]


def test_a_packet_stays_as_it_is_and_is_the_callers():
    pixel_filter = PixelFilter((34, 34))
    first = pixel_filter(random_events(100, seed=1))
    before = first.tobytes()
    pixel_filter(random_events(100, seed=2))
    assert first.tobytes() == before
    first["x"] = 0


def test_in_front_of_a_stream_it_leaves_out_pixels_and_crops():
    events = open_recording(sample_recordings()[3]).read()
    shifted, mask = events.copy(), np.zeros((260, 346), bool)
    shifted["x"] += 100
    shifted["y"] += 60
    mask[75:78, 115:118] = True
    pixel_filter = PixelFilter((346, 260), roi=(100, 60, 34, 34), mask=mask, crop=True)
    got = list(async_tnt.stream(map(pixel_filter, np.array_split(shifted, 9)), "digits", start_us=0))
    kept, n_masked, _ = twin(events, (34, 34), None, mask[60:94, 100:134], False)
    assert n_masked > 0
    expected = list(async_tnt.stream([kept], "digits", start_us=0))
    assert [d.logits.tobytes() for d in got] == [d.logits.tobytes() for d in expected] != []


def test_a_mask_may_be_a_file_and_later_changes_of_an_array_change_nothing(tmp_path):
    mask = np.random.default_rng(0).random((20, 30)) < 0.2
    np.save(tmp_path / "mask.npy", mask)
    events = random_events(1000, sensor=(30, 20))
    kept = twin(events, (30, 20), None, mask, False)[0].tobytes()
    of_array = PixelFilter((30, 20), mask=mask)
    mask[:] = True
    of_files = [PixelFilter((30, 20), mask=path) for path in (tmp_path / "mask.npy", str(tmp_path / "mask.npy"))]
    for pixel_filter in (of_array, *of_files):
        assert pixel_filter(events).tobytes() == kept


def test_an_invalid_packet_counts_nothing():
    pixel_filter = PixelFilter((34, 34))
    with pytest.raises(ValueError, match=r"^`x` must be in \[0, 34\), got 34 at event 1$"):
        pixel_filter(([1, 2], [3, 34], [0, 0], [1, 1]))
    assert pixel_filter.counts == PixelCounts()


SENSOR_RULE = r"`sensor` must be \(width, height\) in whole pixels, got "
MASK_RULE = r"a mask of a 30x20 sensor must be a bool array of shape \(20, 30\), \(height, width\); got "
ROI_RULE = r"`roi` \(x, y, width, height\) must lie on the sensor of 30x20 pixels, got "
NO_ROI = r"`roi` \(x, y, width, height\) must lie on the sensor, x and y at least 0, and hold at least one pixel, got "
WHOLE = r"`roi` must be \(x, y, width, height\) in whole pixels, got "


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sensor": (30,)}, SENSOR_RULE + r"\(30,\)"),
        ({"sensor": (30.5, 2)}, SENSOR_RULE + r"\(30.5, 2\)"),
        ({"sensor": (True, 20)}, SENSOR_RULE + r"\(True, 20\)"),
        ({"sensor": (30, 40_000)}, r"`sensor` must have sides in \[1, 32768\] pixels, got \(30, 40000\)"),
        ({"roi": (0, 0, 31, 20)}, ROI_RULE + r"\(0, 0, 31, 20\)"),
        ({"roi": (5, 19, 3, 2)}, ROI_RULE + r"\(5, 19, 3, 2\)"),
        ({"roi": (-1, 0, 3, 2)}, NO_ROI + r"\(-1, 0, 3, 2\)"),
        ({"roi": (5, 5, 3, 0)}, NO_ROI + r"\(5, 5, 3, 0\)"),
        ({"roi": (5, 5, 3)}, WHOLE + r"\(5, 5, 3\)"),
        ({"roi": (5, 5, 3.0, 1)}, WHOLE + r"\(5, 5, 3.0, 1\)"),
        ({"roi": 5}, WHOLE + "5"),
        (
            {"crop": True},
            r"--crop belongs to --roi \(in Python, `crop` to `roi`\): the region that becomes the sensor",
        ),
        ({"mask": np.zeros((30, 20), bool)}, MASK_RULE + r"shape \(30, 20\); transpose it with .T"),
        ({"mask": np.zeros((20, 31), bool)}, MASK_RULE + r"shape \(20, 31\)"),
        ({"mask": np.zeros((20, 30), np.uint8)}, MASK_RULE + r"uint8 of shape \(20, 30\)"),
        ({"mask": [[True]]}, MASK_RULE + "list"),
    ],
)
def test_wrong_arguments(settings, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        PixelFilter(**({"sensor": (30, 20)} | settings))


def test_the_representation():
    mask = np.zeros((260, 346), bool)
    mask[3, 4] = True
    expected = "PixelFilter((346, 260), roi=(1, 2, 30, 40), 1 pixels masked, crop=True)"
    assert repr(PixelFilter((346, 260), (1, 2, 30, 40), mask, crop=True)) == expected
