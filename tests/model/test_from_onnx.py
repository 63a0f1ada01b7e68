"""ONNX files of this and of other programs compute what they computed there, or are refused by name."""

import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from incremental.random_networks import random_models
from model.modules import CONFIG, EVEN_KERNEL, MODULES, VOLUMES, logits_of, module_of
from model.small import SMALL

from async_tnt import CompiledClassifier, TNTConfig, load_model
from async_tnt.networks import OnnxClassifier, to_onnx

onnx = pytest.importorskip("onnx", reason="needs onnx: pip install '.[onnx]'")


@given(random_models())
def test_every_model_can_be_exported_and_read_again(tmp_path_factory, model):
    """onnxruntime computes the same logits; the layers that come back do, too."""
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("onnx") / "m.onnx"
    path.write_bytes(to_onnx(model).SerializeToString())
    volume = np.random.default_rng(1).normal(size=model.config.shape).astype(np.float32)
    logits = CompiledClassifier(model)(volume)
    tolerance = 1e-4 * max(1, np.abs(logits).max())
    assert np.abs(OnnxClassifier(path)(volume) - logits).max() <= tolerance
    again = load_model(path)
    assert (again.config, again.classes) == (model.config, model.classes)
    assert np.abs(CompiledClassifier(again)(volume) - logits).max() <= tolerance


@EVEN_KERNEL
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", MODULES)
def test_what_torch_exports_to_onnx_computes_the_same(name, tmp_path):
    if name == "sequential":
        pytest.skip("torch does not export divisor_override")
    module, path = module_of(name), tmp_path / "net.onnx"
    torch.onnx.export(module.eval(), torch.tensor(VOLUMES[:1]), str(path), dynamo=False)
    model = load_model(path, config=CONFIG)
    assert model.classes == ("0", "1", "2", "3")
    found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
    assert np.abs(found - logits_of(module)).max() <= 1e-5


def graph_of(nodes, constants=(), outputs=("y",)):
    make = onnx.helper
    graph = make.make_graph(
        nodes,
        "made",
        [make.make_tensor_value_info("x", 1, [1, 2, 6, 5])],
        [make.make_tensor_value_info(name, 1, ["a", "b"]) for name in outputs],
        [onnx.numpy_helper.from_array(np.asarray(w), name) for name, w in constants],
    )
    return make.make_model(graph, opset_imports=[make.make_opsetid("", 13)], ir_version=7)


def node(op, inputs="x", output="y", **attributes):
    return onnx.helper.make_node(op, inputs.split(), [output], **attributes)


def write_onnx(path, *arguments):
    path.write_bytes(graph_of(*arguments).SerializeToString())
    return path


def test_constants_matrices_and_a_softmax(tmp_path):
    """(2 x + (1, -1)) summed over places by a matrix; the softmax at the end is left out."""
    rng = np.random.default_rng(0)
    matrix, shift = rng.normal(size=(60, 3)).astype(np.float32), np.float32([[[1]], [[-1]]])
    nodes = [
        node("Mul", "two x", "a"),
        node("Add", "a shift", "b"),
        node("Reshape", "b shape", "c"),
        node("MatMul", "c matrix", "d"),
        node("Add", "d bias", "e"),
        node("Softmax", "e"),
    ]
    constants = {
        "two": np.float32(2),
        "shift": shift,
        "shape": [1, -1],
        "matrix": matrix,
        "bias": np.float32([1, 2, 3]),
    }
    path = write_onnx(tmp_path / "m.onnx", nodes, constants.items())
    model = load_model(path, config=SMALL, classes=["a", "b", "c"])
    volume = rng.normal(size=SMALL.shape).astype(np.float32)
    expected = (2 * volume + shift).reshape(-1) @ matrix + [1, 2, 3]
    assert np.abs(CompiledClassifier(model)(volume) - expected).max() <= 1e-4


@pytest.mark.parametrize(
    "nodes, constants, message",
    [
        (
            [node("Sigmoid")],
            (),
            "node 'y' (Sigmoid) has no compiled form; OnnxClassifier(path) runs any network, whole",
        ),
        ([node("Mul", "x x")], (), "node 'y' (Mul): a product of two maps has no compiled form"),
        ([node("Softmax"), node("Flatten", "y", "z")], (), "node 'y' (Softmax) has no compiled form"),
        (
            [node("Add", "x big")],
            [("big", np.ones((1, 2, 6, 5), np.float32))],
            "node 'y' (Add): a constant of shape (1, 2, 6, 5) here has no compiled form",
        ),
        ([node("Concat", "x x", axis=2)], (), "node 'y' (Concat): axis 2, not channels (1), has no compiled form"),
        (
            [node("AveragePool", kernel_shape=[3, 3], pads=[1] * 4)],
            (),
            "node 'y' (AveragePool): padding without count_in",
        ),
        (
            [node("PRelu", "x slope")],  # one for each column
            [("slope", np.ones(5, np.float32))],
            "node 'y' (PRelu): a slope of shape (5,) has no compiled form",
        ),
        (
            [node("Add", "one one")],
            [("one", np.ones(1, np.float32))],
            "node 'y' (Add): a sum other than of one map and a constant, or of maps, has no compiled form",
        ),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_a_node_without_a_compiled_form_is_refused_by_name(tmp_path, nodes, constants, message):
    path = write_onnx(tmp_path / "m.onnx", nodes, constants, [nodes[-1].output[0]])
    with pytest.raises(NotImplementedError) as raised:
        load_model(path, config=SMALL)
    assert str(raised.value).startswith(f"{path}: {message}")


def test_weights_in_a_file_beside_are_read_there(tmp_path, monkeypatch):
    """Not those of the same name in the current folder."""
    found = []
    for name, factor in (("a", 1.0), ("b", -1.0)):
        (tmp_path / name).mkdir()
        weights = [("w", np.full((60, 3), factor, np.float32))]
        proto = graph_of([node("Flatten", "x", "f"), node("MatMul", "f w")], weights)
        path = tmp_path / name / "net.onnx"
        onnx.save_model(proto, path, save_as_external_data=True, location="net.onnx.data", size_threshold=0)
        found.append(path)
    monkeypatch.chdir(tmp_path / "b")
    volume = np.ones(SMALL.shape, np.float32)
    logits = [CompiledClassifier(load_model(path, config=SMALL))(volume).tolist() for path in found]
    assert logits == [[60.0] * 3, [-60.0] * 3]


def test_what_load_model_refuses_of_onnx(tmp_path, monkeypatch):
    path = write_onnx(tmp_path / "m.onnx", [node("Flatten")])
    with pytest.raises(TypeError, match=r"does not say how events become its volume: load_model\(path, config=TNTConf"):
        load_model(path)
    ours = tmp_path / "ours.onnx"
    ours.write_bytes(to_onnx(load_model("digits")).SerializeToString())
    with pytest.raises(TypeError, match=r"^`config` and `classes` are for networks of other programs; .* has its own$"):
        load_model(ours, config=SMALL)
    with pytest.raises(TypeError, match=r"^`config` and `classes` are for \.onnx networks; .* has its own$"):
        load_model("digits", config=SMALL)
    content = bytearray(ours.read_bytes())
    content[5000] ^= 1
    ours.write_bytes(content)
    with pytest.raises(ValueError, match=r"is damaged|is not a readable"):
        load_model(ours)
    with pytest.raises(
        ValueError, match=r"m.onnx: the network's input must be the volume, N x \(9, 34, 34\), got N x \(2,"
    ):
        load_model(path, config=TNTConfig())
    (tmp_path / "no.onnx").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="is not a readable ONNX network"):
        load_model(tmp_path / "no.onnx", config=SMALL)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ImportError, match=r"^ONNX networks are read by onnx: pip install '\.\[onnx\]' \(.*\)$"):
        load_model(path, config=SMALL)
