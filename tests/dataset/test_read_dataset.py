"""Class folders -> recordings of one sensor: what they state, what is left out, and what is an error."""

import re

import numpy as np
import pytest
from dataset.gestures import bar, write
from made import events_of

from async_tnt.sources.pixel_selection import PackedMask, PixelSelection
from async_tnt.training.dataset import read_dataset

SIZE = (64, 64)


def fill(folder, counts, seed=0, sensor=SIZE, suffix=".npz", first=0):
    for name, n in counts.items():
        for k in range(first, first + n):
            write(folder / name / f"{k:02d}{suffix}", bar(name, 100 * seed + k, side=64, n=300), sensor=sensor)
    return folder


def mask_of(*pixels, size=SIZE):
    mask = np.zeros(size[::-1], bool)
    for x, y in pixels:
        mask[y, x] = True
    return PackedMask.of(mask)


@pytest.mark.parametrize("crop", [False, True])
@pytest.mark.parametrize(("sensor", "source"), [(None, "flat/00.npz"), (SIZE, "--sensor")])
def test_recordings_of_two_sensors_are_an_error_that_names_both(sensor, source, crop, tmp_path):
    fill(tmp_path, {"upright": 6, "flat": 6})
    write(tmp_path / "flat" / "99.npz", bar("flat", 77, side=30), sensor=(80, 60))
    pixels = PixelSelection((0, 0, 30, 30), True, None, sensor) if crop else PixelSelection(sensor=sensor)
    message = f"all recordings must be of one sensor, got 64x64 ({source}) and 80x60 (flat/99.npz)"
    with pytest.raises(ValueError, match=re.escape(message)):
        read_dataset(tmp_path, pixels=pixels)


def test_recordings_that_do_not_state_a_sensor_have_that_of_the_others(tmp_path):
    """Also those that were read before the first one that states it."""
    fill(tmp_path, {"upright": 2, "flat": 2}, suffix=".npy")
    fill(tmp_path, {"upright": 1, "flat": 1}, suffix=".npz", first=2)
    write(tmp_path / "flat" / "large.csv", events_of([5, 9], [3, 64], [1, 2], [1, 1]))
    for pixels in (PixelSelection(), PixelSelection(mask=mask_of((1, 1))), PixelSelection(sensor=SIZE)):
        dataset = read_dataset(tmp_path, pixels=pixels)
        line = "flat/large.csv: every event must lie on the 64x64 sensor, got x = 64 at event 1."
        assert dataset.left_out == (line,) and dataset.camera == dataset.sensor == SIZE
        assert len(dataset.recordings) == 6
    cropped = read_dataset(tmp_path, pixels=PixelSelection((0, 0, 60, 64), True))
    assert (cropped.camera, cropped.sensor) == (SIZE, (60, 64)) and cropped.recordings.x.max() < 60


def test_a_sensor_that_nothing_states_is_asked_for(tmp_path):
    fill(tmp_path, {"upright": 2, "flat": 2}, suffix=".csv")
    for pixels in (PixelSelection(), PixelSelection(roi=(0, 0, 9, 9))):
        with pytest.raises(ValueError, match=r"no recording states its sensor; give --sensor WxH \(the events need at"):
            read_dataset(tmp_path, pixels=pixels)


def test_a_bin_is_of_34_pixels_without_the_option(tmp_path):
    for k in range(2):
        write(tmp_path / "ab"[k] / "0.bin", bar("flat", k, side=30, n=50))
    assert read_dataset(tmp_path).camera == (34, 34)
    assert read_dataset(tmp_path, pixels=PixelSelection(sensor=(304, 240))).camera == (304, 240)


def test_a_class_without_any_recording_left_is_an_error_about_its_own_recordings(tmp_path):
    fill(tmp_path, {"a_first": 0, "flat": 3, "upright": 3})
    for name in ("00torn.npy", "01torn.npy"):
        (tmp_path / "flat" / name).write_bytes(b"torn")
    for path in (tmp_path / "upright").iterdir():
        write(path, np.load(path)["events"][:0], sensor=SIZE)
    with pytest.raises(ValueError, match="class upright is left; record some, or remove the folder") as caught:
        read_dataset(tmp_path)
    assert str(caught.value).endswith("(left out: upright/00.npz: no events; and 2 more)")
    assert "flat" not in str(caught.value).removeprefix(str(tmp_path))


@pytest.mark.parametrize(
    ("pixels", "advice"),
    [
        (PixelSelection(roi=(0, 0, 8, 8)), "check --roi "),
        (PixelSelection(mask=mask_of((40, 40), (3, 3))), "check --mask "),
        (PixelSelection(roi=(0, 0, 30, 30), crop=True, mask=mask_of((3, 3))), "check --roi and --mask "),
    ],
)
def test_a_class_without_events_at_the_selected_pixels(pixels, advice, tmp_path):
    for k in range(2):
        write(tmp_path / "a" / f"{k}.npz", events_of([0, 5 + k], [2, 2], [2, 2], [1, 1]), sensor=SIZE)
        write(tmp_path / "b" / f"{k}.npz", events_of([0, 5 + k], [40, 40], [40, 40], [1, 0]), sensor=SIZE)
    with pytest.raises(ValueError, match=rf"class b is left; {advice}\(left out: b/0.npz: no events at the selected"):
        read_dataset(tmp_path, pixels=pixels)


def test_recordings_that_differ_only_outside_of_the_region(tmp_path):
    """In two classes both stay: neither file is wrong. In one class the second would show the network the same."""

    def recorded(far):
        return events_of([0, 10, 20], [2, 5, far], [2, 5, far], [1, 0, 1])

    for name, far in (("a/0", 40), ("a/1", 41), ("b/0", 42)):
        write(tmp_path / f"{name}.npz", recorded(far), sensor=SIZE)
    write(tmp_path / "b" / "1.npz", events_of([0], [9], [9], [1]), sensor=SIZE)
    assert read_dataset(tmp_path).left_out == ()
    dataset = read_dataset(tmp_path, pixels=PixelSelection(roi=(0, 0, 10, 10)))
    assert dataset.recordings.names == ("a/0.npz", "b/0.npz", "b/1.npz")
    assert dataset.left_out == ("a/1.npz: the same events as a/0.npz at the selected pixels",)
    assert dataset.left_out_events == {"left_out_outside": 2}  # not those of a/1.npz
    shifted = recorded(42)
    shifted["t"] += 5_000_000
    write(tmp_path / "a" / "wrong.npy", shifted)
    for pixels in (None, PixelSelection(roi=(0, 0, 10, 10), sensor=SIZE)):
        with pytest.raises(ValueError, match=r"a/wrong\.npy and b/0\.npz hold the same events, but are of two classes"):
            read_dataset(tmp_path, pixels=pixels)


def test_events_older_than_the_first_are_left_out_and_the_others_sorted(tmp_path):
    def recording(times_us):
        n = len(times_us)
        return events_of(times_us, np.full(n, 5), np.full(n, 7), np.ones(n, int))

    for k, name in enumerate("ab"):
        write(tmp_path / name / "1.npz", recording([500, 520 + k, 510, 499]), sensor=(9, 9))
    dataset = read_dataset(tmp_path)
    np.testing.assert_array_equal(dataset.recordings.t, [0, 10, 20, 0, 10, 21])
    assert dataset.sensor == (9, 9) and dataset.recordings.names == ("a/1.npz", "b/1.npz")
    write(tmp_path / "b" / "2.npz", recording([0, 1 << 31]), sensor=(9, 9))
    with pytest.raises(ValueError, match=r"b/2.npz: lasts 36 minutes, more than the 35 that training supports"):
        read_dataset(tmp_path)


def _one_class(folder):
    fill(folder, {"upright": 3})


def _a_class_with_none(folder):
    fill(folder, {"upright": 3, "flat": 3})
    (folder / "slanted").mkdir()
    (folder / "slanted" / "notes.md").touch()


def _a_class_of_torn_files(folder):
    fill(folder, {"upright": 3}, suffix=".npy")
    (folder / "flat").mkdir()
    (folder / "flat" / "a.npy").write_bytes((folder / "upright" / "00.npy").read_bytes()[:-7])


def _files_only(folder):
    write(folder / "a.npy", bar("flat", 0))


def _unknown_class(folder):
    fill(folder, {"upright": 1, "slanted": 1})


@pytest.mark.parametrize(
    ("make", "classes", "text"),
    [
        (_one_class, None, "there must be at least two class folders, got upright"),
        (_a_class_with_none, None, "no recordings in the class folder slanted; expected files in "),
        (_a_class_of_torn_files, None, "class flat is left; record some, or remove the folder (left out: flat/a.npy: "),
        (_files_only, None, "no class folders; expected set/<class name>/<recording>"),
        (_unknown_class, ("flat", "upright"), "unknown class slanted; known are flat, upright"),
    ],
)
def test_a_folder_that_is_no_dataset_is_refused(make, classes, text, tmp_path):
    (tmp_path / "set").mkdir()
    make(tmp_path / "set")
    with pytest.raises(ValueError, match=re.escape(text)):
        read_dataset(tmp_path / "set", classes=classes)
