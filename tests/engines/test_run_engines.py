"""`async-tnt run` by other engines, and with .onnx files; imports."""

import json
import subprocess
import sys

import pytest
from engines.foreign import network
from made import random_regressor_model

from async_tnt import TNTConfig
from async_tnt.cli import main
from async_tnt.engines import choose_engine
from async_tnt.sources.files.recording import sample_recordings

SAMPLES = [str(sample_recordings()[digit]) for digit in (3, 7)]


def decisions(capsys, *argv):
    assert main(["run", *SAMPLES, "--json", "--every-us", "20000", *argv]) == 0, capsys.readouterr().err
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.fixture
def exported(tmp_path, capsys):
    path = tmp_path / "net.ONNX"
    assert main(["export", "digits", "--out", str(path)]) == 0
    capsys.readouterr()
    return path


def assert_same_decisions(got, expected, atol=1e-5):
    assert len(got) == len(expected) > 20
    for ours, theirs in zip(got, expected, strict=True):
        assert ours["probabilities"] == pytest.approx(theirs["probabilities"], abs=atol)
        for one in (ours, theirs):
            del one["latency_us"], one["probability"], one["probabilities"]
        assert ours == theirs


def test_every_engine_decides_the_same(capsys, exported):
    expected = decisions(capsys)
    for argv in (
        ["--engine", "compiled"],
        ["--engine", "onnx"],
        ["--engine", "torch"],
        ["--model", str(exported)],
        ["--model", str(exported), "--engine", "onnx"],
    ):
        assert_same_decisions(decisions(capsys, *argv), [dict(d) for d in expected])


def test_text_has_the_classes_of_the_file(capsys, exported):
    assert main(["run", SAMPLES[1], "--model", str(exported)]) == 0
    assert "7.bin: 7 (mean probability" in capsys.readouterr().out


def test_a_model_with_a_regressor(tmp_path, capsys):
    path = str(random_regressor_model(TNTConfig(landmark="regressor"), seed=2).save(tmp_path / "m.safetensors"))
    assert main(["export", path, "--out", str(tmp_path / "m.onnx")]) == 0
    capsys.readouterr()
    expected = decisions(capsys, "--model", path)
    for argv in (
        ["--model", path, "--engine", "onnx"],
        ["--model", path, "--engine", "torch"],
        ["--model", str(tmp_path / "m.onnx")],
    ):
        assert_same_decisions(decisions(capsys, *argv), [dict(d) for d in expected], atol=1e-3)

    other = str(random_regressor_model(TNTConfig(landmark="regressor"), seed=3).save(tmp_path / "o.safetensors"))
    assert main(["export", other, "--out", str(tmp_path / "o.onnx")]) == 0
    (tmp_path / "o.regressor.onnx").replace(tmp_path / "m.regressor.onnx")
    assert_one_line(
        capsys,
        ["--model", f"{tmp_path}/m.onnx"],
        f"{tmp_path}/m.regressor.onnx is not the landmark network of {tmp_path}/m.onnx: they are of two models",
    )
    assert_one_line(
        capsys,
        ["--model", f"{tmp_path}/o.onnx"],
        f"no file {tmp_path}/o.regressor.onnx: the landmark network of {tmp_path}/o.onnx, which `export` "
        "wrote beside it",
    )


def assert_one_line(capsys, argv, message, command="run"):
    capsys.readouterr()
    assert main([command, SAMPLES[0], *argv]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err == f"async-tnt: {message}\n"


def test_a_foreign_network_lacks_a_configuration(tmp_path, capsys):
    path = tmp_path / "foreign.onnx"
    path.write_bytes(network())
    assert_one_line(
        capsys,
        ["--model", str(path)],
        f"{path}: an ONNX network without a configuration of this package, which says how events become its volume; a "
        "Python program can give one: Processor(TNTConfig(...), classifier=OnnxClassifier(path))",
    )


def test_wrong_files_and_engines_give_one_line(tmp_path, capsys, exported):
    assert_one_line(capsys, ["--model", "no.onnx"], "no file no.onnx")
    assert_one_line(
        capsys,
        ["--model", str(exported), "--engine", "torch"],
        f"{exported}: an .onnx file runs by engine onnx, not torch; that runs the .safetensors file or bundled model "
        "it was made from",
    )
    assert_one_line(
        capsys,
        ["--model", str(exported)],
        f"{exported}: an .onnx file can only be run (async-tnt run --model); here a bundled model (digits) or a "
        ".safetensors file is needed",
        "check",
    )
    exported.write_bytes(exported.read_bytes()[:-1000])
    assert main(["run", "--model", str(exported)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"async-tnt: {exported} is not a readable ONNX network: ") and said.count("\n") == 1
    with pytest.raises(SystemExit):
        main(["run", "--engine", "steam"])
    assert "invalid choice: 'steam'" in capsys.readouterr().err
    with pytest.raises(ValueError, match="`engine` must be one of compiled, onnx, torch, got 'steam'"):
        choose_engine("digits", "steam")


@pytest.mark.parametrize(
    "missing, argv, message",
    [
        ("onnxruntime", ["--engine", "onnx"], "ONNX networks are run by onnxruntime: pip install '.[onnx]' ("),
        (
            "onnx",
            ["--engine", "onnx"],
            "ONNX networks are written by onnx and run by onnxruntime: pip install '.[onnx]' (",
        ),
        (
            "torch",
            ["--engine", "torch"],
            "engine torch runs the reference network, which needs torch: pip install '.[reference]' (",
        ),
    ],
)
def test_missing_packages_give_one_line(missing, argv, message, monkeypatch, capsys):
    for name in list(sys.modules):
        if name.startswith(("async_tnt.training", "async_tnt.checking.reference")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert main(["run", SAMPLES[0], *argv]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"async-tnt: {message}") and said.count("\n") == 1


def test_a_file_runs_without_onnx(exported, monkeypatch, capsys):
    """onnx writes, onnxruntime runs."""
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert main(["run", SAMPLES[0], "--model", str(exported)]) == 0


def test_nothing_is_imported_before_it_is_asked():
    code = (
        "import sys, async_tnt.networks, async_tnt.cli.run, async_tnt.cli.export; "
        "print([name for name in ('onnx', 'onnxruntime', 'torch') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
