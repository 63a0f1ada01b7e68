"""What an ONNX graph is read into: its nodes, and the layers that they become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.graph import VOLUME, layer_shapes

if TYPE_CHECKING:
    import onnx


class Node:
    """A node, its attributes as Python values."""

    def __init__(self, node: onnx.NodeProto) -> None:
        from onnx import helper

        self.op, self.inputs = node.op_type, list(node.input)
        self.outputs = [name for name in node.output if name]
        self.where = f"node {node.name or node.output[0]!r} ({node.op_type})"
        self._attributes = {
            attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute
        }

    def get(self, name: str, default: Any = None) -> Any:
        """An attribute of the node, text decoded; `default` if the node does not have it."""
        value = self._attributes.get(name, default)
        return value.decode() if isinstance(value, bytes) else value


class OnnxLayers:
    """The layers of a graph and their weights, so far.

    Parameters
    ----------
    given : the name of the network's input, a volume of `shape` (C, H, W) and type `dtype`.
    constants : name -> values.
    opset : the version of ONNX's operations.
    """

    def __init__(
        self,
        given: str,
        shape: tuple[int, ...],
        dtype: np.dtype,
        constants: Mapping[str, np.ndarray],
        opset: int,
    ) -> None:
        self.layers: list[dict[str, Any]] = []
        self.tensors: dict[str, np.ndarray] = {}
        self.names = {given: VOLUME}
        """Value -> the layer that computes it."""
        self.constants = dict(constants)
        self.opset = opset
        self._shape, self._dtype = shape, dtype

    def add(self, node: Node, op: str, sources: Sequence[str], **parameters: Any) -> None:
        """A layer named after the node's output; one that follows in the same node takes its
        place."""
        taken = {VOLUME, *(layer["name"] for layer in self.layers)}
        name = node.outputs[0]
        while name in taken:
            name += "_"
        self.layers.append(
            {
                "op": op,
                "name": name,
                "inputs": [self.layer(source) for source in sources],
                **parameters,
            }
        )
        self.names[node.outputs[0]] = name

    def layer(self, value: str) -> str:
        """The name of the layer that computes a value; a NotImplementedError if it does not depend
        on the volume."""
        if value not in self.names:
            raise NotImplementedError(f"its input {value!r} is not computed from the volume")
        return self.names[value]

    def layer_of(self, value: str) -> dict[str, Any]:
        """The layer that computes a value; an empty one, with `op` "volume", for the volume."""
        name = self.layer(value)
        return next(
            (layer for layer in self.layers if layer["name"] == name), {"op": VOLUME, "inputs": []}
        )

    def shape(self, value: str) -> tuple[int, ...]:
        """(C, H, W) or (N,)."""
        tensors = {name: values.shape for name, values in self.tensors.items()}
        return layer_shapes(self.layers, self._shape, tensors, partial=True)[self.layer(value)]

    def alias(self, node: Node, value: str) -> None:
        """A node that passes a value on: its output has the name of the same layer."""
        self.names[node.outputs[0]] = self.layer(value)

    def constant(self, node: Node, place: int) -> np.ndarray | None:
        """A constant input; None where there is no input at this place."""
        if place >= len(node.inputs) or not node.inputs[place]:
            return None
        if node.inputs[place] not in self.constants:
            raise NotImplementedError(f"its input {node.inputs[place]!r} is not a constant")
        return self.constants[node.inputs[place]]

    def tensor(self, name: str, values: np.ndarray) -> str:
        """Keep a tensor under its own name, or where another one has it, with a `_` behind."""
        expect_form(
            values.dtype == self._dtype,
            f"{name!r} of type {values.dtype} beside an input of {self._dtype}",
        )
        values = np.asarray(values, np.float32)
        while name in self.tensors and not np.array_equal(self.tensors[name], values):
            name += "_"
        self.tensors[name] = values
        return name

    def weights(self, node: Node, **places: int) -> dict[str, str]:
        """Role -> name of the tensor at this place of the inputs."""
        found = {role: self.constant(node, place) for role, place in places.items()}
        return {
            role: self.tensor(node.inputs[places[role]], values)
            for role, values in found.items()
            if values is not None
        }
