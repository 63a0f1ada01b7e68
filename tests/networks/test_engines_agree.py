"""All engines give the compiled network's logits, landmarks and decisions.

They do so in Python and by `async-tnt run`.
"""

import json
import re
import sys

import numpy as np
import pytest
from made import random_events, random_regressor_model
from networks.cases import NETWORKS
from networks.foreign import network

from async_tnt import CompiledClassifier, CompiledRegressor, Processor, load_model
from async_tnt.networks import OnnxClassifier, TorchClassifier, to_onnx
from async_tnt.networks.models.torch_modules import landmark_function, torch_classifier
from async_tnt.sources.files.recording import open_recording, sample_recordings

SAMPLES = [str(sample_recordings()[digit]) for digit in (3, 7)]


@pytest.mark.parametrize("tested", NETWORKS, ids=str)
def test_logits_are_the_same(tested):
    model = tested.model()
    volume = tested.volume()
    compiled = CompiledClassifier(model)
    others = [OnnxClassifier(to_onnx(model)), TorchClassifier(torch_classifier(model))]
    events = random_events(900, sensor=tested.config.sensor, seed=4, duration_us=8000)
    for packet in [None, *np.split(events, 3)]:
        volume.update(packet)
        expected = compiled(volume.array)
        for engine in others:
            logits = engine(volume.array)
            assert logits.dtype == np.float32 and logits.shape == expected.shape
            assert np.abs(logits - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
            assert logits.argmax() == expected.argmax()
    assert volume.array.any()


# -- `async-tnt run` of .onnx files ----------------------------------------------------------------


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


def test_an_exported_network_decides_the_same(program, exported):
    expected = decisions(program)
    found = decisions(program, "--model", exported)
    assert len(expected) > 20
    for ours, theirs in zip(found, expected, strict=True):
        assert ours == theirs | {"probabilities": pytest.approx(theirs["probabilities"], abs=1e-3)}


@pytest.mark.parametrize("engine", ["onnx", "torch"])
def test_other_engines_decide_the_same_with_a_landmark_network(engine):
    model = random_regressor_model(seed=2)
    classifier = (
        OnnxClassifier(to_onnx(model))
        if engine == "onnx"
        else TorchClassifier(torch_classifier(model))
    )
    regressor = CompiledRegressor(model) if engine == "onnx" else landmark_function(model)
    ours = Processor(model, every_us=20_000)
    other = Processor(model, classifier=classifier, regressor=regressor, every_us=20_000)
    events = open_recording(SAMPLES[0]).read()
    pairs = list(
        zip(ours.push(events) + ours.finish(), other.push(events) + other.finish(), strict=True)
    )
    assert len(pairs) > 10
    for one, same in pairs:
        assert (one.time_us, one.events, one.label) == (same.time_us, same.events, same.label)
        np.testing.assert_allclose(one.probabilities, same.probabilities, atol=1e-3)


def assert_one_line(program, message, *words, command="run"):
    code, printed, error = program(command, SAMPLES[0], *words)
    assert (code, printed, error.count("\n")) == (2, "", 1)
    assert error.startswith(f"async-tnt: {message}")


def test_files_that_do_not_belong_here_give_one_line(program, exported, tmp_path):
    m = exported
    foreign = tmp_path / "foreign.onnx"
    foreign.write_bytes(network())
    no_config = f"--config must be given for {foreign}, an ONNX network of another program, "
    assert_one_line(program, no_config, "--model", foreign)
    assert_one_line(program, "no file no.onnx", "--model", "no.onnx")
    assert_one_line(
        program, f"{m}: an .onnx file is for run and view", "--model", m, command="check"
    )


@pytest.mark.parametrize(
    "missing, words, message",
    [
        ("onnxruntime", "run --model EXPORTED", "ONNX networks are run by onnxruntime"),
        (
            "onnx",
            "export digits --out new.onnx",
            "ONNX networks are written by onnx and run by onnxruntime",
        ),
    ],
)
def test_missing_packages_give_one_line(
    missing, words, message, monkeypatch, program, exported, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, missing, None)
    code, out, error = program(*words.replace("EXPORTED", str(exported)).split())
    assert (code, out) == (2, "")
    assert re.fullmatch(rf"async-tnt: {message}: pip install 'async_tnt\[onnx\]' \(.*\)\n", error)
    # The package onnx is needed to write a file, but not to run it.
    if missing == "onnx":
        assert program("run", SAMPLES[0], "--model", exported)[0] == 0
