"""How layers become nodes of an ONNX graph.

Each rule receives the nodes so far, a layer, the names of the layer's inputs in the graph, and the
name that the layer's value must have in the graph.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.layers.uneven_windows import adaptive_matrix
from async_tnt.networks.onnx.nodes import OnnxNodes

WriteRule = Callable[[OnnxNodes, Layer, list[str], str], None]


def plain_node(op: str, **attributes: Any) -> WriteRule:
    """The rule of a layer that is one node without weights."""

    def write(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
        nodes.add(op, inputs, name, **attributes)

    return write


def window_node(op: str, **attributes: Any) -> WriteRule:
    """The rule of a layer that is one node with a window."""

    def write(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
        nodes.add(op, inputs, name, **attributes, **_window(layer))

    return write


def _window(layer: Layer) -> dict[str, list[int]]:
    return {"kernel_shape": layer["kernel"], "strides": layer["stride"], "pads": layer["padding"]}


def _given(layer: Layer, *roles: str) -> list[str]:
    """The names of the layer's weights in these roles, without the missing ones."""
    return [layer["weights"][role] for role in roles if role in layer["weights"]]


# -- with weights ----------------------------------------------------------------------------------


def write_conv(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    nodes.add(
        "Conv",
        [*inputs, *_given(layer, "weight", "bias")],
        name,
        **_window(layer),
        dilations=layer["dilation"],
        group=layer["groups"],
    )


def write_dense(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    nodes.add("Gemm", [*inputs, *_given(layer, "weight", "bias")], name, transB=1)


def write_batch_norm(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    n = nodes.output_shape(layer)[0]
    names = layer["weights"]
    weight = names.get("weight") or nodes.constant(f"{name}.ones", np.ones(n))
    bias = names.get("bias") or nodes.constant(f"{name}.zeros", np.zeros(n))
    constants = [weight, bias, names["mean"], names["variance"]]
    nodes.add("BatchNormalization", [*inputs, *constants], name, epsilon=float(layer["epsilon"]))


# -- activations -----------------------------------------------------------------------------------


def write_leaky_relu(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    nodes.add("LeakyRelu", inputs, name, alpha=float(layer["slope"]))


def write_prelu(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    slope = nodes.weights[layer["weights"]["slope"]]
    other_sides = [1] * (len(nodes.output_shape(layer)) - 1)
    constant = nodes.constant(f"{name}.slope", slope.reshape(-1, *other_sides))
    nodes.add("PRelu", [*inputs, constant], name)


def write_clip(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    limits = []
    for side in ("low", "high"):
        has_limit = layer[side] is not None
        limits.append(nodes.constant(f"{name}.{side}", layer[side]) if has_limit else "")
    nodes.add("Clip", [*inputs, *limits], name)


def write_softshrink(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    limit = float(layer["lambd"])
    nodes.add("Shrink", inputs, name, lambd=limit, bias=limit)


def write_log1p(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """log(x + 1)"""
    nodes.add("Log", [nodes.add_number(inputs[0], 1.0, f"{name}.sum")], name)


def write_silu(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x sigmoid(x)"""
    sigmoid = nodes.add("Sigmoid", inputs, f"{name}.sigmoid")
    nodes.add("Mul", [*inputs, sigmoid], name)


def write_gelu(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x (1 + erf(x / sqrt 2)) / 2"""
    scaled = nodes.scale(inputs[0], 0.5**0.5, f"{name}.scaled")
    erf = nodes.add("Erf", [scaled], f"{name}.erf")
    factor = nodes.add_number(erf, 1.0, f"{name}.sum")
    product = nodes.add("Mul", [*inputs, factor], f"{name}.product")
    nodes.scale(product, 0.5, name)


def write_gelu_tanh(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2"""
    (x,) = inputs
    square = nodes.add("Mul", [x, x], f"{name}.square")
    cube = nodes.add("Mul", [x, square], f"{name}.cube")
    part = nodes.scale(cube, 0.044715, f"{name}.part")
    inner = nodes.add("Add", [x, part], f"{name}.inner")
    scaled = nodes.scale(inner, (2 / np.pi) ** 0.5, f"{name}.scaled")
    tanh = nodes.add("Tanh", [scaled], f"{name}.tanh")
    factor = nodes.add_number(tanh, 1.0, f"{name}.sum")
    product = nodes.add("Mul", [x, factor], f"{name}.product")
    nodes.scale(product, 0.5, name)


def write_hardswish(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x hardsigmoid(x)"""
    factor = nodes.add("HardSigmoid", inputs, f"{name}.factor", alpha=1 / 6, beta=0.5)
    nodes.add("Mul", [*inputs, factor], name)


# -- pooling, the order of numbers -----------------------------------------------------------------


def write_sum_pool(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """Write a sum as the mean of the window times its number of places."""
    rows, columns = layer["kernel"]
    mean = nodes.add("AveragePool", inputs, f"{name}.mean", count_include_pad=1, **_window(layer))
    size = nodes.constant(f"{name}.size", rows * columns)
    nodes.add("Mul", [mean, size], name)


def write_adaptive_average_pool(
    nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str
) -> None:
    """A X B': A holds the share of each input row in each output row, B the same for columns."""
    rows, columns = layer["size"]
    _, input_rows, input_columns = nodes.input_shape(layer)
    row_shares = nodes.constant(f"{name}.a", adaptive_matrix(rows, input_rows))
    pooled_rows = nodes.add("MatMul", [row_shares, *inputs], f"{name}.rows")
    column_shares = nodes.constant(f"{name}.b", adaptive_matrix(columns, input_columns).T)
    nodes.add("MatMul", [pooled_rows, column_shares], name)


def write_pad(mode: str) -> WriteRule:
    """The rule of a padding: `mode` is "constant", for zeros, or "edge"."""

    def write(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
        top, left, bottom, right = layer["padding"]
        pads = [0, 0, top, left, 0, 0, bottom, right]
        constant = nodes.constant(f"{name}.pads", pads, np.int64)
        nodes.add("Pad", [*inputs, constant], name, mode=mode)

    return write


def write_bilinear_corners(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    sizes = nodes.constant(f"{name}.sizes", (1, *nodes.output_shape(layer)), np.int64)
    mode = {"mode": "linear", "coordinate_transformation_mode": "align_corners"}
    nodes.add("Resize", [*inputs, "", "", sizes], name, **mode)


def write_expand(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    shape = nodes.constant(f"{name}.shape", (1, *nodes.output_shape(layer)), np.int64)
    nodes.add("Expand", [*inputs, shape], name)


def write_pick(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    indices = nodes.constant(f"{name}.channels", layer["channels"], np.int64)
    nodes.add("Gather", [*inputs, indices], name, axis=1)


def write_depth_to_space(nodes: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    nodes.add("DepthToSpace", inputs, name, blocksize=layer["block"], mode="CRD")
