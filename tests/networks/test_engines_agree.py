"""All engines give the compiled network's logits, landmarks and decisions, in Python and by `async-tnt run`."""

import json
import re
import sys

import numpy as np
import pytest
from made import random_events, random_regressor_model
from networks.cases import NETWORKS
from networks.foreign import network

from async_tnt import CompiledClassifier, load_model
from async_tnt.networks import OnnxClassifier, TorchClassifier, to_onnx
from async_tnt.networks.engines import choose_engine
from async_tnt.networks.torch_modules import torch_classifier
from async_tnt.sources.files.recording import sample_recordings

SAMPLES = [str(sample_recordings()[digit]) for digit in (3, 7)]


@pytest.mark.parametrize("tested", NETWORKS, ids=str)
def test_logits_are_the_same(tested):
    model, volume = tested.model(), tested.volume()
    compiled, *others = (
        CompiledClassifier(model),
        OnnxClassifier(to_onnx(model)),
        TorchClassifier(torch_classifier(model)),
    )
    for packet in [None, *np.split(random_events(900, sensor=tested.config.sensor, seed=4, duration_us=8000), 3)]:
        volume.update(packet)
        expected = compiled(volume.array)
        for engine in others:
            logits = engine(volume.array)
            assert logits.dtype == np.float32 and logits.shape == expected.shape
            assert np.abs(logits - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
            assert logits.argmax() == expected.argmax()
    assert volume.array.any()


# -- by name: `choose_engine` and `async-tnt run` ----------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """What `async-tnt export` makes of the bundled model."""
    path = tmp_path_factory.mktemp("engines") / "digits.ONNX"
    path.write_bytes(to_onnx(load_model("digits")).SerializeToString())
    return path


def decisions(program, *words):
    code, out, _ = program("run", *SAMPLES, "--json", "--every-us", 20_000, *words)
    assert code == 0
    rows = [json.loads(line) for line in out.splitlines()]
    return [row | {"latency_us": None, "probability": None} for row in rows]


def test_every_engine_decides_the_same(program, exported, tmp_path):
    """Also with a landmark network, which is always the compiled one."""
    with_landmark = random_regressor_model(seed=2).save(tmp_path / "m.safetensors")
    for model, of, engine in (
        ("digits", "digits", "onnx"),
        ("digits", "digits", "torch"),
        (exported, "digits", "onnx"),
        (with_landmark, with_landmark, "onnx"),
        (with_landmark, with_landmark, "torch"),
    ):
        expected = decisions(program, "--model", of)
        found = decisions(program, "--model", model, "--engine", engine)
        assert len(expected) > 20
        for ours, theirs in zip(found, expected, strict=True):
            assert ours == theirs | {"probabilities": pytest.approx(theirs["probabilities"], abs=1e-3)}


def assert_one_line(program, message, *words, command="run"):
    code, printed, error = program(command, SAMPLES[0], *words)
    assert (code, printed, error.count("\n")) == (2, "", 1) and error.startswith(f"async-tnt: {message}")


def test_files_that_do_not_belong_here_give_one_line(program, exported, tmp_path):
    m, foreign = exported, tmp_path / "foreign.onnx"
    foreign.write_bytes(network())
    no_config = f"{foreign}: an ONNX network without a configuration of this package, "
    assert_one_line(program, no_config, "--model", foreign)
    assert_one_line(program, "no file no.onnx", "--model", "no.onnx")
    assert_one_line(program, f"{m}: an .onnx file runs with engine onnx, not torch", "--model", m, "--engine", "torch")
    assert_one_line(program, f"{m}: an .onnx file can only be run", "--model", m, command="check")
    with pytest.raises(ValueError, match="`engine` must be one of compiled, onnx, torch, got 'steam'"):
        choose_engine("digits", "steam")


@pytest.mark.parametrize(
    "missing, engine, message",
    [
        ("onnxruntime", "onnx", "ONNX networks are run by onnxruntime"),
        ("onnx", "onnx", "ONNX networks are written by onnx and run by onnxruntime"),
        ("torch", "torch", "engine torch runs the reference network, which needs torch"),
    ],
)
def test_missing_packages_give_one_line(missing, engine, message, monkeypatch, program, exported):
    for name in list(sys.modules):
        if name.startswith(("async_tnt.training", "async_tnt.checking.reference")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    code, out, error = program("run", SAMPLES[0], "--engine", engine)
    assert (code, out) == (2, "")
    assert re.fullmatch(rf"async-tnt: {message}: pip install 'async_tnt\[\w+\]' \(.*\)\n", error)
    if missing == "onnx":  # which writes; onnxruntime runs
        assert program("run", SAMPLES[0], "--model", exported)[0] == 0
