"""A NIR graph of the layers of a spiking network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.nir.from_nir import PolarityOrder
from async_tnt.networks.nir.writer import GraphWriter, conv_fields
from async_tnt.networks.spiking.operations import SPIKING_OPERATIONS

if TYPE_CHECKING:
    import nir

ON_FIRST = [0, 1]
"""The channels of a volume: ON and OFF."""

OFF_FIRST = [1, 0]

KIND_OF_NEURONS = {
    "if": "IF",
    "lif": "LIF",
    "cuba_lif": "CubaLIF",
    "threshold": "Threshold",
    "li": "LI",
    "cuba_li": "CubaLI",
}
"""Operation of neurons -> the type of its node."""


def nir_from_layers(
    layers: Sequence[Layer],
    weights: Mapping[str, np.ndarray],
    volume: Shape,
    polarity: PolarityOrder,
    metadata: Mapping[str, Any],
) -> nir.NIRGraph:
    """The graph of a spiking network's layers, see `networks.models.nir_export.to_nir`.

    Parameters
    ----------
    layers, weights : those of a Model.
    volume : (2, H, W), the shape of the volume.
    polarity : the order of the input's two channels.
    metadata : name -> text or number.

    Raises
    ------
    ImportError : the library nir is not installed.
    NotImplementedError : a layer has no NIR form. The message names the layer.
    """
    tensors = {name: w.shape for name, w in weights.items()}
    shapes = layer_shapes(layers, volume, tensors, operations=SPIKING_OPERATIONS)
    order = OFF_FIRST if polarity == "off_first" else ON_FIRST
    return _SpikingWriter(layers, weights, shapes, order).graph(layers, metadata)


class _SpikingWriter(GraphWriter):
    """The nodes and edges of a spiking network's layers.

    Parameters
    ----------
    order : the channels of the volume in the order of the input's.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        weights: Mapping[str, np.ndarray],
        shapes: Mapping[str, Shape],
        order: list[int],
    ) -> None:
        super().__init__(weights, shapes)
        self._order = order
        self._input: str | None = None
        self._add_input([layer for layer in layers if VOLUME in layer["inputs"]])

    def _add_input(self, readers: list[Layer]) -> None:
        """Add the input, which has the name of the layer that stands for it, if there is one."""
        _, height, width = self.shapes[VOLUME]
        first = readers[0]
        n_channels = 2
        name = "input"
        if len(readers) == 1 and self._is_sum_of_polarities(first):
            n_channels = 1
            name = first["name"]
        elif first["op"] == "pick" and list(first["channels"]) == self._order:
            name = first["name"]
        self._input = self.free_name(name)
        self.add(self._input, "Input", [], input_type=np.array([n_channels, height, width]))
        if n_channels == 1:
            self.nodes_of[first["name"]] = [self._input]

    def _is_sum_of_polarities(self, layer: Layer) -> bool:
        """Whether a layer only adds the two polarities of each pixel.

        Such a layer stands for an input (1, H, W).
        """
        if layer["op"] != "conv":
            return False
        weight = self.tensors_of(layer)["weight"]
        is_ones = weight.shape == (1, 2, 1, 1) and bool((weight == 1.0).all())
        return is_ones and list(layer["stride"]) == [1, 1] and not any(layer["padding"])

    def add_layer(self, layer: Layer) -> None:
        """Add the node of a layer, unless it is part of the input."""
        name = layer["name"]
        if name in self.nodes_of:
            return
        if layer["op"] == "pick":
            self.nodes_of[name] = [self._picked(layer["channels"], name)]
            return
        if VOLUME in layer["inputs"] and VOLUME not in self.nodes_of:
            self.nodes_of[VOLUME] = [self._picked(ON_FIRST, "on_first")]
        super().add_layer(layer)

    def _picked(self, channels: Sequence[int], name: str) -> str:
        """A node that gives channels of the volume: the input, or a convolution of one pixel."""
        assert self._input is not None
        if list(channels) == self._order:
            return self._input
        weight = np.zeros((len(channels), 2, 1, 1), np.float32)
        for row, channel in enumerate(channels):
            weight[row, self._order.index(channel)] = 1.0
        node = self.free_name(name)
        fields = conv_fields(self.shapes[VOLUME], {"weight": weight}, [1, 1], (0, 0), [1, 1], 1)
        self.add(node, "Conv2d", [self._input], **fields)
        return node

    def node_of(self, layer: Layer) -> tuple[str, dict[str, Any]]:
        """The type and the fields of a layer's node."""
        op = layer["op"]
        if op == "scale":
            return "Scale", {"scale": self.tensors_of(layer)["scale"]}
        if op in KIND_OF_NEURONS:
            # the roles of neurons are the names of NIR's fields
            source = self.shapes[layer["inputs"][0]]
            return KIND_OF_NEURONS[op], _of_one_shape(self.tensors_of(layer), source)
        return super().node_of(layer)


def _of_one_shape(tensors: dict[str, np.ndarray], shape: Shape) -> dict[str, np.ndarray]:
    """The parameters of neurons, all for each channel or all for each place."""
    if len({values.shape for values in tensors.values()}) == 1:
        return tensors
    ones = np.ones(shape, np.float32)
    return {
        role: values if values.shape == shape else values.reshape(-1, 1, 1) * ones
        for role, values in tensors.items()
    }
