"""`async-tnt train`: from arguments to a model file, its messages and exit codes."""

import argparse
import json
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small_sets import write_small_nmnist  # noqa: E402

from async_tnt.cli import train as command  # noqa: E402
from async_tnt.networks.model import load_model  # noqa: E402


def run(*words):
    parser = argparse.ArgumentParser(prog="async-tnt train")
    command.add_arguments(parser)
    return command.main(parser.parse_args([str(word) for word in words]))


def test_the_time_left_is_told_from_the_second_epoch_on(nmnist, tmp_path, monkeypatch, capsys):
    now = iter(range(0, 100_000, 100))  # every look at the clock is 100 s after the one before
    clock = SimpleNamespace(monotonic=lambda: next(now))  # of this module alone: other threads look at theirs
    monkeypatch.setattr(command, "time", clock)
    words = ["--nmnist", nmnist, "--epochs", 3, "--batch", 8, "--run", tmp_path / "run"]
    assert run(*words, "--out", tmp_path / "m.safetensors") == 0
    first, second, third = (line for line in capsys.readouterr().err.splitlines() if line.startswith("epoch "))
    assert "left)" not in first and second.endswith(" min left)") and third.endswith("(0 s left)")


def test_a_run_of_other_settings_is_refused_before_the_data_is_read(nmnist, tmp_path, monkeypatch, capsys):
    words = ["--nmnist", nmnist, "--epochs", 1, "--batch", 8, "--run", tmp_path / "run"]
    words += ["--out", tmp_path / "m.safetensors"]
    assert run(*words) == 0
    assert run(*words) == 0  # the same again goes on, here from the end
    capsys.readouterr()
    monkeypatch.setattr(command, "read_folder", lambda *given, **more: pytest.fail("the data was read"))
    assert run(*words, "--seed", 1, "--t-max", 4) == 2
    printed = capsys.readouterr().err
    assert "holds a run with other seed, t_max; give" in printed or "with other t_max, seed; give" in printed
    assert f"(train --run OTHER), or delete the folder {tmp_path / 'run'} to start anew" in printed


@pytest.fixture
def nmnist(tmp_path):
    """The ten samples as a small data set of the official layout: 3 of each digit in Train, 1 in Test."""
    return write_small_nmnist(tmp_path / "N-MNIST", n_train=3, first_number=1)


def test_smoke_needs_no_data(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("TNT_DATA", raising=False)
    out = tmp_path / "tiny.safetensors"
    assert run("--smoke", "--out", out, "--run", tmp_path / "run") == 0
    model = load_model(out)
    assert model.record["epochs"] == 2 and model.config.landmark == "running"
    assert f"wrote {out}" in capsys.readouterr().out
    assert {"checkpoint.pt", "history.json", "last.safetensors", "best.safetensors"} <= {
        path.name for path in (tmp_path / "run").iterdir()
    }


def test_train_and_test_on_a_folder(nmnist, tmp_path, capsys):
    words = [
        "--nmnist",
        nmnist,
        "--epochs",
        2,
        "--batch",
        8,
        "--landmark",
        "line",
        "--t-max",
        4,
        "--validation",
        0.34,
        "--test",
        "--json",
        "--run",
        tmp_path / "run",
    ]
    assert run(*words, "--out", tmp_path / "m.safetensors") == 0
    printed = capsys.readouterr()
    summary = json.loads(printed.out)
    assert summary["data"]["real_recordings"] == 20 and summary["data"]["held_out_recordings"] == 10
    assert summary["validation"]["recordings"] == 10 and summary["test"]["recordings"] == 10
    assert summary["test"]["windows"] == 30
    assert set(summary["test"]["against_time_ms"]) == {str(ms) for ms in range(10, 101, 10)}
    assert summary["command"] == (
        "async-tnt train --validation 0.34 --test --landmark line --t-max 4.0 --epochs 2 --batch 8"
    )
    model = load_model(tmp_path / "m.safetensors")
    assert model.config.landmark == "line" and model.config.t_max == 4.0
    assert str(tmp_path) not in json.dumps(dict(model.record))
    assert "epoch 2/2" in printed.err and "by recording" in printed.err


def test_a_damaged_test_folder_does_not_cost_the_model(nmnist, tmp_path, capsys):
    torn = sorted((nmnist / "Test").rglob("*.bin"))[3]
    torn.write_bytes(torn.read_bytes()[:-2])
    words = ("--nmnist", nmnist, "--epochs", 1, "--test", "--run", tmp_path / "run", "--out")
    assert run(*words, tmp_path / "m.safetensors") == 2
    assert torn.name in capsys.readouterr().err
    record = load_model(tmp_path / "m.safetensors").record
    assert record["epochs"] == 1 and "test" not in record


def test_an_interruption_says_how_to_go_on(nmnist, tmp_path, monkeypatch, capsys):
    words = ["--nmnist", nmnist, "--epochs", 2, "--batch", 8, "--run", tmp_path / "run", "--out"]
    whole = ["--nmnist", nmnist, "--epochs", 2, "--batch", 8, "--run", tmp_path / "whole", "--out"]

    def stop(items, title, total):
        for item in items:
            if title == "epoch 2/2":
                raise KeyboardInterrupt
            yield item

    with monkeypatch.context() as patch:
        patch.setattr(command, "show_progress", stop)
        assert run(*words, tmp_path / "cut.safetensors") == 130
    assert "Give the same command again to go on" in capsys.readouterr().err
    assert not (tmp_path / "cut.safetensors").exists()
    assert run(*words, tmp_path / "cut.safetensors") == 0
    assert run(*whole, tmp_path / "whole.safetensors") == 0
    cut, one_go = load_model(tmp_path / "cut.safetensors"), load_model(tmp_path / "whole.safetensors")
    for name in one_go.weights:
        np.testing.assert_array_equal(cut.weights[name], one_go.weights[name])


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "no data: give DATASET, a folder with a folder of recordings for each class, or --nmnist FOLDER, or set"),
        (["--smoke", "--out", "m.pt"], "--out must end in .safetensors, got m.pt"),
        (["--nmnist", "nowhere"], "no folder nowhere; give --nmnist FOLDER"),
        (["--smoke", "--t-max", "-1"], "`t_max` must be in"),
        (["--smoke", "--remove-flow"], '`remove_flow` needs landmark="line"'),
        (["--smoke", "--epochs", "0"], "`epochs` must be at least 1, got 0"),
        (["--smoke", "--out", "nowhere/m.safetensors"], "no folder nowhere to write m.safetensors to"),
        (["--smoke", "--test"], "--test needs N-MNIST's folder Test"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("TNT_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    assert run(*words) == 2
    printed = capsys.readouterr().err
    assert text in printed and printed.startswith("async-tnt: ") and printed.count("\n") == 1


def test_a_folder_without_train_is_explained(nmnist, capsys):
    assert run("--nmnist", nmnist / "Train") == 2
    assert "--nmnist must be the folder with N-MNIST's Train/<digit>/*.bin" in capsys.readouterr().err


def test_without_torch_the_message_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    assert run("--smoke") == 2
    assert "pip install '.[train]'" in capsys.readouterr().err


def test_tnt_data_is_the_default_folder(nmnist, tmp_path, monkeypatch, capsys):
    (tmp_path / "nmnist").symlink_to(nmnist)
    monkeypatch.setenv("TNT_DATA", str(tmp_path))
    words = ["--epochs", 1, "--validation", 0.4, "--run", tmp_path / "run", "--out", tmp_path / "m.safetensors"]
    assert run(*words) == 0
    assert "held out:" in capsys.readouterr().out
    assert run(*words, "--simulated", 3) == 2
    assert f"no folder {tmp_path / 'mnist'}; give --mnist FOLDER" in capsys.readouterr().err


def test_training_on_takes_the_models_configuration_and_says_so(nmnist, tmp_path, capsys):
    words = ["--nmnist", nmnist, "--epochs", 1, "--batch", 8]
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    assert run(*words, "--landmark", "center", "--t-max", 5, "--out", first, "--run", tmp_path / "a") == 0
    assert run(*words, "--rate", 1e-4, "--start-from", first, "--out", second, "--run", tmp_path / "b") == 0
    model = load_model(second)
    assert model.config == load_model(first).config and model.config.t_max == 5.0
    assert model.record["started_from"]["command"].endswith("--landmark center --t-max 5.0 --epochs 1 --batch 8")
    assert "--rate 0.0001" in model.record["command"] and "first.safetensors" in model.record["command"]
    assert str(tmp_path) not in json.dumps(dict(model.record))
    capsys.readouterr()
    assert run(*words, "--start-from", tmp_path / "nowhere", "--run", tmp_path / "c") == 2
    assert "no model file" in capsys.readouterr().err
