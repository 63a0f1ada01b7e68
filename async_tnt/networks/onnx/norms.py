"""The rules of ONNX's norms over channels, and of values with their channels last."""

from __future__ import annotations

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.onnx.layers import Node, OnnxLayers
from async_tnt.networks.onnx.nodes import OnnxNodes

TO_LAST = [0, 2, 3, 1]
"""The permutation that puts the channels of (N, C, H, W) last."""

TO_FIRST = [0, 3, 1, 2]
"""The permutation that puts them back."""

KEEP_AXES = {
    "Abs",
    "Add",
    "Clip",
    "Div",
    "Dropout",
    "Erf",
    "Gelu",
    "HardSigmoid",
    "HardSwish",
    "Identity",
    "LayerNormalization",
    "LeakyRelu",
    "MatMul",
    "Mul",
    "Neg",
    "Relu",
    "Sigmoid",
    "Sub",
    "Tanh",
}
"""Operators that take values with their channels last, and give such values."""


def note_axes(onnx_layers: OnnxLayers, node: Node) -> None:
    """Note that a node keeps its channels last, or refuse it if it cannot.

    Raises
    ------
    NotImplementedError : see above.
    """
    computed = {name for name in node.inputs if name in onnx_layers.names}
    if node.op == "Transpose" or not onnx_layers.channels_last.intersection(computed):
        return
    can_be_last = node.op in KEEP_AXES and onnx_layers.channels_last.issuperset(computed)
    expect_form(can_be_last, "a value with its channels last")
    onnx_layers.channels_last.update(node.outputs)


def transpose_channels(onnx_layers: OnnxLayers, node: Node) -> None:
    """Note that the channels are last, or again the second axis: no layer is added."""
    (source,) = node.inputs
    is_last = source in onnx_layers.channels_last
    axes = list(node.get("perm", []))
    expect_form(axes == (TO_FIRST if is_last else TO_LAST), f"a transposition by {axes}")
    onnx_layers.alias(node, source)
    if not is_last:
        onnx_layers.channels_last.add(node.outputs[0])


def layer_norm(onnx_layers: OnnxLayers, node: Node) -> None:
    sides = onnx_layers.shape(node.inputs[0])[1:]
    are_last = not sides or node.inputs[0] in onnx_layers.channels_last
    n_axes = 2 + len(sides)
    is_over_channels = are_last and node.get("axis", -1) % n_axes == n_axes - 1
    expect_form(is_over_channels, "a LayerNormalization over other than channels as last axis")
    weights = onnx_layers.weights(node, weight=1, bias=2)
    epsilon = float(node.get("epsilon", 1e-5))
    onnx_layers.add(node, "layer_norm", node.inputs[:1], weights=weights, epsilon=epsilon)


def instance_norm(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a group norm with one channel in each group, or note that groups are normalized.

    Torch exports a group norm as a reshape to (n, groups, -1), an instance norm, a reshape back, a
    product and a sum. The second reshape then adds the layer, see `arranging.reshape`.
    """
    epsilon = float(node.get("epsilon", 1e-5))
    flat = onnx_layers.flat_groups.get(node.inputs[0])
    if flat is None:
        weights = onnx_layers.weights(node, weight=1, bias=2)
        channels = onnx_layers.shape(node.inputs[0])[0]
        given = {"weights": weights, "groups": channels, "epsilon": epsilon}
        onnx_layers.add(node, "group_norm", node.inputs[:1], **given)
        return
    weight = onnx_layers.constant(node, 1)
    bias = onnx_layers.constant(node, 2)
    is_plain = weight is not None and bias is not None and (weight == 1).all() and not bias.any()
    expect_form(bool(is_plain), "an InstanceNormalization of groups with weights of its own")
    onnx_layers.flat_groups[node.outputs[0]] = flat._replace(epsilon=epsilon)


# -- written ---------------------------------------------------------------------------------------


def write_layer_norm(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """The formula, node by node: the operator of this name needs a later version of ONNX."""
    mean = nodes.add("ReduceMean", inputs, f"{name}.mean", axes=[1])
    centred = nodes.add("Sub", [*inputs, mean], f"{name}.centred")
    squares = nodes.add("Mul", [centred, centred], f"{name}.squares")
    variance = nodes.add("ReduceMean", [squares], f"{name}.variance", axes=[1])
    sum_ = nodes.add_number(variance, layer["epsilon"], f"{name}.sum")
    root = nodes.add("Sqrt", [sum_], f"{name}.root")
    normal = nodes.add("Div", [centred, root], f"{name}.normal")
    _write_affine(nodes, layer, normal, name)


def write_group_norm(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """An instance norm of the groups as rows."""
    groups = layer["groups"]
    to_groups = nodes.constant(f"{name}.groups", [1, groups, -1], np.int64)
    flat = nodes.add("Reshape", [*inputs, to_groups], f"{name}.flat")
    ones = nodes.constant(f"{name}.ones", np.ones(groups))
    zeros = nodes.constant(f"{name}.zeros", np.zeros(groups))
    epsilon = {"epsilon": float(layer["epsilon"])}
    rows = nodes.add("InstanceNormalization", [flat, ones, zeros], f"{name}.rows", **epsilon)
    shape = nodes.constant(f"{name}.shape", (1, *nodes.output_shape(layer)), np.int64)
    normal = nodes.add("Reshape", [rows, shape], f"{name}.normal")
    _write_affine(nodes, layer, normal, name)


def _write_affine(nodes: OnnxNodes, layer: Layer, value: str, name: str) -> None:
    """Write the product with the weight and the sum with the bias, if the layer has them."""
    channels, *sides = nodes.output_shape(layer)
    of_channel = (channels, *[1] * len(sides))
    for role, operator in (("weight", "Mul"), ("bias", "Add")):
        if role in layer["weights"]:
            values = nodes.weights[layer["weights"][role]].reshape(of_channel)
            constant = nodes.constant(f"{name}.{role}", values)
            value = nodes.add(operator, [value, constant], f"{name}.{operator}")
    nodes.add("Identity", [value], name)
