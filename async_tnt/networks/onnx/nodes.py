"""The nodes of an ONNX graph that a network is written into."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.layer import Layer, Shape

if TYPE_CHECKING:
    import onnx

LOGITS = "logits"
"""The name of the graph's output, if the network computes logits."""


class OnnxNodes:
    """The nodes that were added so far, and the constants that they read.

    Parameters
    ----------
    layers : the layers of the network that is written.
    weights : the network's weights by name.
    shapes : name -> the shape of a layer's output, or of the volume.
    make_node : `onnx.helper.make_node`.
    outputs : the names of the graph's outputs.

    Attributes
    ----------
    nodes : the nodes in the order in which they are computed.
    weights : name -> values of the network's weights, and of further constants of the nodes.

    Raises
    ------
    ValueError : a weight has the name of the graph's input or output.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        weights: Mapping[str, np.ndarray],
        shapes: Mapping[str, Shape],
        make_node: Callable[..., onnx.NodeProto],
        outputs: Sequence[str],
    ) -> None:
        for name in (*outputs, VOLUME):
            if name in weights:
                raise ValueError(
                    f"a weight is named {name!r}, as ONNX's input or output: it needs another name"
                )
        self.nodes: list[onnx.NodeProto] = []
        self.weights = dict(weights)
        self._shapes = shapes
        self._make = make_node
        self._layer_names = [layer["name"] for layer in layers]
        self._taken = {VOLUME, *outputs, *weights}
        self._values = {VOLUME: VOLUME}  # layer -> the name of its value in the graph

    def value_of(self, layer: str) -> str:
        """The name that the value of a layer has in the graph."""
        return self._values[layer]

    def name_value(self, layer: Layer, *, is_logits: bool) -> str:
        """Choose the name that a layer's value has in the graph.

        It is the layer's name, with `_` added if the name is taken. If the layer computes the
        logits as a vector, it is `LOGITS`.
        """
        name: str = layer["name"]
        # A rule may add values of its own, such as "conv1.sum" for the layer "conv1". So no other
        # value may have such a name.
        while name in self._taken or any(
            other.startswith(f"{name}.") for other in self._layer_names
        ):
            name += "_"
        if is_logits and len(self._shapes[layer["name"]]) == 1:
            name = LOGITS
        self._taken.add(name)
        self._values[layer["name"]] = name
        return name

    def input_shape(self, layer: Layer) -> Shape:
        """The shape of a layer's first input."""
        return self._shapes[layer["inputs"][0]]

    def output_shape(self, layer: Layer) -> Shape:
        """The shape of a layer's output."""
        return self._shapes[layer["name"]]

    def add(self, op: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """Add a node; returns the name of its output."""
        self.nodes.append(self._make(op, list(inputs), [output], **attributes))
        return output

    def constant(self, name: str, value: Any, dtype: type = np.float32) -> str:
        """Add a constant; returns its name.

        It is `name`, with `_` added if another of the `weights` has this name.
        """
        while name in self.weights:
            name += "_"
        self.weights[name] = np.asarray(value, dtype)
        return name

    def scale(self, value: str, factor: float, name: str) -> str:
        """Add the product `value` * `factor`, named `name`; returns this name."""
        return self.add("Mul", [value, self.constant(f"{name}.factor", factor)], name)

    def add_number(self, value: str, number: float, name: str) -> str:
        """Add the sum `value` + `number`, named `name`; returns this name."""
        return self.add("Add", [value, self.constant(f"{name}.number", number)], name)
