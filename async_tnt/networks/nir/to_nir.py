"""A NIR graph of the layers of a spiking network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.nir.from_nir import PolarityOrder
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
    with needs_extra("nir", "NIR graphs are written by nir"):
        import nir
    nodes = _Nodes(layers, weights, volume, OFF_FIRST if polarity == "off_first" else ON_FIRST)
    for layer in layers:
        nodes.add_layer(layer)
    nodes.add_output()
    # neurons with a parameter for each channel fail the check of types, which wants one for each
    # place
    return nir.NIRGraph(nodes.nodes, nodes.edges, metadata=dict(metadata), type_check=False)


class _Nodes:
    """The nodes and edges of a graph.

    Attributes
    ----------
    nodes : name -> node.
    edges : pairs of names.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        weights: Mapping[str, np.ndarray],
        volume: Shape,
        order: list[int],
    ) -> None:
        self.nodes: dict[str, Any] = {}
        self.edges: list[tuple[str, str]] = []
        self._layers = layers
        self._weights = weights
        self._order = order
        tensors = {name: w.shape for name, w in weights.items()}
        self._shapes = layer_shapes(layers, volume, tensors, operations=SPIKING_OPERATIONS)
        # layer -> the nodes whose sum it is
        self._nodes_of: dict[str, list[str]] = {}
        self._input: str | None = None
        self._add_input()

    def _add_input(self) -> None:
        """Add the input, which has the name of the layer that stands for it, if there is one."""
        _, height, width = self._shapes[VOLUME]
        readers = [layer for layer in self._layers if VOLUME in layer["inputs"]]
        first = readers[0]
        n_channels = 2
        name = "input"
        if len(readers) == 1 and self._is_sum_of_polarities(first):
            n_channels = 1
            name = first["name"]
        elif first["op"] == "pick" and list(first["channels"]) == self._order:
            name = first["name"]
        self._input = self._free_name(name)
        self._add(self._input, "Input", [], input_type=np.array([n_channels, height, width]))
        if n_channels == 1:
            self._nodes_of[first["name"]] = [self._input]

    def _is_sum_of_polarities(self, layer: Layer) -> bool:
        """Whether a layer adds the two polarities of each pixel, as that of an input (1, H, W)."""
        if layer["op"] != "conv":
            return False
        weight = self._weights[layer["weights"]["weight"]]
        is_ones = weight.shape == (1, 2, 1, 1) and bool((weight == 1.0).all())
        return is_ones and list(layer["stride"]) == [1, 1] and not any(layer["padding"])

    def add_layer(self, layer: Layer) -> None:
        """Add the node of a layer.

        Raises
        ------
        NotImplementedError : it has no NIR form.
        """
        name = layer["name"]
        if name in self._nodes_of:
            return
        if layer["op"] == "pick":
            self._nodes_of[name] = [self._picked(layer["channels"], name)]
            return
        sources = self._sources_of(layer)
        if layer["op"] == "add":
            self._nodes_of[name] = sources
            return
        try:
            kind, fields = self._node_of(layer)
        except NotImplementedError as error:
            raise NotImplementedError(f"layer {name!r} ({layer['op']}): {error}") from None
        node = self._free_name(name)
        self._add(node, kind, sources, **fields)
        self._nodes_of[name] = [node]

    def add_output(self) -> None:
        """Add the output. It reads the last layer."""
        last = self._layers[-1]["name"]
        shape = np.array(self._shapes[last])
        self._add(self._free_name("output"), "Output", self._nodes_of[last], output_type=shape)

    def _sources_of(self, layer: Layer) -> list[str]:
        """The nodes that a layer reads. NIR adds what several nodes give to one."""
        sources: list[str] = []
        for name in layer["inputs"]:
            if name == VOLUME and VOLUME not in self._nodes_of:
                self._nodes_of[VOLUME] = [self._picked(ON_FIRST, "on_first")]
            sources += self._nodes_of[name]
        if len(set(sources)) < len(sources):
            raise NotImplementedError(
                f"layer {layer['name']!r} ({layer['op']}): it adds a layer to itself, and NIR has "
                "no such edges"
            )
        return sources

    def _picked(self, channels: Sequence[int], name: str) -> str:
        """A node that gives channels of the volume: the input, or a convolution of one pixel."""
        assert self._input is not None
        if list(channels) == self._order:
            return self._input
        weight = np.zeros((len(channels), 2, 1, 1), np.float32)
        for row, channel in enumerate(channels):
            weight[row, self._order.index(channel)] = 1.0
        node = self._free_name(name)
        fields = _conv_fields(self._shapes[VOLUME], weight, [1, 1], (0, 0), [1, 1], 1)
        self._add(node, "Conv2d", [self._input], **fields)
        return node

    def _add(self, name: str, kind: str, sources: list[str], **fields: Any) -> None:
        import nir

        self.nodes[name] = getattr(nir, kind)(**fields)
        self.edges += [(source, name) for source in sources]

    def _free_name(self, name: str) -> str:
        """A name that no node has yet. In HDF5 a slash would make a group of its own."""
        free = name.replace("/", ".")
        while free in self.nodes:
            free = f"{free}_"
        return free

    # -- the nodes of layers -----------------------------------------------------------------------

    def _node_of(self, layer: Layer) -> tuple[str, dict[str, Any]]:
        """The type and the fields of a layer's node."""
        op = layer["op"]
        source = self._shapes[layer["inputs"][0]]
        tensors = {
            role: self._weights[name].copy()  # whoever has the graph may change it
            for role, name in layer.get("weights", {}).items()
        }
        if op == "conv":
            padding = _conv_padding(layer)
            fields = _conv_fields(
                source,
                tensors["weight"],
                layer["stride"],
                padding,
                layer["dilation"],
                layer["groups"],
            )
            return "Conv2d", fields
        if op in ("sum_pool", "average_pool"):
            fields = {
                "kernel_size": np.array(layer["kernel"]),
                "stride": np.array(layer["stride"]),
                "padding": np.array(_symmetric(layer["padding"])),
            }
            return ("SumPool2d" if op == "sum_pool" else "AvgPool2d"), fields
        if op == "flatten":
            shape = {"input": np.array(source)}
            return "Flatten", {"input_type": shape, "start_dim": 0, "end_dim": -1}
        if op == "dense":
            return "Linear", {"weight": tensors["weight"]}
        if op == "scale":
            return "Scale", {"scale": tensors["scale"]}
        # the roles of neurons are the names of NIR's fields
        return KIND_OF_NEURONS[op], _of_one_shape(tensors, source)


def _of_one_shape(tensors: dict[str, np.ndarray], shape: Shape) -> dict[str, np.ndarray]:
    """The parameters of neurons, all for each channel or all for each place."""
    if len({values.shape for values in tensors.values()}) == 1:
        return tensors
    ones = np.ones(shape, np.float32)
    return {
        role: values if values.shape == shape else values.reshape(-1, 1, 1) * ones
        for role, values in tensors.items()
    }


def _conv_fields(
    source: Shape,
    weight: np.ndarray,
    stride: Sequence[int],
    padding: tuple[int, int] | str,
    dilation: Sequence[int],
    groups: int,
) -> dict[str, Any]:
    return {
        "input_shape": tuple(source[1:]),
        "weight": weight,
        "stride": tuple(stride),
        "padding": padding,
        "dilation": tuple(dilation),
        "groups": groups,
        "bias": np.zeros(len(weight), np.float32),
    }


def _conv_padding(layer: Layer) -> tuple[int, int] | str:
    """The padding of a convolution, in NIR's words: two numbers, or "same"."""
    top, left, bottom, right = layer["padding"]
    if top == bottom and left == right:
        return top, left
    reach = [(k - 1) * d for k, d in zip(layer["kernel"], layer["dilation"], strict=True)]
    before = [side // 2 for side in reach]
    after = [side - first for side, first in zip(reach, before, strict=True)]
    if [top, left, bottom, right] == before + after:
        return "same"
    return _symmetric(layer["padding"])


def _symmetric(padding: Sequence[int]) -> tuple[int, int]:
    """The padding (rows, columns).

    Raises
    ------
    NotImplementedError : it differs between two sides.
    """
    top, left, bottom, right = padding
    if top != bottom or left != right:
        raise NotImplementedError(
            f"its padding must be the same on opposite sides in NIR, got {list(padding)} (top, "
            "left, bottom, right)"
        )
    return top, left
