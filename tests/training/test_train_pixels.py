"""`async-tnt train DATASET` with --roi, --crop and --mask: as if the other events had never been recorded."""

import hashlib
import shutil

import numpy as np
import pytest
from made import events_of
from training.gestures import bar, write

from async_tnt.config import TNTConfig
from async_tnt.networks.loading import load_model
from async_tnt.sources.pixel_masks import save_mask
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.training.data import dataset_data

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.cli import main

SIZE, CAMERA, CORNER = (64, 64), (120, 90), (30, 10)
HOT = np.array([(5, 60), (60, 3)])
QUICK = ("--grid", "34x34", "--epochs", "1")
LARGE = ("--roi", "30,10,64,64", "--crop", "--mask", "large.npy")


def mask_of(size, pixels):
    mask = np.zeros(size[::-1], bool)
    mask[pixels[:, 1], pixels[:, 0]] = True
    return mask


def recorded(seed):
    """A bar at 64x64, and with two pixels that fire all the time. The file begins with one of their late events:
    dropping what is older than the first event before the hot pixels are removed would drop half of the bar."""
    events = bar("upright" if seed % 2 else "flat", seed, side=64, n=600, start_us=5_000)
    events = events[~mask_of(SIZE, HOT)[events["y"], events["x"]]]
    t = np.linspace(1_000, 120_000, 900).astype(int)
    hot = events_of(t, *HOT[np.arange(900) % 2].T, np.zeros(900, int))
    rest = np.concatenate((events, np.delete(hot, 450)))
    return events, np.concatenate((hot[450:451], rest[np.argsort(rest["t"], kind="stable")]))


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """The same recordings without hot pixels, with them, and with them on a larger camera, parts of which move, too."""
    folder = tmp_path_factory.mktemp("sets")
    for k in range(20):
        events, hot = recorded(k)
        large, around = hot.copy(), hot[::2].copy()
        large["x"] += CORNER[0]
        large["y"] += CORNER[1]
        around["x"] = np.where(np.arange(len(around)) % 2, 2, 119)
        made = {"clean": (events, SIZE), "hot": (hot, SIZE), "large": (np.concatenate((large, around)), CAMERA)}
        for name, (all_events, sensor) in made.items():
            file = f"Test/{k % 2}/{k}.npy" if k < 10 else f"Train/{k % 2}/{k}.npz"  # .npy does not state the sensor
            write(folder / name / file, all_events, sensor=sensor)
    save_mask(folder / "hot.npy", mask_of(SIZE, HOT))
    save_mask(folder / "large.npy", mask_of(CAMERA, HOT + CORNER))
    return folder


def assert_same_windows(got, expected):
    for name in ("recording", "start_us"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    for name in ("t", "x", "y", "p", "offsets", "labels"):
        np.testing.assert_array_equal(getattr(got.recordings, name), getattr(expected.recordings, name))


@pytest.mark.parametrize(("name", "region", "sensor"), [("hot", None, None), ("large", (30, 10, 64, 64), CAMERA)])
def test_the_network_sees_recordings_without_these_events(name, region, sensor, sets):
    """Event by event, to train on, to validate on and to test on."""
    pixels = PixelSelection(region, region is not None, sets / f"{name}.npy", sensor)
    got = dataset_data(sets / name, TNTConfig(), pixels=pixels, test=True)
    clean, disturbed = (
        dataset_data(sets / which, TNTConfig(), pixels=PixelSelection(), test=True) for which in ("clean", "hot")
    )
    assert got.config == clean.config and got.config.sensor == SIZE and len(got.tests["test"][0]) == 10
    assert_same_windows(got.training, clean.training)
    assert_same_windows(got.validation, clean.validation)
    assert_same_windows(got.tests["test"][0], clean.tests["test"][0])
    assert len(disturbed.training.recordings.t) > len(clean.training.recordings.t)
    assert "events left out of the recordings: " in got.notes[0] and "9,000 of masked pixels" in got.notes[0]
    assert "left out" not in "".join(clean.notes)


@pytest.fixture(scope="module")
def model(sets, tmp_path_factory):
    """A model of the large set's selected pixels."""
    out = tmp_path_factory.mktemp("model") / "large.safetensors"
    assert main(["train", *map(str, (sets / "large", "--out", out, *QUICK, *at(sets, *LARGE)))]) == 0
    return out


def at(sets, *words):
    """The words, masks in the folder of the sets."""
    return [sets / word if str(word).endswith(".npy") else word for word in words]


def test_the_record_has_the_selected_pixels(model, sets):
    record = load_model(model).record
    assert record["data"]["pixels"] == {
        "roi": "30,10,64,64",
        "crop": True,
        "mask": "120x90 " + hashlib.sha256(np.load(sets / "large.npy").tobytes()).hexdigest()[:16],
        "camera": [120, 90],
        "left_out_outside": 7500,
        "left_out_masked": 9000,
    }
    assert " --roi 30,10,64,64 --crop " in record["command"] and record["command"].endswith(" --mask MASK")


def test_another_selection_is_another_run_and_the_same_mask_by_another_name_is_not(sets, model, tmp_path, program):
    words = ("train", sets / "large", "--out", model, *QUICK)
    for change, what in ((LARGE[:-2], "mask"), (("--mask", "hot.npy", "--seed", "3"), "crop, mask, roi, seed")):
        code, _, err = program(*words, *at(sets, *change))
        assert code == 2 and f"the folder holds a run with other {what}; delete it" in err, err
    mask = shutil.copy(sets / "large.npy", tmp_path / "m.npy")
    assert program(*words, *LARGE[:-1], mask)[0] == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--roi", "100,0,64,64", "--crop"), "must lie on the sensor of 120x90 pixels"),
        (("--start-from", "MODEL", "--roi", "0,0,60,60", "--crop"), "is for 64x64 pixels, got a region of 60"),
    ],
)
def test_a_region_that_does_not_fit_is_refused(words, message, sets, model, tmp_path, program):
    words = [model if word == "MODEL" else word for word in words]
    code, printed, err = program("train", sets / "large", "--out", tmp_path / "other.safetensors", *words)
    assert code == 2 and message in err and err.count("\n") == 1 and printed == "", err
