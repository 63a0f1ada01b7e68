"""`async-tnt train DATASET` with --roi, --crop and --mask: as if the other events had never been recorded."""

import hashlib
import json
import shutil

import numpy as np
import pytest
from dataset.gestures import bar, write

from async_tnt.networks.model import load_model
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import save_mask
from async_tnt.sources.pixel_selection import PixelSelection

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.cli import train as command
from async_tnt.training.dataset import read_dataset

QUICK = ("--epochs", "2", "--batch", "4", "--patience", "0")
SIZE = (64, 64)
CAMERA = (120, 90)
CORNER = (30, 10)
HOT = [(5, 60), (60, 3)]


def mask_of(size, pixels=HOT, corner=(0, 0)):
    mask = np.zeros(size[::-1], bool)
    for x, y in pixels:
        mask[corner[1] + y, corner[0] + x] = True
    return mask


def recorded(kind, seed):
    """A bar at 64x64 and two pixels that fire all the time; the file begins with one of their events from the middle.

    Dropping what is older than the first event before the hot pixels are removed would drop half of the bar.
    """
    events = bar(kind, seed, side=64, n=600, start_us=5_000)
    events = events[~mask_of(SIZE)[events["y"], events["x"]]]
    hot = np.zeros(900, events.dtype)
    hot["t"] = np.linspace(1_000, 120_000, len(hot)).astype(np.int64)
    hot["x"], hot["y"] = np.array(HOT)[np.arange(len(hot)) % 2].T
    first, hot = hot[450:451], np.delete(hot, 450)
    rest = np.concatenate((events, hot))
    return events, np.concatenate((first, rest[np.argsort(rest["t"], kind="stable")]))


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """The same recordings without hot pixels, with them, and with them on a larger camera, parts of which move, too."""
    folder = tmp_path_factory.mktemp("sets")
    for kind in ("upright", "flat"):
        for k in range(5):
            events, hot = recorded(kind, k)
            large = hot.copy()
            large["x"] += CORNER[0]
            large["y"] += CORNER[1]
            around = hot[::2].copy()
            around["x"] = np.where(np.arange(len(around)) % 2, 2, 119)
            large = np.concatenate((large, around))
            suffix = (".npz", ".csv")[k % 2]
            write(folder / "clean" / kind / f"{k}{suffix}", events, sensor=SIZE)
            write(folder / "hot" / kind / f"{k}{suffix}", hot, sensor=SIZE)
            write(folder / "large" / kind / f"{k}{suffix}", large, sensor=CAMERA)
    save_mask(folder / "hot.npy", mask_of(SIZE))
    save_mask(folder / "large.npy", mask_of(CAMERA, corner=CORNER))
    return folder


@pytest.fixture(scope="module")
def chosen(sets):
    """The options for each set."""
    return {
        "clean": (),
        "hot": ("--mask", sets / "hot.npy"),
        "large": ("--roi", "30,10,64,64", "--crop", "--mask", sets / "large.npy"),
    }


@pytest.fixture(scope="module")
def models(sets, chosen, tmp_path_factory):
    """A model of each set, and one that has seen the hot pixels."""
    from async_tnt.cli import main

    folder = tmp_path_factory.mktemp("models")
    made = {}
    for name, (dataset, words) in {
        **{name: (name, words) for name, words in chosen.items()},
        "disturbed": ("hot", ()),
    }.items():
        out = folder / f"{name}.safetensors"
        words = ("--out", out, "--run", folder / name, *QUICK, *words)
        assert main(["train", str(sets / dataset), *map(str, words)]) == 0
        made[name] = out
    return made


@pytest.mark.parametrize("name", ["hot", "large"])
def test_the_weights_are_those_of_recordings_without_these_events(name, models):
    clean, got, disturbed = (load_model(models[which]) for which in ("clean", name, "disturbed"))
    assert got.config == clean.config and got.config.sensor == SIZE
    for weights in clean.weights:
        assert got.weights[weights].tobytes() == clean.weights[weights].tobytes(), weights
    assert any((clean.weights[w] != disturbed.weights[w]).any() for w in clean.weights)


def test_the_record_has_the_selected_pixels(models, sets):
    assert "pixels" not in load_model(models["clean"]).record["data"]
    record = load_model(models["large"]).record
    mask = np.load(sets / "large.npy")
    assert record["data"]["pixels"] == {
        "roi": [30, 10, 64, 64],
        "crop": True,
        "masked_pixels": 2,
        "mask_sha256": hashlib.sha256(mask.tobytes()).hexdigest(),
        "camera": [120, 90],
        "left_out_outside": 7500,
        "left_out_masked": 9000,
    }
    assert record["data"]["sensor"] == [64, 64]
    assert " --roi 30,10,64,64 --crop " in record["command"] and record["command"].endswith(" --mask MASK")
    beside = json.loads(models["large"].with_suffix(".json").read_text())
    assert beside["summary"]["data"]["pixels"] == record["data"]["pixels"]


def test_the_number_of_left_out_events_is_printed(sets, chosen, train):
    code, _, err, _ = train(sets / "hot", *chosen["hot"])
    assert code == 0 and "events left out of the recordings: 9,000 of masked pixels\n" in err
    assert "left out" not in train(sets / "clean", name="clean")[2]


def test_such_a_model_is_evaluated_and_run_with_the_same_options(models, sets, chosen, program):
    reports = []
    for name in ("clean", "large"):
        code, printed, err = program("evaluate", models[name], sets / name, "--json", *chosen[name])
        assert code == 0 and err == ""
        report = json.loads(printed)
        report.pop("pixels", None)
        reports.append({k: v for k, v in report.items() if not k.endswith("_per_second") and k != "seconds"})
    assert reports[0] == reports[1] and reports[0]["recordings"] == 10
    words = "run", "--model", models["large"], sets / "large" / "flat" / "0.npz"
    assert program(*words, *chosen["large"])[0] == 0
    code, _, err = program(*words)
    assert code == 2 and "the model is for 64x64" in err and "--roi X,Y,64,64 --crop" in err


def test_a_region_alone_and_a_region_without_crop(sets, tmp_path, train):
    for path in (sets / "hot").glob("*/*.npz"):
        kept = PixelFilter(SIZE, roi=(0, 0, 64, 50))(np.load(path)["events"])
        write(tmp_path / "cut" / path.parent.name / path.name, kept, sensor=SIZE)
        write(tmp_path / "whole" / path.parent.name / path.name, np.load(path)["events"], sensor=SIZE)
    expected = load_model(train(tmp_path / "cut", name="cut")[-1])
    got = load_model(train(tmp_path / "whole", "--roi", "0,0,64,50", name="whole")[-1])
    assert got.config == expected.config and got.config.sensor == SIZE
    assert all((got.weights[name] == weights).all() for name, weights in expected.weights.items())


def test_the_test_folder_is_reduced_to_the_same_pixels(sets, chosen, tmp_path, train, monkeypatch):
    """Event by event: two models with the same decisions may have seen something else."""
    from async_tnt.training import evaluation

    evaluate, seen = evaluation.evaluate, []

    def note(pipeline, windows, **more):
        seen.append(windows.recordings)
        return evaluate(pipeline, windows, **more)

    monkeypatch.setattr(evaluation, "evaluate", note)
    tests = []
    for name in ("clean", "large"):
        for part in ("Train", "Test"):
            shutil.copytree(sets / name, tmp_path / name / part)
        for path in (tmp_path / name / "Test").rglob("*.csv"):
            path.unlink()
        code, _, err, out = train(tmp_path / name, "--test", *chosen[name], name=name)
        assert code == 0, err
        tests.append(load_model(out).record["test"])
    assert tests[0] == tests[1] and tests[0]["recordings"] == 6
    of_clean, of_large = seen[1], seen[3]  # after those of the held-out recordings
    assert len(of_clean) == 6
    for name in ("t", "x", "y", "p", "offsets"):
        np.testing.assert_array_equal(getattr(of_large, name), getattr(of_clean, name))


def test_the_test_folder_need_not_state_the_sensor_again(sets, tmp_path, train):
    """It is that of the recordings to train on, also for a .bin."""
    for path in (sets / "large").glob("*/*.npz"):
        (tmp_path / "set" / "Train" / path.parent.name).mkdir(parents=True, exist_ok=True)
        shutil.copy(path, tmp_path / "set" / "Train" / path.parent.name)
        events = np.sort(np.load(path)["events"], order="t", kind="stable")
        for suffix in (".csv", ".bin"):
            events = events[100:]  # so that they are no copies of each other
            write(tmp_path / "set" / "Test" / path.parent.name / f"{path.stem}{suffix}", events)
    code, _, err, out = train(tmp_path / "set", "--roi", "30,10,64,64", "--crop", "--test")
    assert code == 0, err
    record = load_model(out).record["test"]
    assert record["recordings"] == 12 and record["left_out"] == []


def test_a_region_is_cropped_from_recordings_that_do_not_state_their_sensor(sets):
    """Half of the set is CSV. As if `--sensor` had given that of the others."""
    for roi in ((30, 10, 64, 64), (0, 0, 100, 90)):
        got, expected = (
            read_dataset(sets / "large", pixels=PixelSelection(roi, True, None, sensor)) for sensor in (None, CAMERA)
        )
        assert got.recordings.names == expected.recordings.names and got.left_out_events == expected.left_out_events
        np.testing.assert_array_equal(got.recordings.x, expected.recordings.x)


def test_events_of_recordings_that_are_left_out_do_not_count(sets, tmp_path):
    mask = mask_of(SIZE)
    expected = {"left_out_masked": 9000}
    folder = shutil.copytree(sets / "hot", tmp_path / "set")
    assert read_dataset(folder, pixels=PixelSelection(mask=mask)).left_out_events == expected
    _, hot = recorded("flat", 0)
    shutil.copy(folder / "flat" / "0.npz", folder / "flat" / "copy.npz")
    write(folder / "flat" / "still.npz", hot[mask[hot["y"], hot["x"]]], sensor=SIZE)
    dataset = read_dataset(folder, pixels=PixelSelection(mask=mask))
    assert dataset.left_out_events == expected and len(dataset.left_out) == 2
    assert read_dataset(folder).left_out_events == {}


def test_another_selection_is_another_run(sets, chosen, tmp_path, train, monkeypatch):
    mask = tmp_path / "m.npy"
    save_mask(mask, mask_of(SIZE))
    assert train(sets / "hot", "--mask", mask)[0] == 0
    assert train(sets / "hot", *chosen["hot"])[0] == 0  # the same mask by another name
    monkeypatch.setattr(command, "dataset_data", lambda *given, **more: pytest.fail("the recordings were read"))
    save_mask(mask, mask_of(SIZE, HOT[:1]))
    run = tmp_path / "run m"
    for words, what in (
        (("--mask", mask), "mask"),
        ((), "mask"),
        (("--mask", sets / "hot.npy", "--roi", "0,0,64,50"), "roi"),
        (("--mask", sets / "hot.npy", "--roi", "0,0,50,64", "--crop"), "crop, roi"),
        (("--mask", sets / "large.npy"), "mask"),
        (("--mask", sets / "large.npy", "--sensor", "120x90"), "mask, sensor"),
        (("--mask", mask, "--seed", "3"), "mask, seed"),
    ):
        code, _, err, _ = train(sets / "hot", *words)
        assert code == 2 and err.startswith(f"async-tnt: {run} holds a run with other {what}; give another"), err
        assert err.count("\n") == 1


def test_a_moved_region_is_named_as_such(sets, tmp_path, train):
    words = ("--crop", "--mask", sets / "large.npy")
    assert train(sets / "large", "--roi", "30,10,64,64", *words)[0] == 0
    for roi in ("31,10,64,64", "30,10,66,64"):  # of another size or not
        code, _, err, _ = train(sets / "large", "--roi", roi, *words)
        assert code == 2 and "holds a run with other roi; give another" in err, err
    code, _, err, _ = train(sets / "large", *words[1:])
    assert code == 2 and "holds a run with other crop, roi; give another" in err, err


def test_training_on_with_the_same_or_another_region(models, sets, chosen, train):
    code, _, err, out = train(sets / "large", "--start-from", models["clean"], *chosen["large"], name="on")
    assert code == 0 and load_model(out).config == load_model(models["clean"]).config, err
    wrong = ("--start-from", models["clean"], "--roi", "30,10,60,60", "--crop")
    code, _, err, _ = train(sets / "large", *wrong, name="wrong")
    assert code == 2 and "is for 64x64 pixels, got a region of 60x60" in err
    code, _, err, _ = train(sets / "hot", "--start-from", models["clean"], *chosen["hot"], name="hot")
    assert code == 0, err
    code, _, err, _ = train(
        sets / "hot", "--start-from", models["clean"], "--mask", sets / "large.npy", name="other mask"
    )
    assert code == 2 and "a mask of a 120x90 camera, but the model is for 64x64 pixels" in err and err.count("\n") == 1


def test_a_recording_of_which_nothing_is_left_is_named(sets, tmp_path, train):
    folder = shutil.copytree(sets / "hot", tmp_path / "set")
    _, hot = recorded("flat", 0)
    write(folder / "flat" / "still.npz", hot[mask_of(SIZE)[hot["y"], hot["x"]]], sensor=SIZE)
    code, _, err, _ = train(folder, "--mask", sets / "hot.npy")
    assert code == 0 and err.count("left out: flat/still.npz: no events at the selected pixels") == 2


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("SET", "--crop"), "--crop belongs to --roi"),
        (("SET", "--roi", "40,40,1,1", "--crop"), "the region is the model's sensor and must have sides of at least 2"),
        (("SET", "--mask", "no_such.npy"), "no_such.npy: No such file"),
        (("SET", "--mask", "HOT"), "hot.npy: a mask of a 120x90 sensor must be"),
        (("SET", "--mask", "HOT", "--sensor", "120x90"), "a mask of 64x64 pixels, but the camera's are given as"),
        (("SET", "--roi", "100,0,64,64", "--crop"), "must lie on the sensor of 120x90 pixels"),
        (("SET", "--roi", "0,0,1,64", "--crop", "--mask", "LARGE"), "sides of at least 2 pixels, got 1x64"),
        (("--smoke", "--roi", "0,0,3,3"), "--roi must come with DATASET"),
        (("--smoke", "--mask", "HOT"), "--mask must come with DATASET"),
        (("SILENT", "--roi", "0,0,64,64", "--crop"), "no recording states its sensor; give --sensor WxH"),
        (("SILENT", "--mask", "HOT"), "no recording states its sensor; give --sensor WxH"),
        (("SILENT", "--mask", "HOT", "--sensor", "64x64"), "flat/1.csv: every event must lie on the 64x64 sensor, got"),
    ],
)
def test_errors_are_one_line(words, text, sets, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in (sets / "large").rglob("*.csv"):
        (tmp_path / "silent" / path.parent.name).mkdir(parents=True, exist_ok=True)
        shutil.copy(path, tmp_path / "silent" / path.parent.name)
    known = {"SET": sets / "large", "SILENT": "silent", "HOT": sets / "hot.npy", "LARGE": sets / "large.npy"}
    code, printed, err = program("train", *(known.get(word, word) for word in words))
    assert code == 2 and text in err and err.count("\n") == 1 and printed == "", err
    assert not (tmp_path / "model.safetensors").exists() and not (tmp_path / "runs").exists()
