"""The nodes of an ONNX graph as Python objects, and the layers that they become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.graph import VOLUME, layer_shapes

if TYPE_CHECKING:
    import onnx


class Node:
    """A node of an ONNX graph, with its attributes as Python values.

    Attributes
    ----------
    proto : the node as the file has it.
    op : the node's ONNX operator.
    inputs : the names of the node's inputs; "" for an input that is left out.
    outputs : the names of the node's outputs, without outputs that are left out.
    where : the node's name in messages.
    """

    def __init__(self, node: onnx.NodeProto) -> None:
        from onnx import helper

        self.proto = node
        self.op: str = node.op_type
        self.inputs = list(node.input)
        self.outputs = [name for name in node.output if name]
        self.where = f"node {node.name or node.output[0]!r} ({node.op_type})"
        self._attributes = {
            attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute
        }

    def get(self, name: str, default: Any = None) -> Any:
        """An attribute of the node, text decoded; `default` if the node does not have it."""
        value = self._attributes.get(name, default)
        return value.decode() if isinstance(value, bytes) else value


class Grouped(NamedTuple):
    """A map with its channels arranged in groups, see `arranging.reshape`."""

    source: str
    """The value of the map itself."""
    groups: int
    is_transposed: bool = False


def without_leading_ones(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape without the sides of 1 at its front, which change nothing when ONNX broadcasts."""
    while shape[:1] == (1,):
        shape = shape[1:]
    return shape


class FlatGroups(NamedTuple):
    """A map as (groups, numbers of a group), see `norms.instance_norm`."""

    source: str
    """The value of the map itself."""
    groups: int
    epsilon: float | None = None
    """The epsilon of each group's norm, once the norm has been read."""


class OnnxLayers:
    """The layers that a graph's nodes have become so far, and the weights of these layers.

    Parameters
    ----------
    input_name : the name of the network's input, a volume of `shape` (C, H, W) and type `dtype`.
    constants : name -> values of the graph's constants.
    opset : the version of ONNX's operations.

    Attributes
    ----------
    layers : the layers, in the order in which they are computed.
    tensors : name -> weights.
    dtype : type of the network's input and weights.
    names : name of a value -> the layer that computes the value.
    grouped : name of a value -> the map whose channels it has in groups.
    flat_groups : name of a value -> the map whose groups of channels are its rows.
    channels_last : names of the values that have their channels as last axis.
    stacked : name of a value -> the maps that lie along its first axis.
    n_folded : numbers that were computed from constants alone so far.
    """

    def __init__(
        self,
        input_name: str,
        shape: tuple[int, ...],
        dtype: np.dtype,
        constants: Mapping[str, np.ndarray],
        opset: int,
    ) -> None:
        self.layers: list[dict[str, Any]] = []
        self.tensors: dict[str, np.ndarray] = {}
        self.names = {input_name: VOLUME}
        self.grouped: dict[str, Grouped] = {}
        self.flat_groups: dict[str, FlatGroups] = {}
        self.channels_last: set[str] = set()
        self.stacked: dict[str, list[str]] = {}
        self.n_folded = 0
        self.constants = dict(constants)
        self.opset = opset
        self._shape = shape
        self.dtype = dtype

    def add(self, node: Node, op: str, sources: Sequence[str], **parameters: Any) -> None:
        """Add a layer that a node becomes, named after the node's first output.

        If a node becomes several layers, the last of them computes the node's output.
        """
        self.add_value(node.outputs[0], op, sources, parameters)

    def add_value(
        self, value: str, op: str, sources: Sequence[str], parameters: Mapping[str, Any]
    ) -> None:
        """Add a layer that computes a value, and is named after it."""
        used_names = {VOLUME, *(layer["name"] for layer in self.layers)}
        name = value
        while name in used_names:
            name += "_"
        inputs = [self.layer_name(source) for source in sources]
        self.layers.append({"op": op, "name": name, "inputs": inputs, **parameters})
        self.names[value] = name

    def group(self, node: Node, grouped: Grouped) -> None:
        """Add a node that arranges the channels of a map in groups: it adds no layer."""
        self.grouped[node.outputs[0]] = grouped

    def layer_name(self, value: str) -> str:
        """The name of the layer that computes a value.

        Raises
        ------
        NotImplementedError : the value does not depend on the volume.
        """
        if value not in self.names:
            raise NotImplementedError(f"its input {value!r} is not computed from the volume")
        return self.names[value]

    def layer_of(self, value: str) -> dict[str, Any]:
        """The layer that computes a value; for the volume, a stand-in with the `op` "volume"."""
        name = self.layer_name(value)
        for layer in self.layers:
            if layer["name"] == name:
                return layer
        return {"op": VOLUME, "inputs": []}

    def shape(self, value: str) -> tuple[int, ...]:
        """The shape of a value, (C, H, W) or (N,).

        If a map has its channels in groups, or as last axis, this is the shape of the map itself.
        """
        if value in self.grouped:
            value = self.grouped[value].source
        if value in self.flat_groups:
            value = self.flat_groups[value].source
        tensors = {name: values.shape for name, values in self.tensors.items()}
        return layer_shapes(self.layers, self._shape, tensors, outputs=())[self.layer_name(value)]

    def alias(self, node: Node, value: str) -> None:
        """Add a node that passes a value on: the value's layer computes the node's output."""
        self.names[node.outputs[0]] = self.layer_name(value)

    def constant(self, node: Node, place: int) -> np.ndarray | None:
        """A constant input; None where there is no input at this place."""
        if place >= len(node.inputs) or not node.inputs[place]:
            return None
        name = node.inputs[place]
        if name not in self.constants:
            raise NotImplementedError(f"its input {name!r} is not a constant")
        return self.constants[name]

    def floating(self, name: str) -> np.ndarray:
        """A constant, which must have the type of the network's numbers."""
        constant = self.constants[name]
        is_floating = constant.dtype == self.dtype
        expect_form(is_floating, f"{name!r} of type {constant.dtype} beside {self.dtype}")
        return constant

    def tensor(self, name: str, values: np.ndarray) -> str:
        """Keep a tensor; returns the name under which it is kept.

        The name is `name`, with `_` added if a different tensor already has it.
        """
        expect_form(
            values.dtype == self.dtype,
            f"{name!r} of type {values.dtype} beside an input of {self.dtype}",
        )
        values = np.asarray(values, np.float32)
        while name in self.tensors and not np.array_equal(self.tensors[name], values):
            name += "_"
        self.tensors[name] = values
        return name

    def weights(self, node: Node, **places: int) -> dict[str, str]:
        """Keep constant inputs as tensors.

        Parameters
        ----------
        places : role of weights -> the place of their tensor among the node's inputs.

        Returns
        -------
        Role -> the tensor's name, for the inputs that the node has.
        """
        constants = {role: self.constant(node, place) for role, place in places.items()}
        weights = {}
        for role, values in constants.items():
            if values is not None:
                weights[role] = self.tensor(node.inputs[places[role]], values)
        return weights
