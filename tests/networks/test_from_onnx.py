"""ONNX files of this and of other programs compute what they computed there.

Those that cannot are refused by name.
"""

import json
import re
import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from made import random_events
from networks.foreign import load_for_numbers, network, onnx
from networks.modules import CONFIG, EVEN_KERNEL, VOLUMES, branches
from networks.random_networks import random_models
from networks.small import SMALL

from async_tnt import CompiledClassifier, Model, TNTConfig, load_model
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.engines import choose_engine
from async_tnt.networks.onnx.operations import RULES


@given(random_models())
def test_every_model_can_be_exported_and_read_again(tmp_path_factory, model):
    """onnxruntime computes the same logits; the layers come back as they were."""
    path = tmp_path_factory.mktemp("onnx") / "m.onnx"
    path.write_bytes(to_onnx(model).SerializeToString())
    volume = np.random.default_rng(1).normal(size=model.config.shape).astype(np.float32)
    logits = CompiledClassifier(model)(volume)
    tolerance = 1e-4 * max(1, np.abs(logits).max())
    assert np.abs(OnnxClassifier(path)(volume) - logits).max() <= tolerance
    again = load_model(path)
    assert (again.config, again.classes) == (model.config, model.classes)
    assert CompiledClassifier(again)(volume).tobytes() == logits.tobytes()


# -- node by node; of any form: test_random_networks.py --------------------------------------------


def node(op, inputs="x", output="y", **attributes):
    names = ["" if name == "-" else name for name in inputs.split()]
    return onnx.helper.make_node(op, names, output.split(), **attributes)


def write_onnx(path, nodes, constants=None, output="y", opset=13, shape=(1, 2, 6, 5)):
    content = network(
        nodes, inputs=[("x", shape)], outputs=[(output, ("a", "b"))], weights=constants, opset=opset
    )
    path.write_bytes(content)
    return path


ONES = np.ones(2, np.float32)
KERNEL = np.ones((1, 2, 3, 3), np.float32)
HALF = np.float32(0.5)
YES = np.bool_(True)
REFUSED = [  # nodes, constants, message, opset
    (
        [node("Sin")],
        {},
        "(Sin) has no compiled form; OnnxClassifier(path) runs any float32 network of logits",
        13,
    ),
    (
        [node("Relu", domain="my")],
        {},
        "(Relu) is of the domain 'my', not ONNX's own; OnnxClassifier(path) runs",
        13,
    ),
    (
        [node("Transpose", "x", perm=[0, 1, 3, 2])],
        {},
        "(Transpose): a transposition by [0, 1, 3, 2] has no compiled form",
        13,
    ),
    ([node("Div", "x x")], {}, "(Div): a quotient other than of a map by a constant has no", 13),
    *(
        (
            [node("Flatten", "x", "f"), node("Gemm", "f w b", **attributes)],
            {"w": np.ones((60, 2), np.float32), "b": ONES},
            "(Gemm): this Gemm has no compiled form",
            13,
        )
        for attributes in ({"alpha": 0.5}, {"beta": 2.0}, {"transA": 1})
    ),
    (
        [
            node(
                "AveragePool",
                kernel_shape=[3, 3],
                ceil_mode=1,
                count_include_pad=1,
                pads=[1, 1, 1, 1],
            )
        ],
        {},
        "(AveragePool): ceil_mode with padding that counts has no compiled form",
        13,
    ),
    ([node("Log")], {}, "(Log): a logarithm of other than x + 1 has no compiled form", 13),
    (
        [node("HardSigmoid")],
        {},
        "(HardSigmoid): alpha 0.2 and beta 0.5, not 1/6 and 1/2, has no compiled form",
        13,
    ),
    (
        [node("Shrink", lambd=0.25)],
        {},
        "(Shrink): lambd 0.25 and bias 0.0, not one number from 0 on, has no compiled form",
        13,
    ),
    (
        [node("BatchNormalization", "x w w w w", training_mode=1)],
        {"w": ONES},
        "(BatchNormalization): a batch",
        14,
    ),
    (
        [node("BatchNormalization", "x w w w w", spatial=0)],
        {"w": ONES},
        "(BatchNormalization): a batch norm in training mode, or of each place, has",
        8,
    ),
    (
        [node("BatchNormalization", "x w w w w", "y m v a b")],
        {"w": ONES},
        "(BatchNormalization): a batch norm in training mode, or of each place, has",
        13,
    ),
    (
        [node("Shrink", lambd=-0.25, bias=-0.25)],
        {},
        "(Shrink): lambd -0.25 and bias -0.25, not one number from 0 on, has no compiled form",
        13,
    ),
    (
        [node("MaxPool", kernel_shape=[1, 1], strides=[4, 4], pads=[0] * 4, ceil_mode=1)],
        {},
        "(MaxPool): ceil_mode with a window that begins behind the input has no compiled form",
        13,
    ),
    (
        [node("MaxPool", "x", "y i", kernel_shape=[3, 3])],
        {},
        "(MaxPool): indices has no compiled form",
        13,
    ),
    (
        [node("Dropout", "x half yes")],
        {"half": HALF, "yes": YES},
        "(Dropout): a dropout in training mode has",
        13,
    ),
    (
        [node("Conv", "x w", auto_pad="VALID", pads=[1] * 4)],
        {"w": KERNEL},
        "(Conv): auto_pad VALID beside pads",
        13,
    ),
    (
        [node("Conv", "x w")],
        {"w": KERNEL > 0},
        "(Conv): 'w' of type bool beside an input of float32 has no",
        13,
    ),
    (
        [node("Reshape", "x to")],
        {"to": np.int64([2, -1])},
        "(Reshape): a reshape to [2, -1], not (n, -1), one",
        13,
    ),
    (
        [node("Reshape", "x to")],
        {"to": np.int64([2, 60])},
        "(Reshape): a reshape to [2, 60], not (n, -1), one",
        13,
    ),
    (
        [node("Reshape", "x to", allowzero=1)],
        {"to": np.int64([0, -1])},
        "(Reshape): a reshape to [0, -1], not (n, -1), one",
        14,
    ),
    (
        [node("Add", "x two", "s"), node("Log", "s")],
        {"two": np.float32(2)},
        "(Log): a logarithm of other than x + 1 has no compiled form",
        13,
    ),
    (
        [node("Add", "many row", "y"), node("Add", "x y", "z")],
        {"many": np.zeros((4000, 1), np.int64), "row": np.zeros(4000, np.int64)},
        "(Add): a Add of large constants has no compiled form",
        13,
    ),
    (
        [node("Gather", "row many", "y"), node("Add", "x y", "z")],
        {"row": np.zeros((2, 4000), np.float32), "many": np.zeros(4000, np.int64)},
        "(Gather): a Gather of large constants has no compiled form",
        13,
    ),
    (
        [
            node("Transpose", "x", "t", perm=[0, 2, 3, 1]),
            node("Shape", "t", "s"),
            node("Reshape", "x s"),
        ],
        {},
        "(Reshape): a reshape to [1, 6, 5, 2], not (n, -1), one",
        13,
    ),
    ([node("Flatten")], {}, "the network must be of opset 7 or later, got [6]", 6),
    (
        [node("ConstantOfShape", "size", "y"), node("Add", "x y", "z")],
        {"size": np.int64([5000])},
        "(ConstantOfShape): a ConstantOfShape of large constants has no compiled form",
        13,
    ),
    (
        [node("Concat", "row row", "y", axis=0), node("Add", "x y", "z")],
        {"row": np.zeros(3000, np.float32)},
        "(Concat): a Concat of large constants has no compiled form",
        13,
    ),
    (
        [node("Constant", "", "y", value_float=1.0), node("Add", "x y", "z")],
        {},
        "(Constant): a constant without `value` has no compiled form",
        13,
    ),
    (
        [node("Sum", "x x half")],
        {"half": HALF},
        "(Sum): a sum other than of one map and a constant, or of maps, has no compiled form",
        13,
    ),
    (
        [node("Conv", "x w", auto_pad="SAME_UPPER", strides=[2, 2])],
        {"w": KERNEL},
        "(Conv): auto_pad SAME_UPPER with a stride of [2, 2] has no compiled form",
        13,
    ),
    *(
        (
            [node("ConvTranspose", "x w", **attributes)],
            {"w": np.ones((2, 1, 2, 2), np.float32)},
            f"(ConvTranspose): {message} has no compiled form",
            13,
        )
        for attributes, message in (
            ({"auto_pad": "SAME_UPPER"}, "auto_pad SAME_UPPER"),
            ({"output_shape": [7, 6]}, "output_shape"),
        )
    ),
    (
        [node("MaxPool", kernel_shape=[2, 2], dilations=[2, 1])],
        {},
        "(MaxPool): dilation has no compiled form",
        13,
    ),
    *(
        (
            [node("Resize", "x - scales", mode=mode)],
            {"scales": np.float32([1, 1, *factors])},
            f"(Resize): {message} has no compiled form",
            13,
        )
        for mode, factors, message in (
            ("cubic", (2, 2), "mode cubic"),
            ("nearest", (2, 3), "a Resize by [2.0, 3.0], not by one whole number,"),
            ("nearest", (1.5, 1.5), "a Resize by [1.5, 1.5], not by one whole number,"),
        )
    ),
    (
        [node("Pad", "x pads one")],
        {"pads": np.int64([0, 0, 1, 1, 0, 0, 1, 1]), "one": np.float32(1)},
        "(Pad): a padding of the value 1.0 has no compiled form",
        13,
    ),
    (
        [node("Pad", pads=[0, 0, 1, 1, 0, 0, 1, 1], value=1.0)],
        {},
        "(Pad): a padding of the value 1.0 has no compiled form",
        10,
    ),
    (
        [node("Pad", "x pads - axes")],
        {"pads": np.int64([1, 1]), "axes": np.int64([2])},
        "(Pad): a padding of some axes has no compiled form",
        18,
    ),
    (
        [node("Reshape", "x rows", "r"), node("Reshape", "r whole")],
        {"rows": np.int64([1, 2, -1]), "whole": np.int64([1, 2, 6, 5])},
        "(Reshape): a reshape of groups to [1, 2, 6, 5] has no compiled form",
        13,
    ),
    (
        [node("Reshape", "x rows", "r"), node("InstanceNormalization", "r twice twice")],
        {"rows": np.int64([1, 2, -1]), "twice": 2 * ONES},
        "(InstanceNormalization): an InstanceNormalization of groups with weights of its own has",
        13,
    ),
    (
        [node("LayerNormalization", "x w")],
        {"w": np.ones(5, np.float32)},
        "(LayerNormalization): a LayerNormalization over other than channels as last axis has",
        17,
    ),
    (
        [node("Flatten", "x", "f"), node("Softmax", "f", axis=0)],
        {},
        "(Softmax): a softmax over axis 0, not over the classes (1), has no compiled form",
        13,
    ),
]


@pytest.mark.parametrize(
    "nodes, constants, message, opset", REFUSED, ids=[row[2][:40] for row in REFUSED]
)
def test_a_node_without_a_compiled_form_is_refused_by_name(
    tmp_path, nodes, constants, message, opset
):
    path = write_onnx(tmp_path / "m.onnx", nodes, constants, nodes[-1].output[0], opset)
    begin = f"{path}: node 'y' " if message.startswith("(") else f"{path}: "
    with pytest.raises(NotImplementedError, match=f"^{re.escape(begin + message)}"):
        load_model(path, config=SMALL, classes=["a", "b", "c"])


def test_an_operation_that_a_file_redefines_is_not_onnxs(tmp_path):
    path = write_onnx(tmp_path / "m.onnx", [node("Flatten")])
    proto = onnx.load(path)
    opsets = [onnx.helper.make_opsetid("", 13)]
    body = [node("Neg", "x", "y")]
    proto.functions.append(onnx.helper.make_function("", "Flatten", ["x"], ["y"], body, opsets))
    proto.ir_version = 8
    onnx.save(proto, path)
    message = "the network redefines operations of ONNX"
    with pytest.raises(NotImplementedError, match=f"^{re.escape(f'{path}: {message}')}"):
        load_model(path, config=SMALL)


def test_a_constant_that_two_nodes_read_is_kept_once(tmp_path):
    nodes = [
        LINEAR[0],
        node("MatMul", "f q", "g"),
        node("MatMul", "g q", "h"),
        node("MatMul", "h w"),
    ]
    weights = {"w": np.eye(60, 3, dtype=np.float32), "q": np.tri(60, dtype=np.float32) / 60}
    model = load_model(write_onnx(tmp_path / "m.onnx", nodes, weights), config=SMALL)
    assert model.weights.keys() == {"q", "w"}


def test_a_file_is_compared_with_onnxruntime(tmp_path, monkeypatch):
    """Here with a rule that is wrong: ReLU read as nothing."""
    nodes = [
        node("Flatten", "x", "f"),
        node("MatMul", "f w", "d"),
        node("Relu", "d", "r"),
        node("Flatten", "r"),
    ]
    path = write_onnx(
        tmp_path / "m.onnx", nodes, {"w": np.float32(VOLUMES[0, 0, :9, :20].reshape(60, 3))}
    )
    load_model(path, config=SMALL)
    monkeypatch.setitem(RULES, "Relu", RULES["Identity"])
    with pytest.raises(
        NotImplementedError,
        match=r"cannot be read as layers: its layers compute other numbers \(by",
    ):
        load_model(path, config=SMALL)


def test_weights_in_a_file_beside_are_read_there(tmp_path, monkeypatch):
    """Weights of the same name in the current folder are not read."""
    found = []
    for name, factor in (("a", 1.0), ("b", -1.0)):
        (tmp_path / name).mkdir()
        weights = {"w": np.full((60, 3), factor, np.float32)}
        path = write_onnx(
            tmp_path / name / "net.onnx",
            [node("Flatten", "x", "f"), node("MatMul", "f w")],
            weights,
        )
        onnx.save_model(
            onnx.load(path),
            path,
            save_as_external_data=True,
            location="net.onnx.data",
            size_threshold=0,
        )
        found.append(path)
    monkeypatch.chdir(tmp_path / "b")
    volume = np.ones(SMALL.shape, np.float32)
    logits = [CompiledClassifier(load_for_numbers(path, SMALL))(volume).tolist() for path in found]
    assert logits == [[60.0] * 3, [-60.0] * 3]


def test_what_load_model_refuses_of_onnx(tmp_path, monkeypatch):
    path = write_onnx(tmp_path / "m.onnx", [node("Flatten")])
    ours = tmp_path / "ours.onnx"
    ours.write_bytes(to_onnx(load_model("digits")).SerializeToString())
    (tmp_path / "no.onnx").write_bytes(b"nothing")
    refused = [
        (path, {}, TypeError, r"does not say how events become its volume: load_model\(path, "),
        (ours, {"config": SMALL}, TypeError, "^`config` and `classes` are for networks of other "),
        (
            "digits",
            {"config": SMALL},
            TypeError,
            r"^`config` and `classes` are for \.onnx networks",
        ),
        (
            path,
            {"config": TNTConfig()},
            ValueError,
            r"must be the volume, N x \(9, 34, 34\), got N",
        ),
        (ours, {"classes": ["a"]}, TypeError, "^`config` and `classes` are for networks of other "),
        (
            "digits",
            {"classes": ["a"]},
            TypeError,
            r"^`config` and `classes` are for \.onnx networks",
        ),
        (tmp_path / "no.onnx", {"config": SMALL}, ValueError, "is not a readable ONNX network"),
    ]
    for name, settings, error, message in refused:
        with pytest.raises(error, match=message):
            load_model(name, **settings)
    theirs = write_onnx(
        tmp_path / "t.onnx",
        [node("Flatten", "x", "f"), node("MatMul", "f w")],
        {"w": np.ones((60, 3), np.float32)},
    )
    for missing in ("onnxruntime", "onnx"):
        monkeypatch.setitem(sys.modules, missing, None)
        with pytest.raises(
            ImportError, match=r"^ONNX networks are .*: pip install 'async_tnt\[onnx\]' \("
        ):
            load_model(theirs, config=SMALL)


LINEAR = [node("Flatten", "x", "f"), node("MatMul", "f w")]
SUM = [
    node("Relu", "x", "r"),
    node("Add", "r one", "s"),
    node("Log", "s", "l"),
    node("Add", "l s", "a"),
]
TWICE = [
    LINEAR[0],
    node("MatMul", "f q", "g"),
    node("Gemm", "g q", "h", transB=1),
    node("MatMul", "h w"),
]
ROWS = {
    "given,rest": np.int64([0, -1]),
    "one,rest": np.int64([1, -1]),
    "given,all": np.int64([0, 60]),
    "one,all": np.int64([1, 60]),
    "rest,all": np.int64([-1, 60]),
}
"""Shapes of one row for each volume, by their names."""
ACCEPTED = {
    "a sum below a logarithm that is read by another node, too": (
        [*SUM, node("Flatten", "a", "f"), LINEAR[1]],
        1,
    ),
    "one constant as two matrices": (TWICE, 1),
    "a batch of two": (LINEAR, 2),
    **{
        f"a reshape to {name}": ([node("Reshape", f"x {name}", "f"), LINEAR[1]], 1) for name in ROWS
    },
    "a leaky ReLU without its slope": (
        [node("LeakyRelu", "x", "r"), node("Flatten", "r", "f"), LINEAR[1]],
        1,
    ),
    "a batch norm without its epsilon": (
        # of numbers whose variance is as small as the epsilon that is meant
        [node("BatchNormalization", "x o o z v", "n"), node("Flatten", "n", "f"), LINEAR[1]],
        1,
    ),
    "a mean that does not say whether it keeps its axes": (
        [
            node("ReduceMean", "x", "m", axes=[2, 3]),
            node("Conv", "m places", "c"),
            node("Flatten", "c"),
        ],
        1,
    ),
}


def upsampled():
    """An upsampling by two as it was written before opset 9."""
    return node("Upsample", "x", "m", scales=[1.0, 1.0, 2.0, 2.0])


DEFAULTS = {  # the nodes from x to m, and their opset
    "a Slice of the first axes": ([node("Slice", "x starts ends", "m")], 10),
    "a Slice of the first axes, of attributes": (
        [node("Slice", "x", "m", starts=[0, 1], ends=[1, 2])],
        9,
    ),
    "a Split into equal parts": (
        [node("Split", "x", "a b", axis=1), node("Sub", "a b", "m")],
        11,
    ),
    "a Split whose last part is smaller": (
        [
            node("Gather", "x three", "p", axis=1),
            node("Split", "p", "m b", axis=1, num_outputs=2),
        ],
        18,
    ),
    "a sum that keeps its axis": ([node("ReduceSum", "x channels", "m")], 13),
    "an Upsample with an attribute": ([upsampled()], 7),
    "a part of a shape": (
        [
            node("Shape", "x", "n", start=-2, end=-1),
            node("Shape", "x", "first", end=2),
            node("Shape", "x", "last", start=3),
            node("Concat", "first n last", "s", axis=0),
            node("Reshape", "x s", "m"),
        ],
        15,
    ),
    "a MaxPool that is rounded up": (
        [node("MaxPool", "x", "m", kernel_shape=[3, 3], strides=[2, 2], ceil_mode=1)],
        13,
    ),
    "an AveragePool that is rounded up": (
        [
            node(
                "AveragePool",
                "x",
                "m",
                kernel_shape=[3, 3],
                strides=[2, 2],
                pads=[1] * 4,
                ceil_mode=1,
            )
        ],
        13,
    ),
    "a ConvTranspose without padding": (
        [node("ConvTranspose", "x t", "m", auto_pad="VALID", strides=[2, 2])],
        13,
    ),
    "a constant that a Dropout passes on": (
        [node("Dropout", "one", "o"), node("Add", "x o", "m")],
        13,
    ),
}
"""What nodes leave out, and forms that are seldom written."""


@pytest.mark.parametrize("nodes, opset", DEFAULTS.values(), ids=DEFAULTS)
def test_forms_that_are_seldom_written_are_read(tmp_path, nodes, opset):
    """`load_model` also compares the network with onnxruntime."""
    constants = {
        "starts": np.int64([0, 1]),
        "ends": np.int64([1, 2]),
        "three": np.int64([0, 1, 1]),
        "channels": np.int64([1]),
        "t": np.arange(24, dtype=np.float32).reshape(2, 3, 2, 2),
        "one": np.float32(1),
    }
    nodes = [*nodes, node("GlobalAveragePool", "m", "g"), node("Flatten", "g")]
    path = write_onnx(tmp_path / "m.onnx", nodes, constants, opset=opset)
    assert len(load_for_numbers(path, SMALL).classes) in (1, 2, 3)


def test_a_file_that_takes_other_than_one_volume_of_floats_is_refused(tmp_path):
    two = network(
        [node("Add", "x z", "a"), node("Flatten", "a")],
        inputs=[("x", (1, 2, 6, 5)), ("z", (1, 2, 6, 5))],
        outputs=[("y", ("a", "b"))],
    )
    whole = network(
        [node("Flatten")],
        inputs=[("x", (1, 2, 6, 5))],
        outputs=[("y", ("a", "b"))],
        dtype=onnx.TensorProto.INT64,
    )
    path = tmp_path / "m.onnx"
    for content, message in (
        (two, "the network must have one input, got 2"),
        (whole, "the network's input must be floating point, got type 7 of ONNX"),
    ):
        path.write_bytes(content)
        with pytest.raises(NotImplementedError, match=f"^{re.escape(f'{path}: {message}')}"):
            load_model(path, config=SMALL)


def test_limits_of_0_that_are_attributes_are_read(tmp_path):
    """As they were before opset 11."""
    nodes = [
        node("Clip", "x", "h", max=0.0),
        node("Clip", "x", "l", min=0.0),
        node("Concat", "h l", "c", axis=1),
        node("GlobalAveragePool", "c", "m"),
        node("Flatten", "m", "f"),
        node("MatMul", "f w"),
    ]
    weights = {"w": np.arange(12, dtype=np.float32).reshape(4, 3)}
    path = write_onnx(tmp_path / "m.onnx", nodes, weights, opset=10)
    # `load_model` also compares the network with onnxruntime.
    assert len(load_for_numbers(path, SMALL).classes) == 3


@pytest.mark.parametrize("nodes, batch", ACCEPTED.values(), ids=ACCEPTED)
def test_what_onnxruntime_computes_the_same_is_read(tmp_path, nodes, batch):
    weights = {
        "one": np.float32(1),
        "w": np.eye(60, 3, dtype=np.float32),
        "q": np.tri(60, dtype=np.float32) / 60,
        "o": ONES,
        "z": 0 * ONES,
        "v": np.float32(1e-5) * ONES,
        "places": np.float32([[1, 2], [3, 4], [5, 6]]).reshape(3, 2, 1, 1),
        **ROWS,
    }
    path = write_onnx(tmp_path / "m.onnx", nodes, weights, shape=(batch, 2, 6, 5))
    # `load_model` also compares the network with onnxruntime.
    assert len(load_for_numbers(path, SMALL).classes) == 3
    # A network of half precision is compared as exactly as its numbers are.
    path.write_bytes(network(dtype=onnx.TensorProto.FLOAT16))
    assert len(load_for_numbers(path, SMALL).classes) == 3


def test_files_of_the_first_opset_may_list_weights_as_inputs(tmp_path):
    """As programs wrote them then."""
    weights = {"w": np.eye(60, 3, dtype=np.float32)}
    path = write_onnx(tmp_path / "m.onnx", LINEAR, weights, opset=7)
    proto = onnx.load(path)
    listed = onnx.helper.make_tensor_value_info("w", onnx.TensorProto.FLOAT, (60, 3))
    proto.graph.input.append(listed)
    proto.ir_version = 3
    onnx.save(proto, path)
    volume = np.arange(60, dtype=np.float32).reshape(SMALL.shape)
    logits = CompiledClassifier(load_for_numbers(path, SMALL))(volume)
    np.testing.assert_allclose(logits, [0, 1, 2])


def test_layers_named_as_weights_and_as_the_output_can_be_exported():
    layers = [
        {"op": "flatten", "name": "w", "inputs": ["volume"]},
        {"op": "dense", "name": "logits", "inputs": ["w"], "weights": {"weight": "w"}},
        {"op": "silu", "name": "s", "inputs": ["logits"]},
        # The export gives this name to a part of `s`.
        {"op": "relu", "name": "s.sigmoid", "inputs": ["s"]},
        {"op": "relu", "name": "last", "inputs": ["s.sigmoid"]},
    ]
    model = Model(SMALL, {"w": np.eye(3, 60)}, ["a", "b", "c"], network={"classifier": layers})
    logits = OnnxClassifier(to_onnx(model))(np.arange(60, dtype=np.float32).reshape(SMALL.shape))
    assert logits == pytest.approx([0.0, 1 / (1 + np.exp(-1.0)), 2 / (1 + np.exp(-2.0))])


def test_a_weight_named_as_the_export_names_a_constant_is_kept(tmp_path):
    layers = [
        node("Conv", "x k", "c"),
        node("PRelu", "c act.slope", "act"),
        node("GlobalAveragePool", "act", "g"),
    ]
    weights = {
        "k": np.ones((3, 2, 3, 3), np.float32),
        "act.slope": np.full((3, 1, 1), 0.5, np.float32),
    }
    path = write_onnx(tmp_path / "a.onnx", [*layers, node("Flatten", "g")], weights)
    model = load_for_numbers(path, SMALL)
    (tmp_path / "b.onnx").write_bytes(to_onnx(model).SerializeToString())
    volume = np.random.default_rng(0).normal(size=SMALL.shape).astype(np.float32)
    again = CompiledClassifier(load_model(tmp_path / "b.onnx"))
    np.testing.assert_array_equal(again(volume), CompiledClassifier(model)(volume))


# -- networks of other programs, with their configuration in a file --------------------------------

SINES = [node("Sin", "x", "s"), node("Flatten", "s")]
"""A network that has no compiled form."""

SINES_OF_CHANNELS = [
    node("Sin", "x", "s"),
    node("GlobalAveragePool", "s", "g"),
    node("Flatten", "g"),
]
"""Likewise, of two logits."""

SINES_CONFIG = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=2)


@pytest.fixture
def config_file(tmp_path):
    """The configuration of the networks below, in a file."""
    path = tmp_path / "net.json"
    path.write_text(json.dumps({"config": SINES_CONFIG.to_dict()}))
    return path


@EVEN_KERNEL
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_what_torch_exports_runs_compiled(tmp_path):
    """The network is compared with onnxruntime when its file is read."""
    path = tmp_path / "net.onnx"
    config = tmp_path / "net.json"
    torch.onnx.export(branches().eval(), torch.tensor(VOLUMES[:1]), str(path), dynamo=False)
    config.write_text(json.dumps({"config": CONFIG.to_dict(), "classes": ["a", "b", "c", "d"]}))
    engine = choose_engine(path, config=config)
    assert engine.classifier is None
    assert engine.model.config == CONFIG
    assert engine.classes == ("a", "b", "c", "d")


def test_what_has_no_compiled_form_runs_by_onnxruntime(tmp_path, config_file):
    engine = choose_engine(write_onnx(tmp_path / "sin.onnx", SINES), config=config_file)
    assert type(engine.classifier) is OnnxClassifier
    assert (engine.model, len(engine.classes)) == (SINES_CONFIG, 60)

    open_sides = write_onnx(tmp_path / "open.onnx", SINES_OF_CHANNELS, shape=("n", 2, "h", "w"))
    assert len(choose_engine(open_sides, config=config_file).classes) == 2

    # no layer takes two flattened maps
    two_maps = [node("Flatten", "x", "f"), node("Relu", "x", "r"), node("Flatten", "r", "h")]
    joined = [*two_maps, node("Concat", "f h", "c", axis=1), node("MatMul", "c w")]
    path = write_onnx(tmp_path / "two.onnx", joined, {"w": np.ones((120, 3), np.float32)})
    assert len(choose_engine(path, config=config_file).classes) == 3


def test_a_last_softmax_is_read_as_its_logarithm(tmp_path, config_file):
    logits_path = write_onnx(tmp_path / "sin.onnx", SINES)
    odds = [node("Sin", "x", "s"), node("Flatten", "s", "l"), node("Softmax", "l")]
    odds_path = write_onnx(tmp_path / "odds.onnx", odds)
    volume = np.ones(SINES_CONFIG.shape, np.float32)
    logits = choose_engine(logits_path, config=config_file).classifier(volume)
    found = choose_engine(odds_path, config=config_file).classifier(volume)
    np.testing.assert_allclose(found, logits - np.log(np.exp(logits).sum()), atol=1e-5)


def test_a_softmax_before_the_end_stays_one(tmp_path, config_file):
    """Two equal channels have a probability of one half each."""
    nodes = [node("Softmax", "x", "s", axis=1), node("Flatten", "s")]
    engine = choose_engine(write_onnx(tmp_path / "a.onnx", nodes), config=config_file)
    halves = engine.classifier(np.ones(SINES_CONFIG.shape, np.float32))
    np.testing.assert_allclose(halves, np.full(60, 0.5))


def test_onnxruntime_takes_the_class_names_of_a_configuration(tmp_path, config_file):
    path = write_onnx(tmp_path / "sin.onnx", SINES_OF_CHANNELS)

    def engine_of(*classes):
        config_file.write_text(json.dumps({"config": SINES_CONFIG.to_dict(), "classes": classes}))
        return choose_engine(path, config=config_file)

    assert type(engine_of("left", "right").classifier) is OnnxClassifier
    assert list(engine_of("left", "right").classes) == ["left", "right"]
    assert list(engine_of(4, 7).classes) == ["4", "7"]
    for classes in (["a"], ["a", "b", "c"]):
        message = f"{config_file}: {len(classes)} classes, but {path} computes 2"
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            engine_of(*classes)
    for classes in ([], ["a", "a"], [1, "1"]):
        with pytest.raises(
            ValueError, match=r"net\.json: .*`classes` must be different names, got"
        ):
            engine_of(*classes)


def test_a_sensor_that_is_read_is_for_map_models_alone(tmp_path):
    """A model of one answer keeps the sensor it was made for, also where another would fit."""
    for n_places in (1, 2):
        net = torch.nn.Sequential(torch.nn.AdaptiveAvgPool2d(n_places), torch.nn.Conv2d(2, 3, 1))
        config = SMALL.replace(transform="none", landmark="center")
        model = Model.from_torch(net, config, list("abc")[: 3 if n_places == 1 else 2])
        path = model.save(tmp_path / "m.safetensors")
        read = choose_engine(path, map_sensor=(40, 30)).model
        assert read.config.sensor == (config.sensor if n_places == 1 else (40, 30))


def test_the_end_of_a_files_name_may_be_in_capitals(tmp_path):
    model = load_model("digits")
    path = tmp_path / "DIGITS.ONNX"
    path.write_bytes(to_onnx(model).SerializeToString())
    assert load_model(path).classes == model.classes
    assert type(choose_engine(path).classifier) is OnnxClassifier


def test_a_file_of_this_package_takes_no_configuration(tmp_path, config_file):
    ours = tmp_path / "ours.onnx"
    ours.write_bytes(to_onnx(load_model("digits")).SerializeToString())
    message = r"^`config` is for networks of other programs; .*ours.onnx has its own$"
    with pytest.raises(ValueError, match=message):
        choose_engine(ours, config=config_file)


def test_the_program_runs_a_network_with_its_configuration(tmp_path, config_file, program):
    path = write_onnx(tmp_path / "sin.onnx", SINES)
    recording = tmp_path / "a.npy"
    np.save(recording, random_events(300, sensor=(5, 6)))
    code, out, _ = program("run", recording, "--model", path, "--config", config_file)
    assert code == 0 and "a.npy: " in out

    code, _, err = program("run", "--config", config_file)
    assert code == 2 and "--config is for .onnx files of other programs; digits has its own" in err
    code, _, err = program("run", recording, "--model", path)
    assert code == 2 and ": a file of what `async-tnt info` prints of a model as JSON" in err


@pytest.mark.parametrize(
    "content, message",
    [
        ("{", 'net.json: expected a JSON object with "config", and maybe "classes": '),
        ("{}", 'expected a JSON object with "config", and maybe "classes": no \'config\''),
        ('{"config": {"bin": 5}}', "unknown configuration bin; known: "),
        ('{"config": {"bins": "5"}}', "net.json: expected a JSON object"),
    ],
)
def test_a_damaged_configuration_is_one_line(tmp_path, config_file, program, content, message):
    path = write_onnx(tmp_path / "sin.onnx", SINES)
    recording = tmp_path / "a.npy"
    np.save(recording, random_events(300, sensor=(5, 6)))
    config_file.write_text(content)
    code, _, err = program("run", recording, "--model", path, "--config", config_file)
    assert code == 2 and err.count("\n") == 1 and message in err


def test_weights_that_a_file_standardizes_are_computed(tmp_path):
    """The weights w of a dense layer become (w - mean) / 2, in nodes that read constants alone."""
    nodes = [
        node("Flatten", "x", "f"),
        node("ReduceMean", "w", "m", axes=[0, 1]),
        node("Sub", "w m", "c"),
        node("Shape", "w", "s"),
        node("Gather", "s one", "n"),
        node("Cast", "n", "three", to=onnx.TensorProto.FLOAT),
        node("Sub", "three one_float", "two"),
        node("Div", "c two", "half"),
        node("MatMul", "f half"),
    ]
    w = np.arange(180, dtype=np.float32).reshape(60, 3)
    constants = {"w": w, "one": np.int64(1), "one_float": np.float32(1)}
    model = load_model(write_onnx(tmp_path / "m.onnx", nodes, constants), config=SMALL)
    (weight,) = model.weights.values()
    np.testing.assert_allclose(weight, ((w - w.mean()) / 2).T, rtol=1e-6)


def test_large_weights_are_not_computed_for_ever(tmp_path, monkeypatch):
    from async_tnt.networks.onnx import constant_folding

    monkeypatch.setattr(constant_folding, "MOST_NUMBERS_OF_ALL", 500)
    nodes = [node("Flatten", "x", "f"), node("Neg", "w", "a"), node("Neg", "a", "b")]
    nodes += [node("Neg", "b", "c"), node("MatMul", "f c")]
    path = write_onnx(tmp_path / "m.onnx", nodes, {"w": np.ones((60, 3), np.float32)})
    with pytest.raises(NotImplementedError, match="a Neg of large constants has no compiled form"):
        load_model(path, config=SMALL)


def test_a_sum_of_stacked_maps_is_their_sum(tmp_path):
    nodes = [
        node("Relu", "x", "r"),
        node("Unsqueeze", "x", "a", axes=[0]),
        node("Unsqueeze", "r", "b", axes=[0]),
        node("Concat", "a b", "s", axis=0),
        node("ReduceSum", "s", axes=[0], keepdims=0),
    ]
    model = load_model(write_onnx(tmp_path / "m.onnx", nodes, {}, "y", 11), config=SMALL)
    assert [layer["op"] for layer in model.network["classifier"]] == ["relu", "add"]
