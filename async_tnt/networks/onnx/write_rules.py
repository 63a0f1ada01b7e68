"""How layers become nodes of an ONNX graph.

Each rule receives the nodes so far, the layer, the names of its inputs' values, and the name that
the layer's value must have.
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

    def write(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
        made.add(op, inputs, name, **attributes)

    return write


def window_node(op: str, **attributes: Any) -> WriteRule:
    """The rule of a layer that is one node with a window."""

    def write(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
        made.add(op, inputs, name, **attributes, **_window(layer))

    return write


def _window(layer: Layer) -> dict[str, list[int]]:
    return {"kernel_shape": layer["kernel"], "strides": layer["stride"], "pads": layer["padding"]}


def _given(layer: Layer, *roles: str) -> list[str]:
    """The names of the layer's weights in these roles, without the missing ones."""
    return [layer["weights"][role] for role in roles if role in layer["weights"]]


# -- with weights ----------------------------------------------------------------------------------


def write_conv(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    made.add(
        "Conv",
        [*inputs, *_given(layer, "weight", "bias")],
        name,
        **_window(layer),
        dilations=layer["dilation"],
        group=layer["groups"],
    )


def write_dense(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    made.add("Gemm", [*inputs, *_given(layer, "weight", "bias")], name, transB=1)


def write_batch_norm(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    n = made.output_shape(layer)[0]
    given = layer["weights"]
    weight = given.get("weight") or made.constant(f"{name}.ones", np.ones(n))
    bias = given.get("bias") or made.constant(f"{name}.zeros", np.zeros(n))
    constants = [weight, bias, given["mean"], given["variance"]]
    made.add("BatchNormalization", [*inputs, *constants], name, epsilon=float(layer["epsilon"]))


# -- activations -----------------------------------------------------------------------------------


def write_leaky_relu(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    made.add("LeakyRelu", inputs, name, alpha=float(layer["slope"]))


def write_prelu(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    slope = made.weights[layer["weights"]["slope"]]
    other_sides = [1] * (len(made.output_shape(layer)) - 1)
    constant = made.constant(f"{name}.slope", slope.reshape(-1, *other_sides))
    made.add("PRelu", [*inputs, constant], name)


def write_clip(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    limits = []
    for side in ("low", "high"):
        has_limit = layer[side] is not None
        limits.append(made.constant(f"{name}.{side}", layer[side]) if has_limit else "")
    made.add("Clip", [*inputs, *limits], name)


def write_softshrink(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    limit = float(layer["lambd"])
    made.add("Shrink", inputs, name, lambd=limit, bias=limit)


def write_log1p(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """log(x + 1)"""
    made.add("Log", [made.add_number(inputs[0], 1.0, f"{name}.sum")], name)


def write_silu(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x sigmoid(x)"""
    sigmoid = made.add("Sigmoid", inputs, f"{name}.sigmoid")
    made.add("Mul", [*inputs, sigmoid], name)


def write_gelu(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x (1 + erf(x / sqrt 2)) / 2"""
    scaled = made.scale(inputs[0], 0.5**0.5, f"{name}.scaled")
    erf = made.add("Erf", [scaled], f"{name}.erf")
    factor = made.add_number(erf, 1.0, f"{name}.sum")
    product = made.add("Mul", [*inputs, factor], f"{name}.product")
    made.scale(product, 0.5, name)


def write_gelu_tanh(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2"""
    (x,) = inputs
    square = made.add("Mul", [x, x], f"{name}.square")
    cube = made.add("Mul", [x, square], f"{name}.cube")
    part = made.scale(cube, 0.044715, f"{name}.part")
    inner = made.add("Add", [x, part], f"{name}.inner")
    scaled = made.scale(inner, (2 / np.pi) ** 0.5, f"{name}.scaled")
    tanh = made.add("Tanh", [scaled], f"{name}.tanh")
    factor = made.add_number(tanh, 1.0, f"{name}.sum")
    product = made.add("Mul", [x, factor], f"{name}.product")
    made.scale(product, 0.5, name)


def write_hardswish(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """x hardsigmoid(x)"""
    factor = made.add("HardSigmoid", inputs, f"{name}.factor", alpha=1 / 6, beta=0.5)
    made.add("Mul", [*inputs, factor], name)


# -- pooling, the order of numbers -----------------------------------------------------------------


def write_sum_pool(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    """Write a sum as the mean of the window times its number of places."""
    rows, columns = layer["kernel"]
    mean = made.add("AveragePool", inputs, f"{name}.mean", count_include_pad=1, **_window(layer))
    size = made.constant(f"{name}.size", rows * columns)
    made.add("Mul", [mean, size], name)


def write_adaptive_average_pool(
    made: OnnxNodes, layer: Layer, inputs: list[str], name: str
) -> None:
    """A X B': A holds the share of each input row in each output row, B the same for columns."""
    rows, columns = layer["size"]
    _, input_rows, input_columns = made.input_shape(layer)
    a = made.constant(f"{name}.a", adaptive_matrix(rows, input_rows))
    of_rows = made.add("MatMul", [a, *inputs], f"{name}.rows")
    b = made.constant(f"{name}.b", adaptive_matrix(columns, input_columns).T)
    made.add("MatMul", [of_rows, b], name)


def write_depth_to_space(made: OnnxNodes, layer: Layer, inputs: list[str], name: str) -> None:
    made.add("DepthToSpace", inputs, name, blocksize=layer["block"], mode="CRD")
