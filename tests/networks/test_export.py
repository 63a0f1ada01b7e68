"""to_onnx, regressor_to_onnx, and the command `async-tnt export`."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from made import random_model, random_regressor_model
from networks.foreign import onnx

from async_tnt import CompiledClassifier, Model, TNTConfig, load_model
from async_tnt.checking import agreement
from async_tnt.networks import OnnxClassifier, onnx_export, regressor_to_onnx, to_onnx

REGRESSOR_MODEL = random_regressor_model(TNTConfig(landmark="regressor"), widths=(4, 4, 8), regressor_widths=(3, 4, 5))


@pytest.mark.parametrize("export, prefix", [(to_onnx, False), (regressor_to_onnx, True)])
def test_weights_are_initializers_bit_by_bit_and_each_files_own(export, prefix):
    model = REGRESSOR_MODEL
    found = {w.name: onnx.numpy_helper.to_array(w) for w in export(model).graph.initializer}
    assert found.keys() & model.weights.keys() == {n for n in model.weights if n.startswith("regressor.") == prefix}
    for name in found.keys() & model.weights.keys():
        assert found[name].dtype == np.float32 and found[name].tobytes() == model.weights[name].tobytes()


def test_metadata_come_back():
    config = TNTConfig(sensor=(40, 30), grid=(20, 16), bins=3, polarity="split", landmark="line", remove_flow=True)
    weights = random_model(config, classes=3, widths=(2, 3, 4)).weights
    model = Model(config, weights, ("null", 'ein\n"s"', "二"), {"seed": 5, "said": ["ü", 1.5, None]})
    net = OnnxClassifier(to_onnx(model))
    assert (net.config, net.classes, net.exported.record) == (config, model.classes, model.record)


def test_what_cannot_be_exported(monkeypatch):
    with pytest.raises(ValueError, match=r"the model has no regressor: .* got landmark='running', transform='tnt'"):
        regressor_to_onnx(random_model())
    monkeypatch.setattr(onnx_export, "MAX_BYTES", 1000)
    with pytest.raises(ValueError, match=r"less than 2 GiB, the classifier's weights are [\d_]+ bytes"):
        to_onnx(random_model())
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(
        ImportError, match=r"^ONNX networks are written by onnx and run by .* 'async_tnt\[onnx\]' \(.*\)$"
    ):
        to_onnx(random_model())


# -- the command -------------------------------------------------------------------------------------------


def test_export_writes_the_file_and_checks_it(tmp_path, program):
    out = tmp_path / "digits.onnx"
    code, text, _ = program("export", "digits", "--out", out)
    first, second = text.splitlines()
    assert code == 0 and os.listdir(tmp_path) == ["digits.onnx"]
    assert first == f"{out} ({out.stat().st_size / 1e3:.0f} kB): volume (1, 9, 34, 34) -> logits (1, 10)"
    assert "30 windows of bundled samples: logits within " in second and second.endswith("no classes differ")
    assert out.read_bytes() == to_onnx(load_model("digits")).SerializeToString()
    report = json.loads(program("export", "digits", "--out", out, "--json")[1])
    assert report["agrees"] and report["files"] == {str(out): out.stat().st_size} and report["windows"] == 30
    assert 0 < report["largest_logit_difference"] <= 1e-4 and report["classes_that_differ"] == 0


def test_a_regressor_of_others_stays(tmp_path, program):
    model = REGRESSOR_MODEL.save(tmp_path / "m.safetensors")
    (tmp_path / "m.regressor.onnx").write_bytes(b"of others")
    code, _, err = program("export", model, "--out", tmp_path / "m.onnx")
    assert code == 2 and "m.regressor.onnx is of another program (expected m.regressor.onnx with async_tnt" in err
    assert (tmp_path / "m.regressor.onnx").read_bytes() == b"of others" and not (tmp_path / "m.onnx").exists()


def test_export_of_a_model_with_a_regressor(tmp_path, program):
    path = REGRESSOR_MODEL.save(tmp_path / "m.safetensors")
    report = json.loads(program("export", path, "--out", tmp_path / "m.onnx", "--json")[1])
    assert sorted(os.listdir(tmp_path)) == ["m.onnx", "m.regressor.onnx", "m.safetensors"]
    assert list(report["files"]) == [str(tmp_path / "m.onnx"), str(tmp_path / "m.regressor.onnx")]
    assert 0 < report["largest_landmark_difference_px"] <= 1e-4


@pytest.mark.parametrize("function, name", [("to_onnx", "fc2.bias"), ("regressor_to_onnx", "regressor.conv1.weight")])
def test_nothing_is_written_where_the_networks_do_not_agree(function, name, tmp_path, monkeypatch, program):
    right = getattr(onnx_export, function)
    wrong = {**REGRESSOR_MODEL.weights, name: REGRESSOR_MODEL.weights[name] * np.float32(1.01)}
    monkeypatch.setattr(onnx_export, function, lambda model: right(replace(model, weights=wrong)))
    path, out = REGRESSOR_MODEL.save(tmp_path / "m.safetensors"), tmp_path / "m.onnx"
    out.write_bytes(b"what was there")
    code, text, _ = program("export", path, "--out", out)
    assert code == 1 and text.endswith("they do NOT agree: nothing is written\n")
    assert sorted(os.listdir(tmp_path)) == ["m.onnx", "m.safetensors"] and out.read_bytes() == b"what was there"


def test_one_class_that_differs_is_one_too_many():
    model = random_model(classes=3)
    network, calls = CompiledClassifier(model), []

    def sometimes_wrong(volume):
        calls.append(1)
        logits = network(volume)
        return -logits if len(calls) == 7 else logits

    found = agreement.compare_engines(model, sometimes_wrong)
    assert found.n_differ == 1 and not found.logits.holds
    found = agreement.compare_engines(model, network)
    assert found.n_differ == 0 and found.holds
    found.n_differ = 1  # two logits that are nearly equal, and another one is the largest
    assert found.logits.holds and not found.holds
    assert not agreement.compare_engines(model, lambda volume: network(volume) * np.nan).holds


@pytest.mark.parametrize(
    "model, out, message",
    [
        ("digits", "m.pt", "{}/m.pt: its name must end in .onnx"),
        ("digits", "no/m.onnx", "no folder {}/no to write m.onnx to"),
        ("digits", "folder.onnx", "{}/folder.onnx is not a regular file; only those are replaced: give another name"),
    ],
)
def test_wrong_arguments_give_one_line(model, out, message, tmp_path, program):
    (tmp_path / "folder.onnx").mkdir()
    assert program("export", model, "--out", tmp_path / out) == (2, "", f"async-tnt: {message.format(tmp_path)}\n")
    assert os.listdir(tmp_path) == ["folder.onnx"]


def test_onnxruntime_sends_and_keeps_nothing_about_its_use(tmp_path):
    """Its telemetry, on by default, writes below the home folder when a session is made."""
    code = (
        "from async_tnt import load_model\nfrom async_tnt.networks import OnnxClassifier, to_onnx\n"
        "OnnxClassifier(to_onnx(load_model('digits')))"
    )
    env = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    env |= {"HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    subprocess.run([sys.executable, "-c", code], env=env, check=True)
    assert not list(tmp_path.rglob("*onnxruntime*"))
