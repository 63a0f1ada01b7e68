"""Networks of ReLUs as NIR graphs, and back.

NIR 1.0 has no ReLU. In a graph, integrate-and-fire neurons with a threshold of 1 stand for ReLUs:
reset by subtraction, a neuron that reads the activation a within a window fires floor(a) times.
This is how ANNs are converted to spiking networks. The graph's metadata say that ReLUs are meant.

References
----------
- Diehl, Neil, Binas, Cook, Liu, Pfeiffer 2015, Fast-classifying, high-accuracy spiking deep
  networks through weight and threshold balancing, IJCNN.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.layers.refusals import RefusedError
from async_tnt.networks.nir.graph import Graph, Node
from async_tnt.networks.nir.nodes import LINEAR_RULES, Source, array_of, floats_of, title_of
from async_tnt.networks.nir.reader import GraphReader, Layers, Weights
from async_tnt.networks.nir.writer import GraphWriter

if TYPE_CHECKING:
    import nir

ACTIVATION = "activation"
"""The name of the metadata that say what neurons stand for."""

RELU = "relu"


def relu_graph(
    layers: Layers, weights: Weights, volume: Shape, metadata: Mapping[str, Any]
) -> nir.NIRGraph:
    """The graph of a network of ReLUs.

    Parameters
    ----------
    layers, weights : those of a network without batch norms. The last layer is the output.
    volume : (C, H, W), the shape of what it reads.
    metadata : name -> text or number.

    Raises
    ------
    ImportError : the library nir is not installed.
    NotImplementedError : a layer has no NIR form. The message names the layer.
    """
    tensors = {name: w.shape for name, w in weights.items()}
    writer = _ReluWriter(weights, layer_shapes(layers, volume, tensors))
    return writer.graph(layers, {**metadata, ACTIVATION: RELU})


class _ReluWriter(GraphWriter):
    """The nodes and edges of the layers of a network of ReLUs."""

    def __init__(self, weights: Weights, shapes: Mapping[str, Shape]) -> None:
        super().__init__(weights, shapes)
        name = self.free_name("input")
        self.add(name, "Input", [], input_type=np.array(shapes[VOLUME]))
        self.nodes_of[VOLUME] = [name]

    def node_of(self, layer: Layer) -> tuple[str, dict[str, Any]]:
        """The type and the fields of a layer's node."""
        source = self.shapes[layer["inputs"][0]]
        if layer["op"] == "relu":
            ones = np.ones(source, np.float32)
            return "IF", {"r": ones, "v_threshold": ones.copy()}
        if layer["op"] == "global_average_pool":
            sides = np.array(source[1:])
            return "AvgPool2d", {"kernel_size": sides, "stride": sides, "padding": np.zeros(2, int)}
        return super().node_of(layer)


def is_of_relus(graph: Graph) -> bool:
    """Whether a graph's metadata say that its neurons stand for ReLUs."""
    value = graph.metadata.get(ACTIVATION)
    return isinstance(value, (str, bytes)) and value in (RELU, RELU.encode())


def relu_layers(graph: Graph, volume: Shape) -> tuple[Layers, Weights]:
    """The layers and weights of the graph of a network of ReLUs.

    Raises
    ------
    NotImplementedError : nodes are none of such a network. The message names them.
    ValueError : the graph does not fit together, or does not read volumes of this shape.
    """
    return _ReluReader(graph, volume).read()


class _ReluReader(GraphReader):
    """The layers of the nodes of a network of ReLUs."""

    def __init__(self, graph: Graph, volume: Shape) -> None:
        super().__init__(graph, {**LINEAR_RULES, "IF": _relu})
        self._volume = volume
        self._has_input = False

    def input(self, node: Node) -> str:
        """The volume."""
        if self._has_input:
            raise RefusedError("Input", f"{title_of(node)} must be the only one")
        self._has_input = True
        sides = np.atleast_1d(array_of(node, "shape")).tolist()
        if sides != list(self._volume):
            raise ValueError(
                f"its shape must be {self._volume}, as the graph's `config` says; got "
                f"{short(tuple(sides))}"
            )
        return VOLUME


def _relu(source: Source, node: Node) -> dict[str, Any]:
    """The ReLU for which neurons with gains and thresholds of 1 stand."""
    for name, expected in (("r", 1.0), ("v_threshold", 1.0), ("v_reset", 0.0)):
        if name == "v_reset" and name not in node.fields:
            continue
        values = floats_of(node, name)
        if (values != expected).any():
            raise ValueError(
                f"{name} must be {expected:.0f} where a neuron stands for a ReLU; pass `reset` to "
                "read the graph as a spiking network"
            )
    return {"op": "relu"}
