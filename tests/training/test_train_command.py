"""`async-tnt train DATASET`: from a folder of class folders to a model that knows them."""

import argparse
import json
import re
import shutil
import sys

import numpy as np
import pytest
from training.gestures import bar, write, write_set

from async_tnt.networks.loading import load_model

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.base.files import locked_folder
from async_tnt.base.progress import Bar
from async_tnt.cli import train as command
from async_tnt.training import data as data_module


def test_the_model_knows_the_classes_and_its_numbers_and_pictures_are_beside_it(trained):
    model = load_model(trained)
    assert model.classes == ("flat", "upright")
    assert model.config.sensor == (128, 128) and model.config.grid == (34, 34)
    assert model.record["data"]["classes"] == {"flat": 12, "upright": 12}
    assert model.record["validation"]["recordings"] == 4  # a fifth, rounded, of each class
    report = json.loads(trained.with_suffix(".json").read_text())
    assert report["classes"] == ["flat", "upright"] and len(report["history"]) == 3
    confusion = np.array(report["confusion"])
    assert (
        confusion.sum() == len(report["held_out"]) == 4
        and report["accuracy"] == np.trace(confusion) / 4
    )
    test = model.record["test"]
    assert report["summary"]["test"] == test and test["recordings"] == 16
    assert test["per_recording"] >= 0.85  # chance: 0.5; 14 of 16 by luck: 1 in 480
    pytest.importorskip("matplotlib", reason="pictures need matplotlib (extra `plot`)")
    assert trained.with_suffix(".curves.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("share", "n_held_out"), [("0", 0), ("0.5", 6)])
def test_so_many_recordings_of_each_class_are_held_out_as_asked(share, n_held_out, tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 6, "flat": 6})
    code, _, out = train(folder, "--validation", share)
    assert code == 0
    report = json.loads(out.with_suffix(".json").read_text())
    assert len(report["held_out"]) == n_held_out
    validation = load_model(out).record.get("validation", {"recordings": 0})
    assert validation["recordings"] == n_held_out


def test_a_run_with_other_options_is_refused_before_recordings_are_read(
    tmp_path, train, monkeypatch
):
    folder = write_set(tmp_path / "set", {"upright": 3, "flat": 3})
    write(folder / "flat" / "silent.npz", bar("flat", 0)[:0])
    code, err, _ = train(folder)
    line = "left out: flat/silent.npz: no events"
    # when read, and at the end
    assert code == 0 and err.count(line) == 2 and err.splitlines()[-1].startswith(line)
    (folder / "flat" / "silent.npz").unlink()  # the run is the same
    assert train(folder)[0] == 0
    begin = f"async-tnt: {tmp_path / 'runs' / 'm'}: the folder holds a run with other "
    end = "; remove it to start again, or train into another file"

    def refused(*words):
        code, err, _ = train(folder, *words)
        line = err.splitlines()[-1]
        assert code == 2 and line.startswith(begin) and line.endswith(end), err
        return line.removeprefix(begin).removesuffix(end)

    write(folder / "upright" / "00.npy", bar("upright", 77)[:100])
    assert refused() == "data"
    with monkeypatch.context() as patch:
        patch.setattr(
            data_module,
            "dataset_data",
            lambda *given, **more: pytest.fail("the recordings were read"),
        )
        assert (
            refused("--seed", "1", "--window-us", "5000", "--network", "conv4")
            == "network, seed, window_us"
        )
    shutil.rmtree(tmp_path / "runs" / "m")
    code, err, out = train(folder, "--seed", "1")
    assert code == 0 and "epoch 1/1" in err
    assert load_model(out).record["command"].endswith("--seed 1")


@pytest.mark.parametrize("more", ["", "--crop", "--crop --mask mask.npy"])
def test_the_same_pixels_are_the_same_run_and_others_are_another(
    more, tmp_path, train, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    folder = write_set(tmp_path / "set", {"upright": 2, "flat": 2}, side=34)
    mask = np.zeros((34, 34), bool)
    mask[10, 12] = True
    np.save("mask.npy", mask)
    words = ("--sensor", "34x34", *more.split(), "--roi")
    assert train(folder, *words, "3,2,30,28")[0] == 0
    code, err, _ = train(folder, *words, "3,2,30,28")
    assert code == 0 and "epoch" not in err, err  # what is finished is not done again
    code, err, _ = train(folder, *words, "3,2,20,28")
    assert code == 2 and "the folder holds a run with other " in err, err


@pytest.fixture
def asked(train, monkeypatch):
    """What a command would train on and how: data, settings, and other motions."""
    given = []

    def fit(data, settings, *_, **more):
        given.append((data, settings, more["motions"]))
        raise ValueError("not trained")

    def run(folder, *words):
        code, err, _ = train(folder, *words)
        assert code == 2 and err.endswith("not trained\n"), err
        return given.pop()

    monkeypatch.setattr("async_tnt.training.fitting.fit", fit)
    return run


def test_options_that_decide_reach_the_training(tmp_path, asked):
    """Its settings, what is held out, and the pixels that are learned from."""
    folder = write_set(tmp_path / "set", {"upright": 4, "flat": 4}, side=34)
    words = ("--mirror", "--seed", 3, "--network", "conv4", "--validation", 0.5)
    words += ("--roi", "1,0,30,34", "--window-us", 50_000, "--groups", r"(\d\d)\.")
    data, settings, motions = asked(folder, *words)
    assert motions is None
    assert (settings.epochs, settings.seed, settings.network) == (1, 3, "conv4")
    assert settings.augmentation.mirror and not settings.everywhere
    assert (data.config.window_us, data.config.grid, data.config.sensor) == (
        50_000,
        (34, 34),
        (34, 34),
    )
    # by their numbers: the same ones of both classes
    assert len(data.held_out) == 4 and len({name[-6:-4] for name in data.held_out}) == 2
    assert data.training.recordings.x.min() >= 1 and data.training.recordings.x.max() <= 30
    assert data.record["pixels"]["roi"] == "1,0,30,34"


def test_recordings_are_read_by_the_options(tmp_path, asked):
    """Rows whose columns have no names, in another order."""
    for name in ("flat", "upright"):
        for k in range(2):
            events = bar(name, k, side=34, n=200)
            rows = np.column_stack([events[column] for column in "xypt"])
            path = tmp_path / "set" / name / f"{k}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savetxt(path, rows, fmt="%d", delimiter=",")
    data, *_ = asked(tmp_path / "set", "--sensor", "34x34", "--columns", "xypt")
    assert data.left_out == () and len(data.training.recordings) == 4
    np.testing.assert_array_equal(
        data.training.recordings.x[:200], bar("flat", 0, side=34, n=200)["x"]
    )


def test_a_model_of_another_program_is_not_replaced(gestures, train, tmp_path):
    (tmp_path / "m.safetensors").write_bytes(b"weights")
    code, err, _ = train(gestures)
    assert code == 2 and "m.safetensors is of another program" in err
    assert (tmp_path / "m.safetensors").read_bytes() == b"weights"


def test_a_second_command_in_a_run_folder_is_refused_before_the_recordings_are_read(
    gestures, train, tmp_path
):
    run = tmp_path / "runs" / "m"
    with locked_folder(run, "command.lock"):
        code, err, _ = train(gestures)
    line = f"{run}: another program is at work there; wait for that one, or give another folder"
    assert (code, err) == (2, f"async-tnt: {line}\n") and not run.exists()


def test_ctrl_c_keeps_the_finished_epochs(gestures, train, monkeypatch):
    class Interrupted(Bar):
        def update(self, n=1, title=None):
            super().update(n, title)
            if self.title == "epoch 2/2":
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(command, "progress", Interrupted)
        code, err, out = train(gestures, "--epochs", 2)
    assert code == 130 and "Give the same command again to resume" in err and not out.exists()
    code, err, _ = train(gestures, "--epochs", 2)
    assert code == 0 and "epoch 2/2" in err and "epoch 1/2" not in err


def test_given_again_it_prints_the_same_result(gestures, trained, program):
    before = trained.read_bytes()
    words = ("train", gestures, "--grid", "34x34", "--test", "--json")
    code, printed, err = program(*words, "--out", trained, "--epochs", 3)
    summary = json.loads(printed)
    assert code == 0 and trained.read_bytes() == before and "epoch" not in err
    assert summary["command"] == "async-tnt train --test --grid 34x34 --epochs 3"
    assert summary["validation"]["recordings"] == 4 and summary["test"]["recordings"] == 16
    assert str(trained.parent) not in json.dumps(summary["data"])


def test_without_torch_the_message_says_what_to_install(monkeypatch, program):
    monkeypatch.setitem(sys.modules, "torch", None)
    code, _, err = program("train", "nowhere")
    assert code == 2 and "pip install 'async_tnt[train]'" in err


REFUSED_EARLY = [
    (("--volume", "remove_flow=yes"), "remove_flow"),
    (
        ("--network", "conv5"),
        "must be one of thesis, conv4, residual, wide, separable, map, boxes, or "
        "FILE.py:FUNCTION; got 'conv5'",
    ),
    (("--motions", "resynthesized", "--roi", "0,0,9,9"), "--roi must come with --crop"),
    (("--volume", "landmark=line,t_max=2"), "--volume: landmark and t_max need transform=tnt"),
    (("--groups", "("), "--groups must be a regular expression, got '('"),
    (("--test",), "trials_to_test.txt; found neither"),
    (("--out", "DATASET/m.safetensors"), "--out must lie outside of "),
]
REFUSED = [
    (
        ("--sensor", "640x480"),
        "--sensor must be of the recordings' sensor, 34x34 (slanted/00.npz), got 640x480",
    ),
    (("--roi", "0,0,35,34", "--crop"), "must lie on the sensor of 34x34 pixels"),
]


@pytest.mark.parametrize(
    ("words", "message", "is_early"),
    [*((*row, True) for row in REFUSED_EARLY), *((*row, False) for row in REFUSED)],
)
def test_errors_are_one_line(words, message, is_early, program, tmp_path, monkeypatch):
    """The errors of options come before the recordings are read."""
    monkeypatch.chdir(tmp_path)
    if is_early:
        monkeypatch.setattr(
            data_module,
            "dataset_data",
            lambda *given, **more: pytest.fail("the recordings were read"),
        )
    write_set(tmp_path / "set", {"upright": 1, "slanted": 1}, suffixes=(".npz",), side=34)
    words = [word.replace("DATASET", "set") for word in words]
    code, _, err = program("train", "set", *words)
    assert code == 2 and message in err and err.count("\n") == 1, err
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


@pytest.mark.parametrize("out", ["set/Train/m", "set/Test/m", "link/m", "set/Test/deep/m"])
def test_a_model_is_not_written_into_the_folders_of_the_classes(out, program, tmp_path):
    """There the run folder would be a class. A link to such a folder is followed."""
    for part in ("Train", "Test"):
        write_set(tmp_path / "set" / part, {"upright": 1, "slanted": 1}, side=34)
    (tmp_path / "set" / "Test" / "deep").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "set" / "Train")
    before = sorted(tmp_path.rglob("*"))
    code, _, err = program("train", tmp_path / "set", "--out", tmp_path / f"{out}.safetensors")
    folder = "Test" if "Test" in out else "Train"
    assert code == 2 and err.count("\n") == 1
    assert f"--out must lie outside of {tmp_path / 'set' / folder}, in which a folder" in err
    assert sorted(tmp_path.rglob("*")) == before


def test_an_option_that_was_removed_is_none():
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    assert command.REMOVED and not command.REMOVED.keys() & parser._option_string_actions.keys()


def test_files_of_others_beside_the_model_stay(tmp_path, train):
    for name, content, lacking in (
        ("m.curves.png", "a picture", "m.json with "),
        (
            "m.json",
            '{"history": [], "summary": {}}',
            'm.json with "held_out", "summary", "history"',
        ),
        ("runs/m/history.json", "[]", 'history.json with "settings", "history"'),
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
        code, err, out = train("nowhere")
        message = (
            rf"{name} is of another program \(expected {lacking}.*\): move it away, or give "
            "another name$"
        )
        assert code == 2 and re.search(message, err) and err.count("\n") == 1 and not out.exists()
        assert path.read_text() == content
        path.unlink()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        # as long as the longest recording
        ("", ("none", "split", 1, (200, 150), (120, 90), 100_000)),
        (
            "--window-us 50000 --grid 20x16 --roi 10,0,128,128 --crop "
            "--volume representation=volume,transform=tnt,landmark=line,remove_flow=yes,"
            "polarity=signed,bins=5,t_max=2",
            ("tnt", "signed", 5, (128, 128), (20, 16), 50_000),
        ),
    ],
)
def test_the_volume_is_the_plain_one_unless_asked_otherwise(
    words, expected, tmp_path, program, few_steps
):
    write_set(tmp_path / "set", {"upright": 2, "flat": 2}, suffixes=(".npy",))
    out = tmp_path / "m.safetensors"
    words = ("--sensor", "200x150", "--out", out, "--epochs", 1, *words.split())
    assert program("train", tmp_path / "set", *words)[0] == 0
    model = load_model(out)
    found = model.config
    assert (
        found.transform,
        found.polarity,
        found.bins,
        found.sensor,
        found.grid,
        found.window_us,
    ) == expected
    assert model.record["network"] == "residual" and "--sensor 200x150" in model.record["command"]
