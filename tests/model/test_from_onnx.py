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
from async_tnt.networks.onnx_operations import RULES

onnx = pytest.importorskip("onnx", reason="needs onnx: pip install 'async_tnt[onnx]'")


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
        (
            [node("BatchNormalization", "x w w w w", training_mode=1)],
            [("w", np.ones(2, np.float32))],
            "node 'y' (BatchNormalization): a batch norm in training mode, or of each place, has no compiled form",
        ),
        (
            [node("Dropout", "x half yes")],
            [("half", np.float32(0.5)), ("yes", np.bool_(True))],
            "node 'y' (Dropout): a dropout in training mode has no compiled form",
        ),
        (
            [node("Relu", domain="my")],
            (),
            "node 'y' (Relu) is of the domain 'my', not ONNX's own; OnnxClassifier(path) runs",
        ),
        (
            [node("Flatten", "x", "f"), node("Softmax", "f", axis=0)],
            (),
            "node 'y' (Softmax): a softmax over axis 0, not over the classes (1), has no compiled form",
        ),
        (
            [node("Conv", "x w", auto_pad="VALID", pads=[1, 1, 1, 1])],
            [("w", np.ones((1, 2, 3, 3), np.float32))],
            "node 'y' (Conv): auto_pad VALID beside pads has no compiled form",
        ),
        (
            [node("Conv", "x w", kernel_shape=[3, 2])],
            [("w", np.ones((1, 2, 3, 3), np.float32))],
            "node 'y' (Conv): a kernel_shape other than that of the weights has no compiled form",
        ),
        *(
            (
                [node("Conv", "x w")],
                [("w", np.ones((1, 2, 3, 3), dtype))],
                f"node 'y' (Conv): 'w' of type {np.dtype(dtype)} beside an input of float32 has no compiled form",
            )
            for dtype in (bool, np.int64, np.complex64)
        ),
        (
            [node("Clip", "x low")],
            [("low", np.zeros(2, np.float32))],
            "node 'y' (Clip): a min other than one number has no compiled form",
        ),
        (
            [node("Reshape", "x shape")],
            [("shape", np.int64([2, -1]))],
            "node 'y' (Reshape): a reshape to [2, -1], not (n, -1), one row a volume, has no compiled form",
        ),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_a_node_without_a_compiled_form_is_refused_by_name(tmp_path, nodes, constants, message):
    path = tmp_path / "m.onnx"
    proto = graph_of(nodes, constants, [nodes[-1].output[0]])
    proto.opset_import.append(onnx.helper.make_opsetid("my", 1))
    if any(node.op_type == "BatchNormalization" for node in nodes):
        proto.opset_import[0].version = 14  # the first with training_mode
    path.write_bytes(proto.SerializeToString())
    with pytest.raises(NotImplementedError) as raised:
        load_model(path, config=SMALL)
    assert str(raised.value).startswith(f"{path}: {message}")


def test_a_file_is_compared_with_onnxruntime(tmp_path, monkeypatch):
    """Here with a rule that is wrong: ReLU read as nothing. Where onnxruntime is missing, a warning says so."""
    pytest.importorskip("onnxruntime")
    weights = [("w", np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32))]
    nodes = [node("Flatten", "x", "f"), node("MatMul", "f w", "d"), node("Relu", "d", "r"), node("Flatten", "r")]
    path = write_onnx(tmp_path / "m.onnx", nodes, weights)
    load_model(path, config=SMALL)
    monkeypatch.setitem(RULES, "Relu", RULES["Identity"])
    with pytest.raises(NotImplementedError, match=r"cannot be read as layers: its layers compute other numbers \(by"):
        load_model(path, config=SMALL)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.warns(UserWarning, match=r"m.onnx: its layers were not compared with the network itself, as onnxrun"):
        load_model(path, config=SMALL)


def test_operations_of_a_training_network_before_opset_14_are_refused(tmp_path):
    """They were told by the number of outputs."""
    training = onnx.helper.make_node("BatchNormalization", ["x", *4 * ["w"]], ["y", "m", "v", "sm", "sv"])
    path = write_onnx(tmp_path / "m.onnx", [training], [("w", np.ones(2, np.float32))])
    with pytest.raises(NotImplementedError, match="a batch norm in training mode"):
        load_model(path, config=SMALL)


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
    with pytest.raises(ImportError, match=r"^ONNX networks are read by onnx: pip install 'async_tnt\[onnx\]' \(.*\)$"):
        load_model(path, config=SMALL)
