"""`async-tnt train` on N-MNIST: from options to a model file, its messages and exit codes."""

import json
import shutil
import sys

import pytest

pytest.importorskip("torch")

from async_tnt.cli import main
from async_tnt.networks.loading import load_model

WORDS = ("--epochs", "2", "--batch", "8", "--landmark", "line", "--t-max", "4", "--validation", "0.25", "--test")


@pytest.fixture(scope="module")
def trained(nmnist, tmp_path_factory):
    """A trained model m.safetensors, and its run folder `run` beside it."""
    folder = tmp_path_factory.mktemp("trained")
    words = ["--nmnist", nmnist, *WORDS, "--out", folder / "m.safetensors", "--run", folder / "run"]
    assert main(["train", *map(str, words)]) == 0
    return folder


def test_given_again_it_prints_the_same_result(nmnist, trained, program):
    out, run = trained / "m.safetensors", trained / "run"
    before = out.read_bytes()
    code, printed, err = program("train", "--nmnist", nmnist, *WORDS, "--out", out, "--run", run, "--json")
    summary = json.loads(printed)
    assert code == 0 and out.read_bytes() == before and "epoch" not in err
    assert summary["data"]["real_recordings"] == 30 and summary["data"]["held_out_recordings"] == 10
    assert summary["validation"]["recordings"] == 10 and summary["test"]["recordings"] == 10
    assert summary["test"]["windows"] == 30 == summary["test_windows_from_first_event"]["windows"]
    assert set(summary["test"]["against_time_ms"]) == {*map(str, range(10, 101, 10)), "105"}
    assert (
        summary["command"] == f"async-tnt train {' '.join(WORDS[-3:])} --landmark line --t-max 4.0 --epochs 2 --batch 8"
    )
    model = load_model(out)
    assert model.config.landmark == "line" and model.config.t_max == 4.0
    assert str(trained) not in json.dumps(dict(model.record))
    names = {"checkpoint.pt", "history.json", "curves.png", "last.safetensors", "best.safetensors"}
    assert {path.name for path in run.iterdir()} | {"curves.png"} == names


def test_smoke_needs_no_data(tmp_path, monkeypatch, program):
    monkeypatch.delenv("TNT_DATA", raising=False)
    out = tmp_path / "tiny.safetensors"
    code, printed, err = program("train", "--smoke", "--out", out, "--run", tmp_path / "run")
    assert code == 0 and f"wrote {out}" in printed
    assert "epoch 2/2  loss " in err and " by recording\n" in err
    model = load_model(out)
    assert model.record["epochs"] == 2 and model.config.landmark == "running"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], ("volume", 9, "tnt", "signed")),
        (["--representation", "count"], ("count", 1, "none", "split")),
        (["--representation", "count", "--transform", "tnt", "--polarity", "signed"], ("count", 1, "tnt", "signed")),
        (["--representation", "mean_time"], ("mean_time", 1, "none", "split")),
    ],
)
def test_an_image_has_its_own_defaults(words, expected, tmp_path, program):
    out = tmp_path / "tiny.safetensors"
    code, _, _ = program("train", "--smoke", "--out", out, "--run", tmp_path / "run", *words)
    config = load_model(out).config
    assert (code, (config.representation, config.bins, config.transform, config.polarity)) == (0, expected)


@pytest.mark.filterwarnings("default:left out:UserWarning")
def test_damaged_recordings_of_the_default_folder_are_refused_or_left_out(nmnist, tmp_path, program, monkeypatch):
    shutil.copytree(nmnist, tmp_path / "nmnist")
    monkeypatch.setenv("TNT_DATA", str(tmp_path))
    torn = sorted((tmp_path / "nmnist" / "Test").rglob("*.bin"))[3]
    torn.write_bytes(torn.read_bytes()[:-2])
    words = ("train", "--epochs", 1, "--test", "--run", tmp_path / "run", "--out", tmp_path / "m.safetensors")
    code, _, err = program(*words)
    assert code == 2 and torn.name in err and "--skip-damaged" in err and "epoch" not in err
    code, _, err = program(*words, "--skip-damaged")
    assert code == 0 and f"async-tnt: warning: left out: {torn}: damaged N-MNIST recording" in err
    assert load_model(tmp_path / "m.safetensors").record["test"]["recordings"] == 9
    code, _, err = program(*words, "--simulated", 3, "--seed", 1, "--run", tmp_path / "other")
    assert code == 2 and f"no folder {tmp_path / 'mnist'}; give --mnist FOLDER" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no data: give DATASET, a folder with a folder of recordings for each class, or --nmnist FOLDER, or set"),
        (["--smoke", "--out", "m.pt"], "m.pt: its name must end in .safetensors"),
        (["--nmnist", "nowhere"], "no folder nowhere; give --nmnist FOLDER"),
        (["--smoke", "--remove-flow"], '--remove-flow needs landmark="line"'),
        (["--smoke", "--start-from", "digits", "--representation", "count"], "--representation must come without"),
        (["--smoke", "--test"], "--test must come without --smoke"),
        (["--smoke", "--partial", "2"], "--partial must be in [0, 1.0], got 2.0"),
        (["--smoke", "--grid", "20x20"], "--grid must come with DATASET"),
        (["--smoke", "--simulated", "9", "--saccades", "1"], "--simulated, --saccades must come without --smoke"),
        (["--mnist", "x"], "--mnist must come with --simulated N"),
        (["--smoke", "--no-augmentation", "--mirror"], "--mirror must come without --no-augmentation"),
        (["--epochs", "5", "--iterations", "100"], "--epochs and --iterations both set the length of training"),
        (["--smoke", "--start-from", "digits", "--remove-flow"], "--remove-flow must come without --start-from"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(words, message, tmp_path, monkeypatch, program):
    monkeypatch.delenv("TNT_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    code, _, err = program("train", *words)
    assert code == 2 and message in err and err.startswith("async-tnt: ") and err.count("\n") == 1


def test_without_torch_the_message_says_what_to_install(monkeypatch, program):
    monkeypatch.setitem(sys.modules, "torch", None)
    code, _, err = program("train", "--smoke")
    assert code == 2 and "pip install 'async_tnt[train]'" in err


def test_continued_training_keeps_the_models_configuration_and_record(nmnist, trained, tmp_path, program):
    out, first = tmp_path / "on.safetensors", trained / "m.safetensors"
    words = ("--epochs", 1, "--rate", 1e-4, "--start-from", first, "--out", out, "--run", tmp_path / "run")
    assert program("train", "--nmnist", nmnist, *words)[0] == 0
    model, first = load_model(out), load_model(first)
    assert model.config == first.config
    assert model.record["started_from"]["command"] == first.record["command"]
    assert "--rate 0.0001" in model.record["command"] and "--start-from m.safetensors" in model.record["command"]
    assert str(tmp_path) not in json.dumps(dict(model.record))
