"""Nodes of an ONNX graph that do not depend on the volume: they are computed while it is read.

Exporters write the size of a resize or reshape as nodes that compute it from the shape of another
value. A volume's shape is known, and its batch has one volume. Weights that a network standardizes
are computed by nodes, too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form

if TYPE_CHECKING:
    from async_tnt.networks.onnx.layers import Node, OnnxLayers

FOLDED = {
    "Add",
    "BatchNormalization",
    "Cast",
    "Ceil",
    "Clip",
    "Concat",
    "ConstantOfShape",
    "Div",
    "Floor",
    "Gather",
    "Identity",
    "Max",
    "Min",
    "Mod",
    "Mul",
    "Neg",
    "ReduceMean",
    "Reshape",
    "Slice",
    "Squeeze",
    "Sub",
    "Transpose",
    "Unsqueeze",
}
"""Operators that are computed if all of their inputs are constants."""

BROADCASTING = {"Add", "Clip", "Div", "Max", "Min", "Mod", "Mul", "Sub"}
"""Those of them whose output may have more numbers than each input."""

MOST_NUMBERS = 1 << 12
"""Most numbers of an output that is larger than each input: such nodes compute sizes.

Hostile files may ask for more.
"""

MOST_NUMBERS_OF_ALL = 1 << 27
"""Most numbers of the outputs of all these nodes: hostile files may compute large weights often."""


def is_folded(onnx_layers: OnnxLayers, node: Node) -> bool:
    """Compute the outputs of a node that does not depend on the volume's numbers.

    Returns False, and does nothing, for another node.

    Raises
    ------
    NotImplementedError : the node cannot be computed.
    """
    if node.op == "Shape" and _has_shape(onnx_layers, node.inputs[0]):
        shape = _shape(onnx_layers, node.inputs[0])
        part = shape[node.get("start", 0) : node.get("end", len(shape))]
        onnx_layers.constants[node.outputs[0]] = np.array(part, np.int64)
        return True
    inputs = [name for name in node.inputs if name]
    if node.op not in FOLDED or not all(name in onnx_layers.constants for name in inputs):
        return False
    values = [onnx_layers.constants[name] for name in inputs]
    size = _output_size(node, values)
    largest_input = max((value.size for value in values), default=0)
    onnx_layers.n_folded += max(size, largest_input)
    fits = size <= max(MOST_NUMBERS, largest_input)
    fits = fits and onnx_layers.n_folded <= MOST_NUMBERS_OF_ALL
    expect_form(fits, f"a {node.op} of large constants")
    try:
        outputs = _computed(node, dict(zip(inputs, values, strict=True)), onnx_layers.opset)
    except Exception as error:  # the evaluator raises whatever NumPy raises
        raise NotImplementedError(f"it cannot be computed: {error}") from None
    onnx_layers.constants.update(zip(node.outputs, outputs, strict=True))
    return True


def _has_shape(onnx_layers: OnnxLayers, value: str) -> bool:
    """Whether the shape of a value is known."""
    return value in onnx_layers.names or value in onnx_layers.constants


def _shape(onnx_layers: OnnxLayers, value: str) -> tuple[int, ...]:
    """The shape of a value, with its batch of one."""
    if value in onnx_layers.constants:
        return onnx_layers.constants[value].shape
    channels, *sides = onnx_layers.shape(value)
    if value in onnx_layers.channels_last:
        return (1, *sides, channels)
    return (1, channels, *sides)


def _output_size(node: Node, values: list[np.ndarray]) -> int:
    """How many numbers a node's output has, if it may have more than its inputs; else 0.

    values : the inputs in the node's order. A node may read one constant several times.
    """
    if node.op == "ConstantOfShape":
        return math.prod(map(int, values[0].reshape(-1)))
    if node.op == "Concat":
        return sum(value.size for value in values)
    if node.op in BROADCASTING:
        return math.prod(np.broadcast_shapes(*(value.shape for value in values)))
    if node.op == "Gather":
        data, indices = values
        length = int(data.shape[node.get("axis", 0)])
        return indices.size * (data.size // max(1, length))
    return 0


def _computed(node: Node, values: dict[str, np.ndarray], opset: int) -> list[np.ndarray]:
    """The outputs of a node, by ONNX's own reference of its operators.

    values : name -> values of the node's inputs.
    """
    from onnx import TensorProto, helper
    from onnx.reference import ReferenceEvaluator

    inputs = [
        helper.make_tensor_value_info(
            name, helper.np_dtype_to_tensor_dtype(value.dtype), value.shape
        )
        for name, value in values.items()
    ]
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.UNDEFINED, None) for name in node.outputs
    ]
    graph = helper.make_graph([node.proto], "constants", inputs, outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
    return [np.asarray(value) for value in ReferenceEvaluator(model).run(None, values)]
