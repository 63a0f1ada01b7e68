"""to_onnx, regressor_to_onnx, and the command `async-tnt export`."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from engines.foreign import onnx
from made import random_model, random_regressor_model

from async_tnt import CompiledClassifier, Model, TNTConfig, load_model
from async_tnt.checking.agreement import compare_engines
from async_tnt.cli import main
from async_tnt.networks import onnx_export
from async_tnt.networks.onnx_export import regressor_to_onnx, to_onnx
from async_tnt.networks.onnx_network import OnnxClassifier, OnnxRegressor

REGRESSOR_MODEL = random_regressor_model(TNTConfig(landmark="regressor"), widths=(4, 4, 8), regressor_widths=(3, 4, 5))


def test_the_graph_is_the_one_of_the_equation():
    made = to_onnx(load_model("digits"))
    assert [node.op_type for node in made.graph.node] == [
        "Conv",
        "Relu",
        "AveragePool",
        "Conv",
        "Relu",
        "AveragePool",
        "Flatten",
        "Gemm",
        "Relu",
        "Gemm",
    ]
    (volume,), (logits,) = made.graph.input, made.graph.output
    assert (volume.name, _sides(volume)) == ("volume", [1, 9, 34, 34])
    assert (logits.name, _sides(logits)) == ("logits", [1, 10])
    assert made.ir_version <= 8 and made.opset_import[0].version <= 17
    onnx.checker.check_model(made, full_check=True)


def _sides(value):
    return [side.dim_value for side in value.type.tensor_type.shape.dim]


def test_weights_are_initializers_bit_by_bit():
    model = load_model("digits")
    weights = {w.name: onnx.numpy_helper.to_array(w) for w in to_onnx(model).graph.initializer}
    assert weights.keys() == model.weights.keys()
    for name, w in weights.items():
        assert w.dtype == np.float32 and np.array_equal(w, model.weights[name])


def test_each_file_holds_the_weights_of_its_network_only():
    for made, prefix in ((to_onnx(REGRESSOR_MODEL), False), (regressor_to_onnx(REGRESSOR_MODEL), True)):
        names = {w.name for w in made.graph.initializer} & REGRESSOR_MODEL.weights.keys()
        assert names == {name for name in REGRESSOR_MODEL.weights if name.startswith("regressor.") == prefix}


def test_the_same_model_gives_the_same_bytes():
    first, second = (to_onnx(random_model(seed=4)).SerializeToString() for _ in range(2))
    assert first == second != to_onnx(random_model(seed=5)).SerializeToString()


def test_metadata_come_back():
    config = TNTConfig(
        sensor=(40, 30), grid=(20, 16), bins=3, polarity="split", t_max=2.5, landmark="line", remove_flow=True
    )
    made = random_model(config, classes=3, widths=(2, 3, 4))
    model = Model(config, made.weights, ("null", 'ein\n"s"', "二"), {"seed": 5, "said": ["ü", 1.5, None]})
    net = OnnxClassifier(to_onnx(model))
    assert (net.config, net.classes) == (config, model.classes)
    assert net.exported.record == model.record and net.exported.network == "classifier"


def test_two_networks_of_one_model_know_each_other():
    marks = {
        net.exported.weights
        for net in (OnnxClassifier(to_onnx(REGRESSOR_MODEL)), OnnxRegressor(regressor_to_onnx(REGRESSOR_MODEL)))
    }
    assert len(marks) == 1
    weights = {**REGRESSOR_MODEL.weights, "fc2.bias": REGRESSOR_MODEL.weights["fc2.bias"] + 1}
    other = replace(REGRESSOR_MODEL, weights=weights)
    assert OnnxRegressor(regressor_to_onnx(other)).exported.weights not in marks


def test_only_a_model_with_a_regressor_has_one():
    with pytest.raises(ValueError, match=r"the model has no regressor: .* got landmark='running', transform='tnt'"):
        regressor_to_onnx(random_model())


def test_weights_too_large_for_one_file(monkeypatch):
    monkeypatch.setattr(onnx_export, "MAX_BYTES", 1000)
    with pytest.raises(ValueError, match=r"less than 2 GiB, the classifier's weights are [\d_]+ bytes"):
        to_onnx(random_model())


# -- the command -------------------------------------------------------------------------------------------


def test_export_writes_checks_and_says(tmp_path, capsys):
    out = tmp_path / "digits.onnx"
    assert main(["export", "digits", "--out", str(out)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"{out} ({out.stat().st_size / 1e3:.0f} kB): volume (1, 9, 34, 34) -> logits (1, 10)"
    assert "30 windows of bundled samples: logits within " in said[1] and said[1].endswith("no classes differ")
    assert os.listdir(tmp_path) == ["digits.onnx"]
    assert out.read_bytes() == to_onnx(load_model("digits")).SerializeToString()


def test_export_json(tmp_path, capsys):
    out = tmp_path / "m.onnx"
    assert main(["export", "digits", "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["agrees"] and report["files"] == {str(out): out.stat().st_size} and report["windows"] == 30
    assert 0 < report["largest_logit_difference"] <= 1e-4 and report["classes_that_differ"] == 0
    assert report["largest_landmark_difference_px"] is None


def test_export_of_a_model_with_a_regressor(tmp_path, capsys):
    path = REGRESSOR_MODEL.save(tmp_path / "m.safetensors")
    assert main(["export", str(path), "--out", str(tmp_path / "m.onnx"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert sorted(os.listdir(tmp_path)) == ["m.onnx", "m.regressor.onnx", "m.safetensors"]
    assert 0 < report["largest_landmark_difference_px"] <= 1e-4
    assert list(report["files"]) == [str(tmp_path / "m.onnx"), str(tmp_path / "m.regressor.onnx")]
    assert main(["export", str(path), "--out", str(tmp_path / "m.onnx")]) == 0
    said = capsys.readouterr().out
    assert "m.regressor.onnx (" in said and "-> landmark (1, 2)\n" in said and "landmarks within " in said


def test_a_model_for_another_sensor_is_checked_on_made_streams(tmp_path, capsys):
    model = random_model(TNTConfig(sensor=(60, 40), grid=(30, 20), bins=4), classes=5, widths=(3, 4, 5))
    path = model.save(tmp_path / "m.safetensors")
    assert main(["export", str(path), "--out", str(tmp_path / "m.onnx"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["recordings"] == "made streams" and report["windows"] >= 6
    assert 0 < report["largest_logit_difference"] <= 1e-4


@pytest.mark.parametrize(
    "network, name",
    [("to_onnx", "conv1.weight"), ("to_onnx", "fc2.bias"), ("regressor_to_onnx", "regressor.conv1.weight")],
)
@pytest.mark.parametrize("existing", [None, b"what was there"])
def test_nothing_is_written_where_the_networks_do_not_agree(network, name, existing, tmp_path, monkeypatch, capsys):
    right = getattr(onnx_export, network)
    wrong = {**REGRESSOR_MODEL.weights, name: REGRESSOR_MODEL.weights[name] * np.float32(1.01)}
    monkeypatch.setattr(onnx_export, network, lambda model: right(replace(model, weights=wrong)))
    path = REGRESSOR_MODEL.save(tmp_path / "m.safetensors")
    out = tmp_path / "m.onnx"
    if existing:
        out.write_bytes(existing)
    assert main(["export", str(path), "--out", str(out)]) == 1
    assert capsys.readouterr().out.endswith("they do NOT agree: nothing is written\n")
    assert sorted(os.listdir(tmp_path)) == (["m.onnx"] if existing else []) + ["m.safetensors"]
    assert not existing or out.read_bytes() == existing
    assert main(["export", str(path), "--out", str(out), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["agrees"] is False and report["files"] == {}


def test_one_class_that_differs_is_one_too_many():
    model = random_model(classes=3)
    network, calls = CompiledClassifier(model), []

    def sometimes_wrong(volume):
        calls.append(1)
        logits = network(volume)
        return -logits if len(calls) == 7 else logits

    agreement = compare_engines(model, sometimes_wrong)
    assert agreement.n_differ == 1 and not agreement.logits.holds
    agreement = compare_engines(model, network)
    assert agreement.n_differ == 0 and agreement.holds
    agreement.n_differ = 1  # two logits that are nearly equal, and another one is the largest
    assert agreement.logits.holds and not agreement.holds
    assert compare_engines(model, network).holds
    assert not compare_engines(model, lambda volume: network(volume) * np.nan).holds


@pytest.mark.parametrize(
    "argv, message",
    [
        (["digits", "--out", "{}/m.pt"], "--out must end in .onnx, got {}/m.pt"),
        (["digits", "--out", "{}/no/m.onnx"], "no folder {}/no to write m.onnx to"),
        (["digits", "--out", "{}/folder.onnx"], "{}/folder.onnx is a folder, expected a regular file or a new name"),
        (["digitz", "--out", "{}/m.onnx"], "no model file digitz, and no bundled model of that name (bundled: digits)"),
        (
            ["{}/x.onnx", "--out", "{}/m.onnx"],
            "{}/x.onnx: an .onnx file can only be run (async-tnt run --model); here "
            "a bundled model (digits) or a .safetensors file is needed",
        ),
    ],
)
def test_wrong_arguments_give_one_line(argv, message, tmp_path, capsys):
    (tmp_path / "folder.onnx").mkdir()
    assert main(["export", *(word.format(tmp_path) for word in argv)]) == 2
    assert capsys.readouterr() == ("", f"async-tnt: {message.format(tmp_path)}\n")
    assert os.listdir(tmp_path) == ["folder.onnx"]


@pytest.mark.parametrize(
    "missing, message",
    [
        ("onnx", "ONNX networks are written by onnx and run by onnxruntime: pip install '.[onnx]' ("),
        ("onnxruntime", "ONNX networks are run by onnxruntime: pip install '.[onnx]' ("),
    ],
)
def test_export_without_its_packages(missing, message, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, missing, None)
    assert main(["export", "digits", "--out", str(tmp_path / "m.onnx")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"async-tnt: {message}") and said.count("\n") == 1
    assert not os.listdir(tmp_path)


def test_to_onnx_without_onnx(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(
        ImportError,
        match=r"^ONNX networks are written by onnx and run by onnxruntime: pip install '\.\[onnx\]' \(.*\)$",
    ):
        to_onnx(random_model())


def test_an_interrupted_export_leaves_nothing(tmp_path, monkeypatch, capsys):
    from async_tnt.networks import agreement

    def interrupt(*arguments):
        assert os.listdir(tmp_path) == ["m.onnx.part"]
        raise KeyboardInterrupt

    monkeypatch.setattr(agreement, "compare_engines", interrupt)
    assert main(["export", "digits", "--out", str(tmp_path / "m.onnx")]) == 130
    assert not os.listdir(tmp_path)


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
