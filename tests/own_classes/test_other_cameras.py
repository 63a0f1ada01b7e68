"""A folder of one's own classes in which some recordings are of another camera, or show the network nothing new."""

import json
import re

import numpy as np
import pytest
from made import events_of
from own_classes.gestures import bar, write, write_set

from async_tnt.networks.model import load_model
from async_tnt.sources.pixel_masks import PackedMask
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.training.dataset import read_classes

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


@pytest.mark.parametrize(
    "pixels",
    [PixelSelection(), PixelSelection(roi=(0, 0, 60, 64), crop=True), PixelSelection(roi=(10, 10, 50, 50))],
    ids=["all", "crop", "a region off the stray's sensor"],
)
@pytest.mark.parametrize("stray", [(80, 60), (40, 40), (30, 30)])
def test_a_stray_is_left_out_and_named(pixels, stray, tmp_path):
    fill(tmp_path, {"upright": 6, "flat": 6})
    expected = read_classes(tmp_path, pixels=pixels)
    events = bar("flat", 77, side=30)
    write(tmp_path / "flat" / "00a.npz", events, sensor=stray)
    got = read_classes(tmp_path, pixels=pixels, skip_damaged=True)
    line = f"flat/00a.npz: a sensor of {stray[0]}x{stray[1]} pixels, but most recordings say 64x64."
    assert got.left_out == (line,) and got.camera == SIZE and got.sensor == expected.sensor
    np.testing.assert_array_equal(got.recordings.x, expected.recordings.x)
    with pytest.raises(ValueError, match=re.escape(line) + "|flat/00a.npz: .roi."):
        read_classes(tmp_path, pixels=pixels)


@pytest.mark.parametrize(("n", "n_other", "is_refused"), [(9, 1, False), (8, 1, True), (18, 2, False), (5, 5, True)])
def test_more_than_one_in_ten_of_another_sensor_are_no_strays(n, n_other, is_refused, tmp_path):
    fill(tmp_path, {"upright": n - n // 2, "flat": n // 2})
    fill(tmp_path, {"flat": n_other}, sensor=(90, 64), first=50)
    if is_refused:
        with pytest.raises(
            ValueError, match=r"of one sensor, got 64x64 \(flat/00\.npz and .*90x64 \(flat/50\.npz"
        ) as told:
            read_classes(tmp_path, skip_damaged=True)
        assert "give --sensor WxH to leave out all others" in str(told.value)
    else:
        assert len(read_classes(tmp_path, skip_damaged=True).left_out) == n_other
    named = read_classes(tmp_path, pixels=PixelSelection(sensor=SIZE), skip_damaged=True)  # as the refusal says
    assert len(named.recordings) == n and len(named.left_out) == n_other
    assert all(line.endswith("a sensor of 90x64 pixels, but --sensor says 64x64.") for line in named.left_out)


def test_a_named_camera_that_no_recording_states_is_refused(tmp_path):
    """Else only the silent ones would be left, taken for recordings of a camera that nobody has."""
    fill(tmp_path, {"upright": 2, "flat": 2})
    fill(tmp_path, {"upright": 2, "flat": 2}, suffix=".npy", first=4)
    with pytest.raises(
        ValueError, match=r"--sensor says 99x99, but the recordings that .* say 64x64 \(flat/00.npz and 3"
    ):
        read_classes(tmp_path, pixels=PixelSelection(sensor=(99, 99)), skip_damaged=True)


def test_a_silent_recording_with_events_off_the_sensor_is_left_out(tmp_path):
    fill(tmp_path, {"upright": 2, "flat": 2})
    write(tmp_path / "flat" / "large.csv", events_of([5, 9], [3, 64], [1, 2], [1, 1]))
    for pixels, who in (
        (PixelSelection(), "most recordings say"),
        (PixelSelection(mask=mask_of((1, 1))), "mask is a mask of"),
    ):
        own = read_classes(tmp_path, pixels=pixels, skip_damaged=True)
        line = f"flat/large.csv: every event must lie on the 64x64 sensor, got x = 64 at event 1 ({who} 64x64)."
        assert own.left_out == (line,)


def test_a_copy_of_a_stray_is_no_copy(tmp_path):
    fill(tmp_path, {"upright": 6, "flat": 6})
    events = bar("flat", 9, side=40)
    write(tmp_path / "flat" / "a.npz", events, sensor=(70, 70))
    write(tmp_path / "flat" / "b.npy", events)
    own = read_classes(tmp_path, skip_damaged=True)
    assert len(own.left_out) == 1 and own.left_out[0].startswith("flat/a.npz: a sensor of 70x70")
    assert "flat/b.npy" in own.recordings.names


def test_a_class_of_which_nothing_is_left_is_told_by_its_own_recordings(tmp_path):
    fill(tmp_path, {"a_first": 0, "flat": 3, "upright": 3})
    (tmp_path / "flat" / "00torn.npy").write_bytes(b"torn")
    (tmp_path / "flat" / "01torn.npy").write_bytes(b"torn")
    for path in (tmp_path / "upright").iterdir():
        write(path, np.load(path)["events"][:0], sensor=SIZE)
    with pytest.raises(ValueError, match="class upright is left; record some, or remove the folder") as told:
        read_classes(tmp_path, skip_damaged=True)
    assert str(told.value).endswith("(left out: upright/00.npz: no events. And 2 more)")
    assert "flat" not in str(told.value).removeprefix(str(tmp_path))


@pytest.mark.parametrize(
    ("pixels", "advice"),
    [
        (PixelSelection(roi=(0, 0, 8, 8)), "look at --roi "),
        (PixelSelection(mask=mask_of((40, 40), (3, 3))), "look at --mask "),
        (PixelSelection(roi=(0, 0, 30, 30), crop=True, mask=mask_of((3, 3))), "look at --roi and --mask "),
    ],
)
def test_a_class_that_the_selection_leaves_out_whole(pixels, advice, tmp_path):
    for k in range(2):
        write(tmp_path / "a" / f"{k}.npz", events_of([0, 5 + k], [2, 2], [2, 2], [1, 1]), sensor=SIZE)
        write(tmp_path / "b" / f"{k}.npz", events_of([0, 5 + k], [40, 40], [40, 40], [1, 0]), sensor=SIZE)
    with pytest.raises(ValueError, match=f"class b is left; {advice}") as told:
        read_classes(tmp_path, pixels=pixels, skip_damaged=True)
    assert "record some" not in str(told.value) and "(left out: b/0.npz: no events at the pixels" in str(told.value)


def test_recordings_that_differ_outside_of_the_region_alone(tmp_path):
    """In two classes both stay: neither file is wrong. In one class the second would show the network the same."""

    def recorded(far):
        return events_of([0, 10, 20], [2, 5, far], [2, 5, far], [1, 0, 1])

    for name, far in (("a/0", 40), ("a/1", 41), ("b/0", 42)):
        write(tmp_path / f"{name}.npz", recorded(far), sensor=SIZE)
    write(tmp_path / "b" / "1.npz", events_of([0], [9], [9], [1]), sensor=SIZE)
    assert read_classes(tmp_path).left_out == ()
    own = read_classes(tmp_path, pixels=PixelSelection(roi=(0, 0, 10, 10)))
    assert own.recordings.names == ("a/0.npz", "b/0.npz", "b/1.npz")
    assert own.left_out == ("a/1.npz: the same events as a/0.npz at the pixels that are not left out",)
    assert own.left_out_events == {"left_out_outside": 2}  # not those of a/1.npz
    shifted = recorded(42)
    shifted["t"] += 5_000_000
    write(tmp_path / "a" / "wrong.npy", shifted)
    for pixels in (None, PixelSelection(roi=(0, 0, 10, 10), sensor=SIZE)):
        with pytest.raises(ValueError, match=r"a/wrong\.npy and b/0\.npz hold the same events, but are of two classes"):
            read_classes(tmp_path, pixels=pixels)


def test_a_stray_in_test_is_left_out_and_named_once_more_at_the_end(tmp_path, train):
    fill(tmp_path / "set" / "Train", {"upright": 4, "flat": 4})
    fill(tmp_path / "set" / "Test", {"upright": 2, "flat": 2}, seed=1)
    write(tmp_path / "set" / "Test" / "flat" / "other.npz", bar("flat", 9, side=60), sensor=(80, 60))
    code, _, told, out = train(tmp_path / "set", "--test")
    line = "flat/other.npz: a sensor of 80x60 pixels, but the recordings trained on are of 64x64."
    assert code == 0 and told.splitlines()[-1] == f"left out: Test/{line}", told
    assert told.count(line) == told.count(f"Test/{line}") == 2  # where it was read, too
    record = load_model(out).record
    assert record["test"]["recordings"] == 4 and record["test"]["left_out"] == [line]
    assert json.loads(out.with_suffix(".json").read_text())["summary"]["test"] == record["test"]


def test_a_test_folder_of_another_camera_is_refused_before_training(tmp_path, train):
    fill(tmp_path / "set" / "Train", {"upright": 4, "flat": 4})
    fill(tmp_path / "set" / "Test", {"upright": 2, "flat": 2}, seed=1, sensor=(80, 64))
    code, _, told, _ = train(tmp_path / "set", "--test")
    assert code == 2 and "epoch" not in told and "--sensor" not in told
    assert "Test: the recordings trained on are of 64x64, but the recordings that state their sensor say 80x64" in told


@pytest.mark.parametrize("error", [ValueError("no such thing"), KeyboardInterrupt()])
def test_the_model_is_written_whatever_happens_with_test(error, tmp_path, train, monkeypatch):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    from async_tnt.training import evaluate as evaluation

    fill(tmp_path / "set" / "Train", {"upright": 4, "flat": 4})
    fill(tmp_path / "set" / "Test", {"upright": 2, "flat": 2}, seed=1)
    evaluate, n_calls = evaluation.evaluate, []

    def fail_on_test(*given, **more):
        n_calls.append(1)
        if len(n_calls) == 2:
            raise error
        return evaluate(*given, **more)

    monkeypatch.setattr(evaluation, "evaluate", fail_on_test)
    code, _, told, out = train(tmp_path / "set", "--test")
    assert code == (130 if isinstance(error, KeyboardInterrupt) else 2) and len(n_calls) == 2, told
    record = load_model(out).record
    assert record["validation"]["recordings"] == 2 and "test" not in record
    assert json.loads(out.with_suffix(".json").read_text())["accuracy"] >= 0
    for name in ("best", "last"):
        assert load_model(tmp_path / "run m" / f"{name}.safetensors").classes == ("flat", "upright")


def test_training_on_names_the_model_that_says_the_sensor(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 6, "flat": 6}, suffixes=(".npz",), side=64)
    code, _, told, out = train(folder)
    assert code == 0, told
    write(folder / "flat" / "other.npz", bar("flat", 50, side=60), sensor=(80, 60))
    code, _, told, _ = train(folder, "--start-from", out, "--run", tmp_path / "on")
    assert code == 0 and "flat/other.npz: a sensor of 80x60 pixels, but --start-from is for 64x64.\n" in told
