"""`async-tnt train` on N-MNIST: from options to a model file, its messages and exit codes."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")

from small_sets import write_small_nmnist

from async_tnt.cli import main
from async_tnt.cli import train as command
from async_tnt.networks.model import load_model
from async_tnt.progress import Bar

WORDS = ("--epochs", "2", "--batch", "8", "--landmark", "line", "--t-max", "4", "--validation", "0.34", "--test")


@pytest.fixture(scope="session")
def nmnist(tmp_path_factory):
    """The ten samples as a small data set of the official layout: 3 of each digit in Train, 1 in Test."""
    return write_small_nmnist(tmp_path_factory.mktemp("N-MNIST"), n_train=3, first_number=1)


@pytest.fixture(scope="session")
def trained(nmnist, tmp_path_factory):
    """A trained model m.safetensors, and its run folder `run` beside it."""
    folder = tmp_path_factory.mktemp("trained")
    words = ["--nmnist", nmnist, *WORDS, "--out", folder / "m.safetensors", "--run", folder / "run"]
    assert main(["train", *map(str, words)]) == 0
    return folder


@pytest.fixture
def train(nmnist, tmp_path, program):
    """Train on that set; returns exit code, stdout, stderr and the model's file."""

    def run(*words, name="m"):
        out = tmp_path / f"{name}.safetensors"
        return *program("train", "--nmnist", nmnist, "--out", out, "--run", tmp_path / name, *words), out

    return run


def test_given_again_it_prints_the_same_result(nmnist, trained, program):
    out, run = trained / "m.safetensors", trained / "run"
    before = out.read_bytes()
    code, printed, err = program("train", "--nmnist", nmnist, *WORDS, "--out", out, "--run", run, "--json")
    summary = json.loads(printed)
    assert code == 0 and out.read_bytes() == before and "epoch" not in err
    assert summary["data"]["real_recordings"] == 20 and summary["data"]["held_out_recordings"] == 10
    assert summary["validation"]["recordings"] == 10 and summary["test"]["recordings"] == 10
    assert summary["test"]["windows"] == 30 == summary["test_windows_from_first_event"]["windows"]
    assert set(summary["test"]["against_time_ms"]) == {str(ms) for ms in range(10, 101, 10)}
    assert (
        summary["command"] == f"async-tnt train {' '.join(WORDS[-3:])} --landmark line --t-max 4.0 --epochs 2 --batch 8"
    )
    model = load_model(out)
    assert model.config.landmark == "line" and model.config.t_max == 4.0
    assert str(trained) not in json.dumps(dict(model.record))
    names = {"checkpoint.pt", "history.json", "curves.png", "last.safetensors", "best.safetensors"}
    assert {path.name for path in run.iterdir()} | {"curves.png"} == names


def test_a_run_with_other_settings_is_refused_before_the_data_is_read(nmnist, trained, program, monkeypatch):
    monkeypatch.setattr(command, "nmnist_data", lambda *given, **more: pytest.fail("the data was read"))
    words = ("--out", trained / "m.safetensors", "--run", trained / "run", "--seed", 1, "--t-max", 5)
    code, _, err = program("train", "--nmnist", nmnist, *WORDS, *words)
    assert code == 2 and err == (
        f"async-tnt: {trained / 'run'} holds a run with other seed, t_max; give another run folder "
        f"(train --run OTHER), or delete the folder {trained / 'run'} to start again\n"
    )


def test_smoke_needs_no_data(tmp_path, monkeypatch, program):
    monkeypatch.delenv("TNT_DATA", raising=False)
    out = tmp_path / "tiny.safetensors"
    code, printed, err = program("train", "--smoke", "--out", out, "--run", tmp_path / "run")
    assert code == 0 and f"wrote {out}" in printed
    assert "epoch 2/2  loss " in err and " by recording\n" in err
    model = load_model(out)
    assert model.record["epochs"] == 2 and model.config.landmark == "running"


def test_an_interrupted_training_resumes_to_the_same_weights(train, monkeypatch):
    words = ("--epochs", 2, "--batch", 8)

    class Interrupted(Bar):
        def update(self, n=1, title=None):
            super().update(n, title)
            if self.title == "epoch 2/2":
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(command, "progress", Interrupted)
        code, _, err, cut = train(*words, name="cut")
    assert code == 130 and "Give the same command again to resume" in err and not cut.exists()
    assert train(*words, name="cut")[0] == 0
    one_go = load_model(train(*words, name="whole")[-1])
    for name, weights in load_model(cut).weights.items():
        np.testing.assert_array_equal(weights, one_go.weights[name])


@pytest.mark.filterwarnings("default:left out:UserWarning")
def test_damaged_recordings_are_refused_before_training_or_left_out(tmp_path, program):
    nmnist = write_small_nmnist(tmp_path / "N-MNIST", n_train=3, first_number=1)
    torn = sorted((nmnist / "Test").rglob("*.bin"))[3]
    torn.write_bytes(torn.read_bytes()[:-2])
    words = ("--epochs", 1, "--test", "--run", tmp_path / "run", "--out", tmp_path / "m.safetensors")
    code, _, err = program("train", "--nmnist", nmnist, *words)
    assert code == 2 and torn.name in err and "--skip-damaged" in err and "epoch" not in err
    code, _, err = program("train", "--nmnist", nmnist, *words, "--skip-damaged")
    assert code == 0 and f"async-tnt: warning: left out: {torn}: damaged N-MNIST recording" in err
    assert load_model(tmp_path / "m.safetensors").record["test"]["recordings"] == 9


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "no data: give DATASET, a folder with a folder of recordings for each class, or --nmnist FOLDER, or set"),
        (["--smoke", "--out", "m.pt"], "--out must end in .safetensors, got m.pt"),
        (["--nmnist", "nowhere"], "no folder nowhere; give --nmnist FOLDER"),
        (["--nmnist", "."], "no folder Train in .; --nmnist must be the folder with N-MNIST's Train/<digit>/*.bin"),
        (["--smoke", "--t-max", "-1"], "`t_max` must be in"),
        (["--smoke", "--remove-flow"], '`remove_flow` needs landmark="line"'),
        (["--smoke", "--epochs", "0"], "`epochs` must be at least 1, got 0"),
        (["--smoke", "--out", "nowhere/m.safetensors"], "no folder nowhere to write m.safetensors to"),
        (["--smoke", "--test"], "--test must come without --smoke"),
        (["--smoke", "--start-from", "nowhere"], "no model file"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(words, text, tmp_path, monkeypatch, program):
    monkeypatch.delenv("TNT_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    code, _, err = program("train", *words)
    assert code == 2 and text in err and err.startswith("async-tnt: ") and err.count("\n") == 1


def test_without_torch_the_message_says_what_to_install(monkeypatch, program):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    code, _, err = program("train", "--smoke")
    assert code == 2 and "pip install '.[train]'" in err


def test_tnt_data_is_the_default_folder(nmnist, tmp_path, monkeypatch, program):
    (tmp_path / "nmnist").symlink_to(nmnist)
    monkeypatch.setenv("TNT_DATA", str(tmp_path))
    words = ("--epochs", 1, "--validation", 0.4, "--run", tmp_path / "run", "--out", tmp_path / "m.safetensors")
    code, printed, _ = program("train", *words)
    assert code == 0 and "held out:" in printed
    code, _, err = program("train", *words, "--simulated", 3)
    assert code == 2 and f"no folder {tmp_path / 'mnist'}; give --mnist FOLDER" in err


def test_continuing_takes_the_models_configuration_and_its_record(trained, train, tmp_path):
    code, *_, out = train("--epochs", 1, "--rate", 1e-4, "--start-from", trained / "m.safetensors")
    model, first = load_model(out), load_model(trained / "m.safetensors")
    assert code == 0 and model.config == first.config
    assert model.record["started_from"]["command"] == first.record["command"]
    assert "--rate 0.0001" in model.record["command"] and "--start-from m.safetensors" in model.record["command"]
    assert str(tmp_path) not in json.dumps(dict(model.record))
