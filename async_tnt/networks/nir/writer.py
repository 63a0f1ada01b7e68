"""The nodes and edges of a NIR graph, layer by layer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.networks.layers.layer import Layer, Shape

if TYPE_CHECKING:
    import nir


class GraphWriter:
    """The nodes and edges of the layers that have been added so far.

    Parameters
    ----------
    weights : name -> values.
    shapes : layer -> the shape of its output; also VOLUME -> the shape of the volume.

    Attributes
    ----------
    nodes : name -> node.
    edges : pairs of names.
    nodes_of : layer, or VOLUME -> the nodes whose sum it is.
    """

    def __init__(self, weights: Mapping[str, np.ndarray], shapes: Mapping[str, Shape]) -> None:
        with needs_extra("nir", "NIR graphs are written by nir"):
            import nir
        self._nir = nir
        self.nodes: dict[str, Any] = {}
        self.edges: list[tuple[str, str]] = []
        self.nodes_of: dict[str, list[str]] = {}
        self.shapes = shapes
        self._weights = weights

    def graph(self, layers: Sequence[Layer], metadata: Mapping[str, Any]) -> nir.NIRGraph:
        """The graph of layers, of which the last is the output.

        Raises
        ------
        NotImplementedError : a layer has no NIR form. The message names the layer.
        """
        for layer in layers:
            self.add_layer(layer)
        self.add_output(layers[-1]["name"])
        # nir's check of types wants a parameter for each place, and not one for each channel, and
        # takes the channels of one group for those of a convolution's input
        return self._nir.NIRGraph(self.nodes, self.edges, metadata=dict(metadata), type_check=False)

    def add_layer(self, layer: Layer) -> None:
        """Add the node of a layer.

        Raises
        ------
        NotImplementedError : it has no NIR form.
        """
        name = layer["name"]
        sources = self._sources_of(layer)
        if layer["op"] == "add":
            self.nodes_of[name] = sources
            return
        try:
            kind, fields = self.node_of(layer)
        except NotImplementedError as error:
            raise NotImplementedError(f"layer {name!r} ({layer['op']}): {error}") from None
        node = self.free_name(name)
        self.add(node, kind, sources, **fields)
        self.nodes_of[name] = [node]

    def add_output(self, layer: str) -> None:
        """Add the output. It reads a layer."""
        shape = np.array(self.shapes[layer])
        self.add(self.free_name("output"), "Output", self.nodes_of[layer], output_type=shape)

    def add(self, name: str, kind: str, sources: Sequence[str], **fields: Any) -> None:
        """Add a node that reads other nodes."""
        self.nodes[name] = getattr(self._nir, kind)(**fields)
        self.edges += [(source, name) for source in sources]

    def free_name(self, name: str) -> str:
        """A name that no node has yet. In HDF5 a slash would make a group of its own."""
        free = name.replace("/", ".")
        while free in self.nodes:
            free = f"{free}_"
        return free

    def node_of(self, layer: Layer) -> tuple[str, dict[str, Any]]:
        """The type and the fields of a layer's node.

        Raises
        ------
        NotImplementedError : it has none.
        """
        op = layer["op"]
        source = self.shapes[layer["inputs"][0]]
        tensors = self.tensors_of(layer)
        if op == "conv":
            return "Conv2d", conv_fields(
                source,
                tensors,
                layer["stride"],
                _conv_padding(layer),
                layer["dilation"],
                layer["groups"],
            )
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
            return ("Affine" if "bias" in tensors else "Linear"), tensors
        raise NotImplementedError("NIR 1.0 has no such node")

    def tensors_of(self, layer: Layer) -> dict[str, np.ndarray]:
        """Role -> weights of a layer. They are copies, as whoever has the graph may change it."""
        roles = layer.get("weights", {})
        return {role: self._weights[name].copy() for role, name in roles.items()}

    def _sources_of(self, layer: Layer) -> list[str]:
        """The nodes that a layer reads. NIR adds what several nodes give to one."""
        sources: list[str] = []
        for name in layer["inputs"]:
            sources += self.nodes_of[name]
        if len(set(sources)) < len(sources):
            raise NotImplementedError(
                f"layer {layer['name']!r} ({layer['op']}): it adds a layer to itself, and NIR has "
                "no such edges"
            )
        return sources


def conv_fields(
    source: Shape,
    tensors: Mapping[str, np.ndarray],
    stride: Sequence[int],
    padding: tuple[int, int] | str,
    dilation: Sequence[int],
    groups: int,
) -> dict[str, Any]:
    """The fields of a Conv2d, which always has a bias."""
    weight = tensors["weight"]
    return {
        "input_shape": tuple(source[1:]),
        "weight": weight,
        "stride": tuple(stride),
        "padding": padding,
        "dilation": tuple(dilation),
        "groups": groups,
        "bias": tensors.get("bias", np.zeros(len(weight), np.float32)),
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
