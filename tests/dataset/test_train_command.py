"""`async-tnt train DATASET`: from a folder of class folders to a model that knows them."""

import json

import numpy as np
import pytest
from dataset.gestures import bar, write, write_set

from async_tnt.networks.model import load_model

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.cli import train as command
from async_tnt.progress import Bar


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
    code, _, err, out = train(tmp_path / "set", quick=("--epochs", "10", "--batch", "8", "--patience", "0"))
    assert code == 0 and "recordings: flat 6, slanted 5, upright 24" in err
    code, printed, _ = program("evaluate", out, tmp_path / "test", "--json")
    per_class = json.loads(printed)["per_class"]
    assert code == 0 and min(per_class.values()) >= 0.6, per_class


@pytest.mark.parametrize(
    ("side", "suffixes", "words"),
    [(34, (".bin", ".npy", ".npz", ".csv"), ()), (128, (".bin", ".npy"), ("--sensor", "128x128"))],
)
def test_bins_mix_with_other_formats(side, suffixes, words, tmp_path, train):
    """A .bin is of 34x34 pixels, or of the option's: N-Caltech101's are of another camera."""
    write_set(tmp_path / "set", {"upright": 4, "flat": 4}, suffixes=suffixes, side=side)
    code, _, _, out = train(tmp_path / "set", *words)
    model = load_model(out)
    assert code == 0 and model.config.sensor == (side, side)
    assert model.record["data"]["classes"] == {"flat": 4, "upright": 4} and model.record["data"]["left_out"] == []


def test_bins_of_another_camera_need_the_option(tmp_path, train):
    write_set(tmp_path / "set", {"upright": 5, "flat": 5}, suffixes=(".bin",))
    code, _, err, _ = train(tmp_path / "set")
    assert code == 2 and err.count("\n") == 1 and err.startswith("async-tnt: ")
    assert "or say its sensor if it is of another camera; and 9 more)" in err
    assert "sensor=" not in err and "strict" not in err  # advice for Python


def test_a_run_with_other_recordings_is_refused_before_they_are_read(tmp_path, train, monkeypatch):
    folder = write_set(tmp_path / "set", {"upright": 3, "flat": 3})
    write(folder / "flat" / "silent.npz", bar("flat", 0)[:0])
    assert train(folder)[0] == 0
    (folder / "flat" / "silent.npz").unlink()  # it was left out: the run is the same
    assert train(folder)[0] == 0
    monkeypatch.setattr(command, "dataset_data", lambda *given, **more: pytest.fail("the recordings were read"))
    run = tmp_path / "run m"

    def refused(*words):
        code, _, err, _ = train(folder, *words)
        end = f"; give another run folder (train --run OTHER), or delete the folder {run} to start again\n"
        assert code == 2 and err.startswith(f"async-tnt: {run} holds a run with other ") and err.endswith(end)
        return err.removeprefix(f"async-tnt: {run} holds a run with other ").removesuffix(end)

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


def test_the_option_gives_the_sensor_where_no_recording_states_it(tmp_path, train):
    write_set(tmp_path / "set", {"upright": 4, "flat": 4}, suffixes=(".npy",))
    code, _, err, _ = train(tmp_path / "set")
    assert code == 2 and "give --sensor WxH (the events need at least 1" in err
    code, _, err, _ = train(tmp_path / "set", "--sensor", "64x64")
    assert code == 2 and "left out: flat/00.npy: every event must lie on the 64x64 sensor, got x = " in err
    words = ("--sensor", "240x180", "--grid", "20x16", "--window-us", "50000")
    code, _, _, out = train(tmp_path / "set", *words)
    config = load_model(out).config
    assert code == 0 and (config.sensor, config.grid, config.window_us) == ((240, 180), (20, 16), 50_000)
    assert "--sensor 240x180 --grid 20x16 --window-us 50000" in load_model(out).record["command"]


def test_long_recordings_have_several_windows_and_short_ones_a_partial_one(tmp_path, train):
    for k in range(5):
        write(tmp_path / "set" / "upright" / f"{k}.npz", bar("upright", k, duration_us=500_000, start_us=7_000_000_000))
        write(tmp_path / "set" / "flat" / f"{k}.npz", bar("flat", k, duration_us=20_000))
    code, _, err, _ = train(tmp_path / "set")
    # one of five is held out of each class: 4 x 5 windows of 105 ms and 4 partial ones
    assert code == 0 and "24 windows to train on, 6 held out" in err


def test_train_and_test_folders(tmp_path, train):
    write_set(tmp_path / "set" / "Train", {"upright": 5, "flat": 5})
    code, _, err, _ = train(tmp_path / "set", "--test")
    assert code == 2 and "--test needs a folder Test" in err
    write_set(tmp_path / "set" / "Test", {"upright": 3}, seed=1)
    code, _, _, out = train(tmp_path / "set", "--test")
    assert code == 0 and load_model(out).record["test"]["recordings"] == 3
    write_set(tmp_path / "set" / "Test", {"slanted": 1})
    code, _, err, _ = train(tmp_path / "set", "--test", name="other")
    assert code == 2 and "unknown class slanted; known are flat, upright" in err


def test_empty_recordings_and_copies_are_left_out_and_named(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 5, "flat": 5})
    nothing = bar("flat", 0)[:0]
    write(folder / "flat" / "silent.npz", nothing)
    write(folder / "flat" / "zz.npy", np.load(folder / "flat" / "00.npy"))  # a name of both classes, and a copy
    (folder / "flat" / "notes.md").write_text("no recording")
    (folder / ".cache").mkdir()
    code, _, err, out = train(folder)
    assert code == 0 and load_model(out).record["data"]["classes"] == {"flat": 5, "upright": 5}
    assert "left out: flat/silent.npz: no events" in err
    assert "left out: flat/zz.npy: the same events as flat/00.npy" in err


def test_a_class_of_one_recording_is_learned_and_not_held_out(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 5, "flat": 1})
    code, _, err, _ = train(folder)
    assert code == 0 and "not held out, as there is only one recording: flat" in err
    code, _, err, out = train(write_set(tmp_path / "two", {"upright": 5, "flat": 2}), name="two")
    assert code == 0 and "not held out" not in err and load_model(out).record["data"]["held_out_recordings"] == 2


def test_an_unreadable_recording_is_left_out_and_named_at_the_end(tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 4, "flat": 4})
    (folder / "flat" / "torn.npy").write_bytes((folder / "flat" / "00.npy").read_bytes()[:-7])
    (folder / "upright" / "text.csv").write_text("t,x,y,p\n1,2,3,1\n2,3,words,0\n")
    (folder / "upright" / "what.raw").write_bytes(b"no recording")
    code, printed, err, out = train(folder)
    assert code == 0 and "wrote " in printed
    lines = err.splitlines()
    named = lines[-3:]
    for line, start in zip(
        named,
        (
            "left out: flat/torn.npy: not a readable NumPy file: ",
            "left out: upright/text.csv: damaged recording: line 3: ",
            "left out: upright/what.raw: its first bytes are not those of a known format",
        ),
        strict=True,
    ):
        assert line.startswith(start), err
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
        (("DATASET", "--sensor", "640x480"), "of one sensor, got 640x480 (--sensor) and 128x128 (flat/01.npz)"),
        (("DATASET", "--patience", "-1"), "`patience` must be at least 1, got -1"),
        (("DATASET", "--batch", "0"), "`batch` must be at least 1, got 0"),
        (("nowhere",), "no folder nowhere"),
        (("DATASET", "--out", "q.pt"), "--out must end in .safetensors, got q.pt"),
    ],
)
def test_errors_are_one_line(words, text, gestures, program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = program("train", *(str(gestures) if word == "DATASET" else word for word in words))
    assert code == 2 and text in err, err


@pytest.mark.parametrize("size", ["128", "0x5"])
def test_a_size_is_two_numbers(size, program, capsys):
    with pytest.raises(SystemExit) as stopped:
        program("train", "set", "--sensor", size)
    err = capsys.readouterr().err
    assert stopped.value.code == 2 and "--sensor: must be WIDTHxHEIGHT" in err and f"got {size!r}" in err


def test_an_interrupted_training_resumes_to_the_same_model(gestures, train, monkeypatch):
    quick = ("--epochs", "4", "--batch", "8", "--patience", "3")

    class Interrupted(Bar):
        def update(self, n=1, title=None):
            super().update(n, title)
            if self.title == "epoch 3/4":
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(command, "progress", Interrupted)
        code, _, err, cut = train(gestures, name="cut", quick=quick)
    assert code == 130 and "Give the same command again to resume" in err and not cut.exists()
    assert train(gestures, name="cut", quick=quick)[0] == 0
    whole = train(gestures, name="whole", quick=quick)[-1]
    for suffix in (".safetensors", ".json"):
        assert cut.with_suffix(suffix).read_bytes() == whole.with_suffix(suffix).read_bytes()
    other = load_model(train(gestures, "--seed", "1", name="other", quick=quick)[-1])
    assert not np.array_equal(other.weights["fc1.weight"], load_model(cut).weights["fc1.weight"])


def test_training_on_needs_the_same_classes(trained, gestures, tmp_path, train):
    code, *_, out = train(gestures, "--start-from", trained, "--epochs", "1")
    assert code == 0 and load_model(out).config == load_model(trained).config
    write_set(tmp_path / "set", {"upright": 3, "slanted": 3})
    code, _, err, _ = train(tmp_path / "set", "--start-from", trained, name="other")
    assert code == 2 and "unknown class slanted; known are flat, upright" in err


def test_without_matplotlib_one_line_says_so(gestures, train, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    code, _, err, out = train(gestures, "--epochs", "1")
    assert code == 0 and err.count("matplotlib") == 1 and "pip install '.[plot]'" in err
    assert out.with_suffix(".json").exists() and not out.with_suffix(".curves.png").exists()


def test_the_test_folder_is_of_the_same_sensor_and_read_before_training(tmp_path, train):
    write_set(tmp_path / "set" / "Train", {"upright": 4, "flat": 4}, suffixes=(".npz",), side=64)
    write_set(tmp_path / "set" / "Test", {"upright": 2, "flat": 2}, seed=1, side=64)
    other = write(tmp_path / "set" / "Test" / "flat" / "other.npz", bar("flat", 9, side=60), sensor=(80, 60))
    code, _, err, _ = train(tmp_path / "set", "--test")
    assert code == 2 and "epoch" not in err
    assert "of one sensor, got 64x64 (the recordings to train on) and 80x60 (flat/other.npz)" in err
    other.write_bytes(b"torn")
    code, _, err, out = train(tmp_path / "set", "--test")
    record = load_model(out).record
    (line,) = record["test"]["left_out"]
    assert code == 0 and line.startswith("flat/other.npz: ") and record["data"]["left_out"] == []
    assert err.splitlines()[-1] == f"left out: Test/{line}" and err.count(f"Test/{line}") == 2
    assert record["test"]["recordings"] == 4
    assert json.loads(out.with_suffix(".json").read_text())["summary"]["test"] == record["test"]
    code, _, err, _ = train(tmp_path / "set", "--start-from", out, "--sensor", "70x70", name="on")
    assert code == 2 and "--sensor must be the one of --start-from, 64x64, got 70x70" in err


@pytest.mark.parametrize("error", [ValueError("no such thing"), KeyboardInterrupt()])
def test_the_model_is_written_before_it_is_tested(error, gestures, tmp_path, train, monkeypatch):
    from async_tnt.training import evaluation

    write_set(tmp_path / "set" / "Train", {"upright": 4, "flat": 4})
    write_set(tmp_path / "set" / "Test", {"upright": 2, "flat": 2}, seed=1)
    evaluate, n_calls = evaluation.evaluate, []

    def fail_on_test(*given, **more):
        n_calls.append(1)
        if len(n_calls) == 2:
            raise error
        return evaluate(*given, **more)

    monkeypatch.setattr(evaluation, "evaluate", fail_on_test)
    code, _, err, out = train(tmp_path / "set", "--test")
    assert code == (130 if isinstance(error, KeyboardInterrupt) else 2) and len(n_calls) == 2, err
    record = load_model(out).record
    assert record["validation"]["recordings"] == 2 and "test" not in record
    assert json.loads(out.with_suffix(".json").read_text())["accuracy"] >= 0
    for name in ("best", "last"):
        assert load_model(tmp_path / "run m" / f"{name}.safetensors").classes == ("flat", "upright")
