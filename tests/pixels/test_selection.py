"""PixelSelection and PixelSelector: what a model is to see, as values, and applied to recordings."""

import dataclasses
import hashlib
import pickle

import numpy as np
import pytest

from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import PackedMask, load_mask, save_mask
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.pixel_selector import PixelSelector

SAMPLE = sample_recordings()[3]
EVENTS = open_recording(SAMPLE).read()


def mask_of(size, *pixels):
    mask = np.zeros(size[::-1], bool)
    for x, y in pixels:
        mask[y, x] = True
    return mask


def random_mask(size, share, seed=0):
    return np.random.default_rng(seed).random(size[::-1]) < share


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


def test_a_selection_goes_to_another_process_with_its_mask(tmp_path):
    save_mask(tmp_path / "m.npy", random_mask((346, 260), 0.001))
    selection = PixelSelection((10, 20, 34, 34), True, tmp_path / "m.npy")
    mask = load_mask(tmp_path / "m.npy")
    (tmp_path / "m.npy").unlink()
    sent = pickle.loads(pickle.dumps(selection))
    assert sent == selection and hash(sent) == hash(selection) and sent.about == selection.about
    np.testing.assert_array_equal(sent.mask.pixels((346, 260)), mask)


def test_a_mask_of_a_large_sensor_is_small_to_send():
    assert len(pickle.dumps(PackedMask.of(random_mask((1280, 720), 1e-4)))) < 3000


def test_about_and_record_distinguish_selections():
    mask, other = (PackedMask.of(mask_of((34, 34), pixel)) for pixel in ((1, 2), (2, 1)))
    selections = [
        PixelSelection(),
        PixelSelection((0, 0, 20, 20)),
        PixelSelection((0, 0, 20, 21)),
        PixelSelection((0, 0, 20, 20), crop=True),
        PixelSelection(mask=mask),
        PixelSelection(mask=other),
        PixelSelection((0, 0, 20, 20), mask=mask),
    ]
    assert selections[0].about == selections[0].record == {}
    for form in ("about", "record"):
        assert len({repr(getattr(selection, form)) for selection in selections}) == len(selections)
    assert selections[4].record == {"masked_pixels": 1, "mask_sha256": mask.sha256}
    assert selections[4].about == {"mask": f"34x34 {mask.sha256[:16]}"}
    assert "sensor" in PixelSelection((0, 0, 2, 2), crop=True, sensor=(34, 34)).about


def test_a_sensor_that_repeats_the_size_of_the_mask_decides_nothing():
    mask = PackedMask.of(mask_of((60, 48), (1, 2)))
    alone, repeated = (PixelSelection((0, 0, 9, 9), True, mask, sensor) for sensor in (None, (60, 48)))
    assert alone.about == repeated.about and "sensor" not in alone.about
    one, other = (PixelSelection((0, 0, 9, 9), True, sensor=sensor) for sensor in ((60, 48), (61, 48)))
    assert one.about != other.about  # which recordings are of the camera, and which are an error


def test_a_mask_may_be_an_array_or_a_file(tmp_path):
    mask = random_mask((34, 34), 0.1)
    save_mask(tmp_path / "m.npy", mask)
    packed = PackedMask.of(mask)
    for given in (mask, packed, tmp_path / "m.npy", str(tmp_path / "m.npy")):
        assert PixelSelection(mask=given).mask == packed
    assert PixelSelection(mask=tmp_path / "m.npy").mask.name == str(tmp_path / "m.npy")
    again = dataclasses.replace(PixelSelection((1, 2, 3, 4), 1, mask), sensor=(34, 34))
    assert again == PixelSelection((1, 2, 3, 4), True, packed, (34, 34)) and again.crop is True
    for wrong in ([[True]], 5, b"m.npy"):  # bytes are no path
        with pytest.raises(TypeError, match=r"`mask` must be a bool array, a .* or a PackedMask, got "):
            PixelSelection(mask=wrong)
    with pytest.raises(dataclasses.FrozenInstanceError):
        again.crop = False


def test_equal_regions_are_equal_whatever_they_are_written_in():
    one, other = (
        PixelSelection((0, 1, 20, 20), sensor=(34, 34)),
        PixelSelection(np.array([0, 1, 20, 20]), sensor=[34, 34]),
    )
    assert one == other and hash(one) == hash(other) and one.about == other.about


def test_a_recording_is_opened_and_selected_as_by_a_filter():
    mask = random_mask((34, 34), 0.3)
    selector = PixelSelector(PixelSelection((5, 3, 20, 25), mask=PackedMask.of(mask)), (34, 34))
    recording, sensor = selector.open(SAMPLE)
    got = np.concatenate(list(map(selector.filter_of("a", sensor), recording)))
    expected = PixelFilter((34, 34), (5, 3, 20, 25), mask)
    np.testing.assert_array_equal(got, expected(EVENTS))
    assert 0 < len(got) < len(EVENTS)
    counts = expected.counts
    summary = f"{counts.dropped_outside:,} outside of the region, {counts.dropped_masked:,} of masked pixels"
    assert selector.summary() == summary


def test_nothing_to_leave_out_is_every_packet_as_it_is():
    selector = PixelSelector(PixelSelection(), (34, 34))
    recording, sensor = selector.open(SAMPLE)
    assert selector.filter_of("a", sensor)(EVENTS) is EVENTS and recording.n_events == len(EVENTS)
    assert selector.summary() == selector.nothing_left() == ""


def test_the_size_of_a_mask_names_the_camera(tmp_path):
    np.save(tmp_path / "large.npy", EVENTS)
    mask = PackedMask.of(mask_of((100, 80), (0, 0)), "hot.npy")
    selector = PixelSelector(PixelSelection((3, 4, 34, 34), True, mask), (34, 34))
    assert selector.expected == (100, 80) and selector.open(tmp_path / "large.npy")[1] == (100, 80)
    with pytest.raises(ValueError, match=r"a: a sensor of 50x50 pixels, but hot.npy is a mask of 100x80$"):
        selector.sensor_of("a", (50, 50))


def test_where_nobody_says_the_sensor_the_option_that_needs_it_is_named():
    selector = PixelSelector(PixelSelection((0, 0, 20, 20)), None)
    with pytest.raises(ValueError, match=r"^a.npy: does not say the camera's pixels, which --roi needs: give --sensor"):
        selector.filter_of("a.npy", None)


@pytest.mark.parametrize(
    ("settings", "model", "message"),
    [
        ({"crop": True}, (34, 34), "--crop belongs to --roi"),
        ({"roi": (0, 0, 20, 20), "crop": True}, (34, 34), "got a region of 20x20; give --roi X,Y,34,34"),
        ({"sensor": (0, 20)}, None, "`sensor` must have sides in"),
        ({"roi": (20, 0, 20, 20)}, (34, 34), "must lie on the sensor of 34x34 pixels"),
        ({"roi": (-1, 0, 20, 20)}, None, "must lie on the sensor, x and y at least 0"),
        (
            {"sensor": (60, 48)},
            (40, 40),
            "--sensor says 60x48 pixels, but .* for 40x40: give --roi X,Y,40,40 --crop too",
        ),
        ({"sensor": (30, 48)}, (40, 40), "--sensor says 30x48 pixels, but the model is for 40x40: train one for this"),
        (
            {"mask": (60, 48)},
            (40, 40),
            "^hot.npy: a mask of a 60x48 camera, but the model is for 40x40 pixels: give --roi "
            "X,Y,40,40 --crop too, or give the mask of a 40x40 camera$",
        ),
        ({"mask": (30, 48)}, (40, 40), "^hot.npy: a mask of a 30x48 .* 40x40 pixels: give the mask of a 40x40 camera$"),
        ({"roi": (60, 60, 34, 34), "crop": True, "mask": (80, 80)}, (34, 34), "must lie on the sensor of 80x80 pixels"),
        ({"mask": (20, 34)}, (34, 34), "^hot.npy: a mask of a 20x34 camera, but the model is for 34x34 pixels"),
        ({"mask": (20, 34)}, (34, 20), "the mask of a 34x20 camera; or transpose it with .T$"),
        ({"mask": (20, 34), "sensor": (34, 34)}, None, "a mask of 20x34 pixels, but the camera's are given as 34x34"),
    ],
)
def test_a_wrong_selection_is_refused_before_the_first_event(settings, model, message):
    if "mask" in settings:
        settings = {**settings, "mask": PackedMask.of(mask_of(settings["mask"]), "hot.npy")}
    with pytest.raises(ValueError, match=message):
        PixelSelector(PixelSelection(**settings), model)


@pytest.mark.parametrize("wrong", [np.zeros((3, 4)), np.zeros(4, bool), np.zeros((4, 0), bool)])
def test_what_is_no_mask_is_refused(wrong, tmp_path):
    with pytest.raises(ValueError, match="must be a bool array of shape"):
        PackedMask.of(wrong)
    np.save(tmp_path / "m.npy", np.array(wrong, float))
    with pytest.raises(ValueError, match=r"m.npy: a mask .*must be a bool array of shape"):
        PackedMask.of(tmp_path / "m.npy")


def bin_within_34(folder):
    write_nmnist(folder / "inside.bin", EVENTS)
    return folder / "inside.bin"


@pytest.mark.parametrize("named_by", ["sensor", "mask"])
def test_a_bin_is_of_the_camera_that_is_named(named_by, tmp_path):
    path = bin_within_34(tmp_path)
    named = {"sensor": {"sensor": (60, 48)}, "mask": {"mask": mask_of((60, 48), (59, 47))}}[named_by]
    for settings, model in (({"roi": (2, 1, 20, 20), "crop": True}, (20, 20)), ({}, (60, 48))):
        selector = PixelSelector(PixelSelection(**settings, **named), model)
        recording, sensor = selector.open(path, strict=True)
        assert sensor == (60, 48) and recording.sensor is None
        kept = np.concatenate(list(map(selector.filter_of("a", sensor), recording)))
        roi = settings.get("roi")
        np.testing.assert_array_equal(kept, PixelFilter((60, 48), roi, crop=roi is not None)(EVENTS))
    with pytest.raises(ValueError, match="a sensor of 34x34 pixels, but the model is for 60x48"):
        PixelSelector(PixelSelection(), (60, 48)).open(path)  # nothing names it, and all its events are on N-MNIST's


def test_an_event_off_the_named_camera_names_the_origin_of_its_size(tmp_path):
    write_nmnist(tmp_path / "a.bin", np.array([(1, 200, 3, 1)], EVENTS.dtype), sensor=None)
    selection = PixelSelection((0, 0, 34, 34), True, PackedMask.of(mask_of((45, 45)), "m45.npy"))
    selector = PixelSelector(selection, (34, 34))
    recording, sensor = selector.open(tmp_path / "a.bin", strict=True)
    with pytest.raises(ValueError) as caught:
        selector.check_silent(recording, "a.bin", sensor)
    assert str(caught.value) == "a.bin: `x` must be in [0, 45), got 200 at event 0; m45.npy is a mask of 45x45 pixels"


@pytest.mark.parametrize(
    ("camera", "part"), [((60, 48), True), ((40, 40), True), ((39, 90), False), ((90, 39), False), ((20, 20), False)]
)
def test_a_part_is_offered_of_a_camera_that_has_one(camera, part):
    selector = PixelSelector(PixelSelection(), (40, 40))
    if camera == (40, 40):
        assert selector.sensor_of("a", camera) == camera
        return
    with pytest.raises(ValueError, match="but the model is for 40x40; train one for this camera") as caught:
        selector.sensor_of("a", camera)
    assert ("or cut out a part: --roi X,Y,40,40 --crop" in str(caught.value)) == part


def test_nothing_left_counts_from_a_given_moment():
    selector = PixelSelector(PixelSelection((0, 0, 4, 4), mask=np.ones((34, 34), bool)), (34, 34))
    select = selector.filter_of("", (34, 34))
    assert selector.nothing_left() == ""  # nothing came
    select(([1, 2, 3], [1, 2, 20], [1, 2, 20], [1, 1, 1]))
    before = selector.counts
    assert selector.nothing_left() == "no events are left: 1 outside of the region, 2 of masked pixels"
    assert selector.nothing_left(before) == selector.summary(before) == ""
    select(([4], [9], [9], [1]))
    assert selector.nothing_left(before) == "no events are left: 1 outside of the region, 0 of masked pixels"
