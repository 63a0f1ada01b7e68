"""Which pixels a model sees: as values that can be compared and sent, and applied to recordings."""

import dataclasses
import hashlib
import pickle

import numpy as np
import pytest

from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import PackedMask, save_mask
from async_tnt.sources.pixel_selection import PixelSelection, difference
from async_tnt.sources.pixel_selector import PixelSelector

SAMPLE = sample_recordings()[3]
EVENTS = open_recording(SAMPLE).read()


def mask_of(size, *pixels):
    mask = np.zeros(size[::-1], bool)
    for x, y in pixels:
        mask[y, x] = True
    return mask


def random_mask(size, share):
    return np.random.default_rng(0).random(size[::-1]) < share


@pytest.mark.parametrize("size", [(1, 1), (34, 34), (7, 13), (346, 260)])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_a_packed_mask_is_the_mask(size, share):
    mask = random_mask(size, share)
    packed = PackedMask.of(np.asfortranarray(mask))
    np.testing.assert_array_equal(packed.pixels(size), mask)
    assert packed.size == size and packed.n_pixels == mask.sum()
    assert packed.sha256 == hashlib.sha256(mask.tobytes()).hexdigest()


def test_masks_are_equal_by_their_pixels_and_size():
    mask = mask_of((6, 4), (1, 2))
    assert PackedMask.of(mask, "a.npy") == PackedMask.of(mask.copy(), "b.npy")
    assert PackedMask.of(mask) != PackedMask.of(mask_of((6, 4), (2, 1)))
    assert PackedMask.of(mask) != PackedMask.of(mask.reshape(6, 4))  # the same bytes, another sensor


def test_a_selection_goes_to_another_process_with_its_mask_which_may_be_an_array_or_a_file(tmp_path):
    mask = random_mask((1280, 720), 1e-4)
    save_mask(tmp_path / "m.npy", mask)
    packed = PackedMask.of(mask)
    for given in (mask, packed, tmp_path / "m.npy", str(tmp_path / "m.npy")):
        selection = PixelSelection((10, 20, 34, 34), True, given)
        assert selection == PixelSelection(np.array([10, 20, 34, 34]), 1, packed) and selection.crop is True
    assert selection.mask.name == str(tmp_path / "m.npy")
    (tmp_path / "m.npy").unlink()
    sent = pickle.dumps(selection)
    assert len(sent) < 3000
    received = pickle.loads(sent)
    assert received == selection and hash(received) == hash(selection) and received.about == selection.about
    np.testing.assert_array_equal(received.mask.pixels((1280, 720)), mask)
    assert dataclasses.replace(selection, sensor=[1280, 720]).sensor == (1280, 720)
    with pytest.raises(dataclasses.FrozenInstanceError):
        selection.crop = False
    for wrong in ([[True]], 5, b"m.npy"):  # bytes are no path
        with pytest.raises(TypeError, match=r"`mask` must be a bool array, a .* or a PackedMask, got "):
            PixelSelection(mask=wrong)


ROI = (10, 4, 40, 40)
MASK, OTHER = (PackedMask.of(mask_of((60, 48), pixel), "hot.npy") for pixel in ((4, 3), (3, 4)))
SELECTIONS = [
    PixelSelection(),
    PixelSelection(ROI),
    PixelSelection((0, 0, 40, 40)),
    PixelSelection(ROI, crop=True),
    PixelSelection(mask=MASK),
    PixelSelection(mask=OTHER),
    PixelSelection(ROI, crop=True, mask=MASK),
]


def test_about_and_record_tell_selections_apart():
    for form in ("about", "record"):
        assert len({repr(getattr(selection, form)) for selection in SELECTIONS}) == len(SELECTIONS)
    assert SELECTIONS[0].about == SELECTIONS[0].record == {}
    assert SELECTIONS[4].record == {"masked_pixels": 1, "mask_sha256": MASK.sha256}
    assert SELECTIONS[4].about == {"mask": f"60x48 {MASK.sha256[:16]}"}
    assert SELECTIONS[3].about == {"roi": "10,4,40,40", "crop": True}
    # a sensor decides which recordings are of the camera; one that repeats the size of the mask decides nothing
    assert PixelSelection(ROI, True, sensor=(60, 48)).about == SELECTIONS[3].about | {"sensor": "60x48"}
    assert PixelSelection(ROI, True, MASK, (60, 48)).about == SELECTIONS[6].about


def trained_with(selection):
    return {"data": {"pixels": {**selection.record, "camera": [60, 48]}}}


@pytest.mark.parametrize("trained", SELECTIONS[1:])
def test_the_selection_of_the_training_is_silent_and_every_other_one_is_reported(trained):
    for given in SELECTIONS:
        assert (difference(trained_with(trained), given) == "") == (given == trained)
    assert difference(trained_with(trained), dataclasses.replace(trained, sensor=(60, 48))) == ""


def test_the_difference_names_both_selections():
    was = f"trained with --roi 10,4,40,40 --crop --mask of 1 pixels ({MASK.sha256[:16]})"
    assert difference(trained_with(SELECTIONS[6]), SELECTIONS[0]) == f"{was}, but now it is all pixels"
    roi = "--roi 10,4,40,40 --crop"
    assert difference(trained_with(SELECTIONS[6]), SELECTIONS[3]) == f"{was}, but now it is {roi}"
    camera = difference(trained_with(SELECTIONS[3]), PixelSelection(ROI, True, sensor=(70, 48)))
    assert camera == f"trained with {roi} of a 60x48 camera, but now it is {roi} of a 70x48 camera"


@pytest.mark.parametrize("pixels", [None, {}, {"roi": 5, "camera": "60x48"}])
def test_a_record_without_a_selection_differs_from_none(pixels):
    for record in ({}, {"data": None}, {"data": "N-MNIST"}, {"data": {}}):
        assert difference(record, SELECTIONS[6]) == ""
    assert difference({"data": {"pixels": pixels}}, PixelSelection()) == ""


def test_a_recording_is_opened_and_selected_as_by_a_filter():
    mask = random_mask((34, 34), 0.3)
    selector = PixelSelector(PixelSelection((5, 3, 20, 25), mask=mask), (34, 34))
    recording, sensor = selector.open(SAMPLE)
    got = np.concatenate(list(map(selector.filter_of("a", sensor), recording)))
    expected = PixelFilter((34, 34), (5, 3, 20, 25), mask)
    np.testing.assert_array_equal(got, expected(EVENTS))
    assert 0 < len(got) < len(EVENTS) and selector.counts == expected.counts
    n_outside, n_masked = expected.counts.dropped_outside, expected.counts.dropped_masked
    assert selector.summary() == f"{n_outside:,} outside of the region, {n_masked:,} of masked pixels"


def test_nothing_to_leave_out_is_every_packet_as_it_is():
    selector = PixelSelector(PixelSelection(), (34, 34))
    recording, sensor = selector.open(SAMPLE)
    assert selector.filter_of("a", sensor)(EVENTS) is EVENTS and recording.n_events == len(EVENTS)
    assert selector.summary() == selector.nothing_left() == ""


@pytest.mark.parametrize(
    ("settings", "model", "message"),
    [
        ({"crop": True}, (34, 34), "--crop belongs to --roi"),
        ({"roi": (0, 0, 20, 20), "crop": True}, (34, 34), "got a region of 20x20; give --roi X,Y,34,34"),
        ({"sensor": (0, 20)}, (34, 34), "`sensor` must have sides in"),
        ({"roi": (20, 0, 20, 20)}, (34, 34), "must lie on the sensor of 34x34 pixels"),
        ({"roi": (-1, 0, 20, 20)}, (34, 34), "must lie on the sensor, x and y at least 0"),
        ({"sensor": (60, 48)}, (40, 40), "--sensor says 60x48 .* for 40x40: give --roi X,Y,40,40 --crop too, or train"),
        ({"sensor": (30, 48)}, (40, 40), "--sensor says 30x48 pixels, but the model is for 40x40: train one for this"),
        (
            {"mask": MASK},
            (40, 40),
            "^hot.npy: a mask of a 60x48 camera, .*give --roi X,Y,40,40 --crop too, or give the",
        ),
        ({"mask": MASK}, (61, 40), "^hot.npy: a mask of a 60x48 .* 61x40 pixels: give the mask of a 61x40 camera$"),
        ({"mask": MASK}, (48, 60), "the mask of a 48x60 camera; or transpose it with .T$"),
        ({"roi": (60, 8, 40, 40), "crop": True, "mask": MASK}, (40, 40), "must lie on the sensor of 60x48 pixels"),
        ({"mask": MASK, "sensor": (34, 34)}, (34, 34), "a mask of 60x48 pixels, but the camera's are given as 34x34"),
        ({"mask": np.zeros(4, bool)}, (34, 34), "must be a bool array of shape"),
    ],
)
def test_a_wrong_selection_is_refused_before_the_first_event(settings, model, message):
    with pytest.raises(ValueError, match=message):
        PixelSelector(PixelSelection(**settings), model)


@pytest.mark.parametrize(
    ("selection", "model", "size"),
    [
        (PixelSelection((2, 1, 20, 20), True, sensor=(60, 48)), (20, 20), (60, 48)),
        (PixelSelection((2, 1, 20, 20), True, MASK), (20, 20), (60, 48)),
        (PixelSelection((2, 1, 20, 20), True), (20, 20), (34, 34)),  # N-MNIST's
        (PixelSelection(sensor=(60, 48)), (60, 48), (60, 48)),
        (PixelSelection(), (60, 48), (60, 48)),
    ],
)
def test_a_recording_that_states_no_sensor_is_of_the_given_camera_or_else_of_the_models(
    selection, model, size, tmp_path
):
    write_nmnist(tmp_path / "a.bin", EVENTS)
    np.save(tmp_path / "a.npy", EVENTS)
    for name in ("a.bin", "a.npy") if size != (34, 34) else ("a.bin",):
        selector = PixelSelector(selection, model)
        recording, sensor = selector.open(tmp_path / name, strict=True)
        assert sensor == recording.sensor == size
        kept = np.concatenate(list(map(selector.filter_of("a", sensor), recording)))
        mask = None if selection.mask is None else selection.mask.pixels(size)
        np.testing.assert_array_equal(kept, PixelFilter(size, selection.roi, mask, crop=selection.crop)(EVENTS))


@pytest.mark.parametrize(
    ("selection", "model", "found", "message"),
    [
        (PixelSelection(), (40, 40), (60, 48), "the model is for 40x40; train .*, or cut out a part: --roi X,Y,40,40"),
        (PixelSelection(), (40, 40), (40, 39), r"a: a .* 40x39 .*, but the model is for 40x40; train one .* --help\)$"),
        (PixelSelection((3, 4, 34, 34), True, MASK), (34, 34), (50, 50), "but hot.npy is a mask of 60x48$"),
        (PixelSelection((3, 4, 34, 34), True, sensor=(60, 48)), (34, 34), (50, 50), "but --sensor says 60x48$"),
        (PixelSelection(ROI, True), (40, 40), None, "the camera's pixels, which --crop needs: give --sensor WxH$"),
    ],
)
def test_a_camera_that_is_not_the_expected_one_is_refused_with_its_origin(selection, model, found, message):
    with pytest.raises(ValueError, match=message):
        PixelSelector(selection, model).sensor_of("a", found)


@pytest.mark.parametrize(
    ("selection", "origin"),
    [
        (PixelSelection(ROI, True, MASK), "hot.npy is a mask of 60x48 pixels"),
        (PixelSelection(ROI, True, sensor=(60, 48)), "--sensor says 60x48 pixels"),
    ],
)
def test_an_event_off_the_assumed_camera_names_the_origin_of_its_size(selection, origin, tmp_path):
    write_nmnist(tmp_path / "a.bin", np.array([(1, 200, 3, 1)], EVENTS.dtype), sensor=None)
    selector = PixelSelector(selection, (40, 40))
    recording, sensor = selector.open(tmp_path / "a.bin", strict=True)
    with pytest.raises(ValueError) as caught:
        selector.check_events(recording, "a.bin", sensor)
    assert str(caught.value) == f"a.bin: `x` must be in [0, 60), got 200 at event 0; {origin}"


def test_nothing_left_counts_from_a_given_moment():
    selector = PixelSelector(PixelSelection((0, 0, 4, 4), mask=mask_of((34, 34), (1, 1), (2, 2))), (34, 34))
    select = selector.filter_of("", (34, 34))
    assert selector.nothing_left() == ""  # nothing came
    select(([1, 2, 3], [1, 2, 20], [1, 2, 20], [1, 1, 1]))
    assert selector.nothing_left() == "no events are left: 1 outside of the region, 2 of masked pixels"
    select(([4], [3], [3], [1]))
    before = selector.counts
    assert selector.nothing_left() == selector.nothing_left(before) == selector.summary(before) == ""
    select(([5], [9], [9], [1]))
    assert selector.nothing_left(before) == "no events are left: 1 outside of the region, 0 of masked pixels"
    assert selector.nothing_left() == ""  # one event was left, earlier
