"""`async-tnt train DATASET`: from a folder of class folders to a model that knows them."""

import json

import numpy as np
import pytest
from own_classes.gestures import bar, write, write_set

from async_tnt.networks.model import load_model
from async_tnt.sources.files.formats import READERS

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.cli import train as command
from async_tnt.training import dataset_run as own_run


def test_the_model_has_the_folders_classes_and_the_recordings_sensor(trained):
    model = load_model(trained)
    assert model.classes == ("flat", "upright")
    assert model.config.sensor == (128, 128) and model.config.grid == (34, 34)
    assert model.record["data"]["classes"] == {"flat": 12, "upright": 12}
    assert model.record["validation"]["recordings"] == 4  # a fifth, rounded, of each class


def test_beside_the_model_are_its_numbers_and_pictures(trained):
    report = json.loads(trained.with_suffix(".json").read_text())
    assert report["classes"] == ["flat", "upright"]
    confusion = np.array(report["confusion"])
    assert confusion.sum() == len(report["held_out"]) == 4
    assert report["accuracy"] == np.trace(confusion) / 4
    assert len(report["history"]) == 6
    pytest.importorskip("matplotlib", reason="pictures need matplotlib (extra `plot`)")
    for suffix in (".confusion.png", ".curves.png"):
        assert trained.with_suffix(suffix).read_bytes().startswith(b"\x89PNG")


def test_three_classes_of_unequal_size_are_all_learned(tmp_path, train, program):
    """24 to 6 to 5: a network that followed the counts alone would never say the rare ones."""
    write_set(tmp_path / "set", {"upright": 24, "flat": 6, "slanted": 5})
    write_set(tmp_path / "test", {"upright": 6, "flat": 6, "slanted": 6}, seed=1)
    code, _, told, out = train(tmp_path / "set", quick=("--epochs", "10", "--batch", "8", "--patience", "0"))
    assert code == 0 and "recordings: flat 6, slanted 5, upright 24" in told
    code, printed, _ = program("evaluate", out, tmp_path / "test", "--json")
    per_class = json.loads(printed)["per_class"]
    assert code == 0 and min(per_class.values()) >= 0.6, per_class


def test_bins_of_34_pixels_mix_with_other_formats(tmp_path, train):
    suffixes = [suffix for suffix in (".bin", ".npy", ".npz", ".csv") if suffix in READERS]
    write_set(tmp_path / "set", {"upright": 8, "flat": 8}, suffixes=suffixes, side=34)
    code, _, _, out = train(tmp_path / "set")
    assert code == 0 and load_model(out).config.sensor == (34, 34)
    assert load_model(out).record["data"]["classes"] == {"flat": 8, "upright": 8}


def test_bins_of_another_camera_are_read_by_the_option(tmp_path, train):
    """As N-Caltech101's; mixed with a format that states the sensor."""
    write_set(tmp_path / "set", {"upright": 4, "flat": 4}, suffixes=(".bin", ".npz"))
    for path in (tmp_path / "set").rglob("*.npz"):
        write(path, np.load(path)["events"], sensor=(304, 240))
    code, _, _, out = train(tmp_path / "set", "--sensor", "304x240")
    assert code == 0 and load_model(out).config.sensor == (304, 240)
    assert load_model(out).record["data"]["classes"] == {"flat": 4, "upright": 4}
    assert load_model(out).record["data"]["left_out"] == []


def test_bins_of_another_camera_without_the_option_are_told_of_it(tmp_path, train):
    write_set(tmp_path / "set", {"upright": 5, "flat": 5}, suffixes=(".bin",))
    code, _, told, _ = train(tmp_path / "set")
    assert code == 2 and told.count("\n") == 1 and told.startswith("async-tnt: ")
    assert "or say its sensor if it is of another camera. And 9 more); a .bin of another camera" in told
    assert told.endswith("than N-MNIST's 34x34 needs --sensor WxH\n")
    assert "sensor=" not in told and "strict" not in told  # advice for Python


def test_a_run_with_other_recordings_is_refused_before_they_are_read(tmp_path, train, monkeypatch):
    folder = write_set(tmp_path / "set", {"upright": 3, "flat": 3})
    write(folder / "flat" / "silent.npz", bar("flat", 0)[:0])
    assert train(folder)[0] == 0
    (folder / "flat" / "silent.npz").unlink()  # it was left out: the run is the same
    assert train(folder)[0] == 0
    monkeypatch.setattr(own_run, "read_classes", lambda *given, **more: pytest.fail("the recordings were read"))
    run = tmp_path / "run m"

    def refused(*words):
        code, _, told, _ = train(folder, *words)
        end = f"; give another run folder (train --run OTHER), or delete the folder {run} to start again\n"
        assert code == 2 and told.startswith(f"async-tnt: {run} holds a run with other ") and told.endswith(end)
        return told.removeprefix(f"async-tnt: {run} holds a run with other ").removesuffix(end)

    assert refused("--seed", "1", "--window-us", "5000", "--iterations", "7") == "iterations, seed, window_us"
    assert refused("--validation", "0.5") == "validation (0.2, now 0.5)"
    write(folder / "upright" / "new.npy", bar("upright", 77))
    assert refused() == "recordings (upright/new.npy is new)"
    write(folder / "upright" / "00.npy", bar("upright", 77)[:100])
    (folder / "flat" / "01.npz").unlink()
    expected = "recordings (upright/new.npy is new, upright/00.npy has changed, flat/01.npz is gone)"
    assert refused() == expected
    write(folder / "upright" / "newer.npy", bar("upright", 78))
    assert refused().endswith(", upright/00.npy has changed, and 1 more)")


def test_a_run_without_a_note_is_refused_by_its_events(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 3, "flat": 3})
    assert train(folder)[0] == 0
    for note in ("[]", '{"sizes": 3}', "", None):
        path = tmp_path / "run m" / "recordings.json"
        path.unlink() if note is None else path.write_text(note)
        assert train(folder)[0] == 0
    write(folder / "upright" / "new.npy", bar("upright", 77))
    code, _, told, _ = train(folder)
    assert code == 2 and "training_windows, data; give" in told


def test_the_option_says_the_sensor_where_no_recording_does(tmp_path, train):
    write_set(tmp_path / "set", {"upright": 4, "flat": 4}, suffixes=(".npy",))
    code, _, told, _ = train(tmp_path / "set")
    assert code == 2 and "give --sensor WxH (the events need at least 1" in told
    code, _, told, _ = train(tmp_path / "set", "--sensor", "64x64")
    assert code == 2 and "flat/00.npy: every event must lie on the 64x64 sensor, got x = " in told
    words = ("--sensor", "240x180", "--grid", "20x16", "--window-us", "50000")
    code, _, _, out = train(tmp_path / "set", *words)
    config = load_model(out).config
    assert code == 0 and (config.sensor, config.grid, config.window_us) == ((240, 180), (20, 16), 50_000)
    assert "--sensor 240x180 --grid 20x16 --window-us 50000" in load_model(out).record["command"]


def test_long_recordings_have_several_windows_and_short_ones_a_partial_one(tmp_path, train):
    for k in range(5):
        write(tmp_path / "set" / "upright" / f"{k}.npz", bar("upright", k, duration_us=500_000, start_us=7_000_000_000))
        write(tmp_path / "set" / "flat" / f"{k}.npz", bar("flat", k, duration_us=20_000))
    code, _, told, _ = train(tmp_path / "set")
    # one of five is held out of each class: 4 x 5 windows of 105 ms and 4 partial ones
    assert code == 0 and "24 windows to train on, 6 held out" in told


def test_train_and_test_folders(tmp_path, train):
    write_set(tmp_path / "set" / "Train", {"upright": 5, "flat": 5})
    code, _, told, _ = train(tmp_path / "set", "--test")
    assert code == 2 and "--test needs a folder Test" in told
    write_set(tmp_path / "set" / "Test", {"upright": 3}, seed=1)
    code, _, _, out = train(tmp_path / "set", "--test")
    assert code == 0 and load_model(out).record["test"]["recordings"] == 3
    write_set(tmp_path / "set" / "Test", {"slanted": 1})
    code, _, told, _ = train(tmp_path / "set", "--test", name="other")
    assert code == 2 and "class slanted is unknown here; known are flat, upright" in told


def test_empty_recordings_and_copies_are_left_out_and_said(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 5, "flat": 5})
    nothing = bar("flat", 0)[:0]
    write(folder / "flat" / "silent.npz", nothing)
    write(folder / "flat" / "zz.npy", np.load(folder / "flat" / "00.npy"))  # a name of both classes, and a copy
    (folder / "flat" / "notes.md").write_text("no recording")
    (folder / ".cache").mkdir()
    code, _, told, out = train(folder)
    assert code == 0 and load_model(out).record["data"]["classes"] == {"flat": 5, "upright": 5}
    assert "left out: flat/silent.npz: no events" in told
    assert "left out: flat/zz.npy: the same events as flat/00.npy" in told


def test_a_class_of_one_recording_is_learned_and_not_held_out(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 5, "flat": 1})
    code, _, told, _ = train(folder)
    assert code == 0 and "not held out, for want of a second recording: flat" in told
    code, _, told, out = train(write_set(tmp_path / "two", {"upright": 5, "flat": 2}), name="two")
    assert code == 0 and "not held out" not in told and load_model(out).record["data"]["held_out_recordings"] == 2


def _one_class(folder):
    write_set(folder, {"upright": 3})


def _a_class_with_none(folder):
    write_set(folder, {"upright": 3, "flat": 3})
    (folder / "slanted").mkdir()
    (folder / "slanted" / "notes.md").touch()


def _a_class_of_silence(folder):
    write_set(folder, {"upright": 3})
    write(folder / "flat" / "a.npz", bar("flat", 0)[:0])


def _in_two_classes(folder):
    write_set(folder, {"upright": 3, "flat": 3})
    write(folder / "flat" / "wrong.npy", np.load(folder / "upright" / "00.npy"))


def _two_sensors(folder):
    write_set(folder, {"upright": 3, "flat": 3}, suffixes=(".npz",))
    write(folder / "flat" / "other.npz", bar("flat", 9), sensor=(640, 480))


def _a_class_of_torn_files(folder):
    write_set(folder, {"upright": 3})
    (folder / "flat").mkdir()
    (folder / "flat" / "a.npy").write_bytes((folder / "upright" / "00.npy").read_bytes()[:-7])


def _files_only(folder):
    write(folder / "a.npy", bar("flat", 0))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (_one_class, "at least two class folders to tell apart, got upright"),
        (_a_class_with_none, "no recordings in the class folder slanted; expected files in "),
        (_a_class_of_silence, "no recording of class flat is left; record some, or remove the folder"),
        (_in_two_classes, "hold the same events, but are of two classes; remove the wrong one"),
        (_two_sensors, "one sensor, got 128x128 (flat/00.npz and 5 more), 640x480 (flat/other.npz); take"),
        (
            _a_class_of_torn_files,
            "recording of class flat is left; record some, or remove the folder (left out: flat/a.npy: ",
        ),
        (_files_only, "no class folders; expected set/<class name>/<recording>"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_folder_that_cannot_be_is_one_line_and_exit_code_2(make, text, tmp_path, train):
    (tmp_path / "set").mkdir()
    make(tmp_path / "set")
    code, _, told, out = train(tmp_path / "set")
    assert code == 2 and text in told and told.count("\n") == 1, told
    assert not out.exists()


def test_an_unreadable_recording_is_left_out_and_named_at_the_end(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 4, "flat": 4})
    (folder / "flat" / "torn.npy").write_bytes((folder / "flat" / "00.npy").read_bytes()[:-7])
    (folder / "upright" / "text.csv").write_text("t,x,y,p\n1,2,3,1\n2,3,words,0\n")
    (folder / "upright" / "what.raw").write_bytes(b"no recording")
    code, printed, told, out = train(folder)
    assert code == 0 and "wrote " in printed
    lines = told.splitlines()
    named = lines[-3:]
    for line, start in zip(
        named,
        (
            "left out: flat/torn.npy: not a readable NumPy file: ",
            "left out: upright/text.csv: damaged recording: line 3: ",
            "left out: upright/what.raw: its first bytes are of no known format",
        ),
        strict=True,
    ):
        assert line.startswith(start), told
        assert lines.count(line) == 2  # where it was read, too
    record = load_model(out).record["data"]
    assert [f"left out: {line}" for line in record["left_out"]] == named
    assert str(tmp_path) not in " ".join(named)  # a model may be given away
    assert record["classes"] == {"flat": 4, "upright": 4}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("DATASET", "--nmnist", "x"), "--nmnist must come without DATASET"),
        (("DATASET", "--saccades", "1"), "--saccades must come without DATASET"),
        (("--smoke", "--grid", "20x20"), "--grid must come with DATASET"),
        (("DATASET", "--grid", "3x20"), "--grid must be at least 4x4"),
        (
            ("DATASET", "--sensor", "640x480"),
            ": --sensor says 640x480, but the recordings that state their sensor say 128x128 (flat/01.npz and 11 more)",
        ),
        (("DATASET", "--patience", "-1"), "`patience` must be at least 1, got -1"),
        (("DATASET", "--batch", "0"), "`batch` must be at least 1, got 0"),
        (("nowhere",), "no folder nowhere"),
        (("DATASET", "--out", "q.pt"), "--out must end in .safetensors, got q.pt"),
    ],
)
def test_options_that_cannot_be_are_one_line(words, text, gestures, program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, told = program("train", *(str(gestures) if word == "DATASET" else word for word in words))
    assert code == 2 and text in told, told


@pytest.mark.parametrize("size", ["128", "0x5"])
def test_a_size_is_two_numbers(size, program, capsys):
    with pytest.raises(SystemExit) as stopped:
        program("train", "set", "--sensor", size)
    told = capsys.readouterr().err
    assert stopped.value.code == 2 and "--sensor: must be WIDTHxHEIGHT" in told and f"got {size!r}" in told


def test_interrupted_and_resumed_gives_the_same_model(gestures, train, monkeypatch):
    quick = ("--epochs", "4", "--batch", "8", "--patience", "3")

    def stop(items, title, total):
        for item in items:
            if title == "epoch 3/4":
                raise KeyboardInterrupt
            yield item

    with monkeypatch.context() as patch:
        patch.setattr(command, "show_progress", stop)
        code, _, told, out = train(gestures, name="cut", quick=quick)
    assert code == 130 and "Give the same command again" in told and not out.exists()
    assert train(gestures, name="cut", quick=quick)[0] == 0
    code, *_, whole = train(gestures, name="whole", quick=quick)
    assert code == 0
    cut, one_go = load_model(out), load_model(whole)
    assert cut.classes == one_go.classes and cut.record["kept"] == one_go.record["kept"]
    for name, weights in one_go.weights.items():
        np.testing.assert_array_equal(cut.weights[name], weights)
    other = load_model(train(gestures, "--seed", "1", name="other", quick=quick)[-1])
    assert not np.array_equal(other.weights["fc1.weight"], cut.weights["fc1.weight"])


def test_training_on_needs_the_same_classes(trained, gestures, tmp_path, train):
    code, *_, out = train(gestures, "--start-from", trained, "--epochs", "1")
    assert code == 0 and load_model(out).config == load_model(trained).config
    write_set(tmp_path / "set", {"upright": 3, "slanted": 3})
    code, _, told, _ = train(tmp_path / "set", "--start-from", trained, name="other")
    assert code == 2 and "class slanted is unknown here; known are flat, upright" in told


def test_without_matplotlib_one_line_says_so(gestures, train, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    code, _, told, out = train(gestures, "--epochs", "1")
    assert code == 0 and told.count("matplotlib") == 1 and "pip install '.[plot]'" in told
    assert out.with_suffix(".json").exists() and not out.with_suffix(".curves.png").exists()
