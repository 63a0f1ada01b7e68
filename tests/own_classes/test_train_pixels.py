"""`async-tnt train DATASET` with --roi, --crop and --mask: as if what they leave out had never been recorded."""

import hashlib
import json
import shutil

import numpy as np
import pytest
from own_classes.gestures import bar, write

from async_tnt.model import load_model
from async_tnt.pixels import PixelFilter, save_mask

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.training import own_run

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

    So whoever drops what is older than the first event before the hot pixels are left out drops half of the bar.
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


@pytest.fixture
def train(program, tmp_path):
    def run(dataset, *words, name="m", quick=QUICK):
        out = tmp_path / f"{name}.safetensors"
        return *program("train", dataset, "--out", out, "--run", tmp_path / f"run {name}", *quick, *words), out

    return run


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


def test_the_record_says_what_was_seen(models, sets):
    assert "pixels" not in load_model(models["clean"]).record["data"]
    told = load_model(models["large"]).record
    mask = np.load(sets / "large.npy")
    assert told["data"]["pixels"] == {
        "roi": [30, 10, 64, 64],
        "crop": True,
        "masked_pixels": 2,
        "mask_sha256": hashlib.sha256(mask.tobytes()).hexdigest(),
        "camera": [120, 90],
        "left_out": "7,500 outside of the region, 9,000 of masked pixels",
    }
    assert told["data"]["sensor"] == [64, 64]
    assert "--roi 30,10,64,64 --crop" in told["command"]  # to be given again; the mask is a file of one's own
    beside = json.loads(models["large"].with_suffix(".json").read_text())
    assert beside["summary"]["data"]["pixels"] == told["data"]["pixels"]


def test_it_says_on_the_way_how_much_is_left_out(sets, chosen, train):
    code, _, told, _ = train(sets / "hot", *chosen["hot"])
    assert code == 0 and "left out of the recordings: 9,000 of masked pixels\n" in told
    assert "left out" not in train(sets / "clean", name="clean")[2]


def test_such_a_model_is_evaluated_and_run_with_the_same_options(models, sets, chosen, program):
    reports = []
    for name in ("clean", "large"):
        code, printed, told = program("evaluate", models[name], sets / name, "--json", *chosen[name])
        assert code == 0 and told == ""
        report = json.loads(printed)
        reports.append({k: v for k, v in report.items() if not k.endswith("_per_second") and k != "seconds"})
    assert reports[0] == reports[1] and reports[0]["recordings"] == 10
    words = "run", "--model", models["large"], sets / "large" / "flat" / "0.npz"
    assert program(*words, *chosen["large"])[0] == 0
    code, _, told = program(*words)
    assert code == 2 and "the model is for 64x64" in told and "--roi X,Y,64,64 --crop" in told


def test_a_region_alone_and_a_region_without_crop(sets, tmp_path, train):
    for path in (sets / "hot").glob("*/*.npz"):
        kept = PixelFilter(SIZE, roi=(0, 0, 64, 50))(np.load(path)["events"])
        write(tmp_path / "cut" / path.parent.name / path.name, kept, sensor=SIZE)
        write(tmp_path / "whole" / path.parent.name / path.name, np.load(path)["events"], sensor=SIZE)
    expected = load_model(train(tmp_path / "cut", name="cut")[-1])
    got = load_model(train(tmp_path / "whole", "--roi", "0,0,64,50", name="whole")[-1])
    assert got.config == expected.config and got.config.sensor == SIZE
    assert all((got.weights[name] == weights).all() for name, weights in expected.weights.items())


def test_the_test_folder_is_seen_through_the_same_pixels(sets, chosen, tmp_path, train):
    """A region of the region would be refused; without the mask, the accuracy would be another's."""
    tests = []
    for name in ("clean", "large"):
        for part in ("Train", "Test"):
            shutil.copytree(sets / name, tmp_path / name / part)
        for path in (tmp_path / name / "Test").rglob("*.csv"):
            path.unlink()
        code, _, told, out = train(tmp_path / name, "--test", *chosen[name], name=name)
        assert code == 0, told
        tests.append(load_model(out).record["test"])
    assert tests[0] == tests[1] and tests[0]["recordings"] == 6


def test_another_selection_is_another_run(sets, chosen, tmp_path, train, monkeypatch):
    mask = tmp_path / "m.npy"
    save_mask(mask, mask_of(SIZE))
    assert train(sets / "hot", "--mask", mask)[0] == 0
    assert train(sets / "hot", *chosen["hot"])[0] == 0  # the same mask by another name
    monkeypatch.setattr(own_run, "read_classes", lambda *given, **more: pytest.fail("the recordings were read"))
    save_mask(mask, mask_of(SIZE, HOT[:1]))
    run = tmp_path / "run m"
    for words, what in (
        (("--mask", mask), "mask"),
        ((), "mask"),
        (("--mask", sets / "hot.npy", "--roi", "0,0,64,50"), "roi"),
        (("--mask", sets / "hot.npy", "--roi", "0,0,50,64", "--crop"), "sensor"),
    ):
        code, _, told, _ = train(sets / "hot", *words)
        assert code == 2 and told.startswith(f"async-tnt: {run} holds a run with other {what}; give another"), told
        assert told.count("\n") == 1


def test_a_run_from_before_there_were_selections_goes_on(sets, tmp_path, train):
    assert train(sets / "clean")[0] == 0
    note = tmp_path / "run m" / "recordings.json"
    noted = json.loads(note.read_text())
    assert noted.pop("pixels") == {}
    note.write_text(json.dumps(noted))
    assert train(sets / "clean")[0] == 0
    code, _, told, _ = train(sets / "clean", "--roi", "0,0,64,50")
    assert code == 2 and "other roi;" in told


def test_training_on_with_the_same_or_another_region(models, sets, chosen, train):
    code, _, told, out = train(sets / "large", "--start-from", models["clean"], *chosen["large"], name="on")
    assert code == 0 and load_model(out).config == load_model(models["clean"]).config, told
    wrong = ("--start-from", models["clean"], "--roi", "30,10,60,60", "--crop")
    code, _, told, _ = train(sets / "large", *wrong, name="wrong")
    assert code == 2 and "is for 64x64 pixels, got a region of 60x60" in told
    code, _, told, _ = train(sets / "hot", "--start-from", models["clean"], *chosen["hot"], name="hot")
    assert code == 0, told
    code, _, told, _ = train(
        sets / "hot", "--start-from", models["clean"], "--mask", sets / "large.npy", name="other mask"
    )
    assert code == 2 and "a mask of a 64x64 sensor must be" in told and told.count("\n") == 1


def test_a_recording_of_which_nothing_is_left_is_named(sets, tmp_path, train):
    folder = shutil.copytree(sets / "hot", tmp_path / "set")
    _, hot = recorded("flat", 0)
    write(folder / "flat" / "still.npz", hot[mask_of(SIZE)[hot["y"], hot["x"]]], sensor=SIZE)
    code, _, told, _ = train(folder, "--mask", sets / "hot.npy")
    assert code == 0 and told.count("left out: flat/still.npz: no events at the pixels that are not left out") == 2


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("SET", "--crop"), "--crop belongs to --roi"),
        (("SET", "--sensor", "0x5"), "`sensor` must have sides in [1, 32768]"),
        (("SET", "--mask", "no_such.npy"), "no_such.npy: No such file"),
        (("SET", "--mask", "HOT"), "hot.npy: a mask of a 120x90 sensor must be a bool array of shape (90, 120)"),
        (("SET", "--mask", "HOT", "--sensor", "120x90"), "a mask of 64x64 pixels, but the camera's are given as"),
        (("SET", "--roi", "100,0,64,64", "--crop"), "must lie on the sensor of 120x90 pixels"),
        (("SET", "--roi", "0,0,1,64", "--crop", "--mask", "LARGE"), "sides"),
        (("--smoke", "--roi", "0,0,3,3"), "--roi must come with DATASET"),
        (("--smoke", "--mask", "HOT"), "--mask must come with DATASET"),
        (("SILENT", "--roi", "0,0,64,64", "--crop"), "does not say the camera's pixels, which --crop needs"),
        (("SILENT", "--roi", "0,0,50,50"), "does not say the camera's pixels, which --roi needs"),
        (("SILENT", "--mask", "HOT"), "flat/1.csv: `x` must be in [0, 64)"),
    ],
)
def test_what_cannot_be_is_one_line(words, text, sets, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in (sets / "large").rglob("*.csv"):
        (tmp_path / "silent" / path.parent.name).mkdir(parents=True, exist_ok=True)
        shutil.copy(path, tmp_path / "silent" / path.parent.name)
    known = {"SET": sets / "large", "SILENT": "silent", "HOT": sets / "hot.npy", "LARGE": sets / "large.npy"}
    code, printed, told = program("train", *(known.get(word, word) for word in words))
    assert code == 2 and text in told and told.count("\n") == 1 and printed == "", told
    assert not (tmp_path / "model.safetensors").exists() and not (tmp_path / "runs").exists()
