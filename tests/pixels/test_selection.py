"""PixelSelection and PixelSelector: what a model is to see, as values, and applied to recordings."""

import hashlib
import pickle

import numpy as np
import pytest

from async_tnt.pixels import PackedMask, PixelFilter, PixelSelection, PixelSelector, load_mask, save_mask
from async_tnt.recordings import open_recording, sample_recordings

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
    selection = PixelSelection.read((10, 20, 34, 34), True, tmp_path / "m.npy")
    mask = load_mask(tmp_path / "m.npy")
    (tmp_path / "m.npy").unlink()
    sent = pickle.loads(pickle.dumps(selection))
    assert sent == selection and hash(sent) == hash(selection) and sent.about == selection.about
    np.testing.assert_array_equal(sent.mask.pixels((346, 260)), mask)


def test_a_mask_of_a_large_sensor_is_small_to_send():
    assert len(pickle.dumps(PackedMask.of(random_mask((1280, 720), 1e-4)))) < 3000


def test_about_and_record_tell_one_selection_from_another():
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
    for told in ("about", "record"):
        assert len({repr(getattr(selection, told)) for selection in selections}) == len(selections)
    assert selections[4].record == {"masked_pixels": 1, "mask_sha256": mask.sha256}
    assert selections[4].about == {"mask": f"34x34 {mask.sha256[:16]}"}
    assert "sensor" in PixelSelection((0, 0, 2, 2), crop=True, sensor=(34, 34)).about


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
    got = np.concatenate(list(selector.select(recording, sensor)))
    expected = PixelFilter((34, 34), (5, 3, 20, 25), mask)
    np.testing.assert_array_equal(got, expected(EVENTS))
    assert 0 < len(got) < len(EVENTS)
    counts = expected.counts
    told = f"{counts.dropped_outside:,} outside of the region, {counts.dropped_masked:,} of masked pixels"
    assert selector.summary() == told


def test_nothing_to_leave_out_is_every_packet_as_it_is():
    selector = PixelSelector(PixelSelection(), (34, 34))
    recording, sensor = selector.open(SAMPLE)
    assert selector.filter_of("a", sensor)(EVENTS) is EVENTS
    assert sum(map(len, selector.select(recording, sensor))) == len(EVENTS) and selector.summary() == ""


def test_a_masks_size_says_the_camera_where_nobody_does(tmp_path):
    np.save(tmp_path / "large.npy", EVENTS)
    mask = PackedMask.of(mask_of((100, 80), (0, 0)), "hot.npy")
    selector = PixelSelector(PixelSelection((3, 4, 34, 34), True, mask), (34, 34))
    assert selector.expected == (100, 80) and selector.open(tmp_path / "large.npy")[1] == (100, 80)
    with pytest.raises(ValueError, match=r"a: a sensor of 50x50 pixels, but hot.npy is a mask of 100x80$"):
        selector.sensor_of("a", (50, 50))


def test_to_be_trained_any_sensor_is_right_and_a_bin_is_of_the_one_given(tmp_path):
    assert PixelSelector(PixelSelection(), None).open_to_learn(SAMPLE)[1] == (34, 34)
    assert PixelSelector(PixelSelection(sensor=(304, 240)), None).open_to_learn(SAMPLE)[1] == (304, 240)
    np.save(tmp_path / "a.npy", EVENTS)
    assert PixelSelector(PixelSelection(), None).open_to_learn(tmp_path / "a.npy")[1] is None
    selector = PixelSelector(PixelSelection((0, 0, 20, 20)), None)
    with pytest.raises(ValueError, match=r"^a.npy: does not say the camera's pixels, which --roi needs: give --sensor"):
        selector.filter_of("a.npy", selector.open_to_learn(tmp_path / "a.npy")[1])


@pytest.mark.parametrize(
    ("settings", "model", "message"),
    [
        ({"crop": True}, (34, 34), "--crop belongs to --roi"),
        ({"roi": (0, 0, 20, 20), "crop": True}, (34, 34), "got a region of 20x20; give --roi X,Y,34,34"),
        ({"roi": (0, 0, 20)}, (34, 34), "must be .x, y, width, height. in whole pixels, got"),
        ({"roi": (0, 0, 20.5, 3)}, None, "must be .x, y, width, height. in whole pixels, got"),
        ({"sensor": (0, 20)}, None, "`sensor` must have sides in"),
        ({"roi": (20, 0, 20, 20)}, (34, 34), "must lie on the sensor of 34x34 pixels"),
        ({"roi": (-1, 0, 20, 20), "sensor": (34, 34)}, None, "must lie on the sensor of 34x34 pixels"),
        ({"roi": (60, 60, 34, 34), "crop": True, "mask": (80, 80)}, (34, 34), "must lie on the sensor of 80x80 pixels"),
        ({"mask": (20, 34)}, (34, 34), r"^hot.npy: a mask of a 34x34 sensor must .* got shape \(34, 20\)"),
        ({"mask": (20, 34), "sensor": (34, 34)}, None, "a mask of 20x34 pixels, but the camera's are given as 34x34"),
    ],
)
def test_what_cannot_be_is_refused_before_the_first_event(settings, model, message):
    if "mask" in settings:
        settings = {**settings, "mask": PackedMask.of(mask_of(settings["mask"]), "hot.npy")}
    with pytest.raises(ValueError, match=message):
        PixelSelector(PixelSelection(**settings), model)


@pytest.mark.parametrize("wrong", [np.zeros((3, 4)), np.zeros(4, bool), [[True]]])
def test_what_is_no_mask_is_refused(wrong, tmp_path):
    with pytest.raises(ValueError, match="must be a bool array of shape"):
        PackedMask.of(wrong)
    np.save(tmp_path / "m.npy", np.array(wrong, float))
    with pytest.raises(ValueError, match=r"m.npy: a mask .*must be a bool array of shape"):
        PackedMask.read(tmp_path / "m.npy")
