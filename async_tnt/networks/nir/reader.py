"""Layers of the nodes of a NIR graph, whatever the network is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.refusals import Refusals, RefusedError
from async_tnt.networks.nir.graph import Graph, Node, in_order
from async_tnt.networks.nir.nodes import Rule, Source, title_of

Layers = list[dict[str, Any]]

Weights = dict[str, np.ndarray]


class GraphReader:
    """The layers of the nodes that have been read so far.

    Parameters
    ----------
    graph : the graph.
    rules : type of a node -> its rule.
    """

    def __init__(self, graph: Graph, rules: Mapping[str, Rule]) -> None:
        self.layers: Layers = []
        self.weights: Weights = {}
        self.is_line = False
        """Whether the input is a line of pixels, (channels, W) or (W,), without rows."""
        self.pixels_alone: set[str] = set()
        """Values of a graph whose input is (W,), before its first dense layer.

        In NIR they are vectors. Here they are maps (1, 1, W).
        """
        self._graph = graph
        self._rules = rules
        self._sources: dict[str, list[str]] = {name: [] for name in graph.nodes}
        for source, target in graph.edges:
            self._sources[target].append(source)
        self._value_of: dict[str, str] = {}
        self._output: str | None = None
        self._refused = Refusals()

    def input(self, node: Node) -> str:
        """Read the graph's input. Returns the value that stands for it."""
        raise NotImplementedError

    def read(self) -> tuple[Layers, Weights]:
        """Read all nodes. Layers that the output does not need are left out.

        Raises
        ------
        NotImplementedError : nodes have no layer here. The message names them.
        ValueError : the graph does not fit together.
        """
        for node in in_order(self._graph):
            self._read_node(node)
        self._refused.raise_if_any()
        if self._output is None:
            raise ValueError("the graph must have an Input and an Output")
        needed = {self._output}
        kept: Layers = []
        for layer in reversed(self.layers):
            if layer["name"] in needed:
                needed.update(layer["inputs"])
                kept.insert(0, layer)
        tensors = {name for layer in kept for name in layer.get("weights", {}).values()}
        return kept, {name: values for name, values in self.weights.items() if name in tensors}

    def _read_node(self, node: Node) -> None:
        """Add the layers of a node."""
        try:
            if node.kind == "Input" and not self._sources[node.name]:
                self._value_of[node.name] = self.input(node)
                return
            value = self._sum_of_sources(node)
            if node.kind in ("Input", "Output"):  # those of a graph inside the graph, too
                self._value_of[node.name] = value
                if node.kind == "Output":
                    self._output = value
                return
            rule = self._rules.get(node.kind)
            if rule is None:
                raise RefusedError(node.kind, f"{title_of(node)} has no meaning here")
            is_pixels_alone = value in self.pixels_alone
            layer = rule(Source(self.is_line, is_pixels_alone), node)
            if is_pixels_alone and layer["op"] == "dense":
                value = self._as_vector(node.name, value)
            elif is_pixels_alone and layer["op"] != "flatten":
                self.pixels_alone.add(node.name)
            self._value_of[node.name] = self.add(node.name, [value], layer)
        except RefusedError as error:
            self._refused.add(error)
            self._value_of[node.name] = VOLUME  # so that later nodes are read, too
        except (NotImplementedError, ValueError) as error:
            if not self._refused:
                raise type(error)(f"{title_of(node)}: {error}") from None
            self._value_of[node.name] = VOLUME

    def add(self, name: str, inputs: list[str], layer: dict[str, Any]) -> str:
        """Add a layer; returns its name."""
        tensors = layer.pop("tensors", {})
        if tensors:
            layer["weights"] = {role: f"{name}.{role}" for role in tensors}
            for role, values in tensors.items():
                self.weights[f"{name}.{role}"] = values
        self.layers.append({"name": name, "inputs": inputs, **layer})
        return name

    def _sum_of_sources(self, node: Node) -> str:
        """What a node reads: one value, or the sum of several."""
        values = [self._value_of[source] for source in self._sources[node.name]]
        if not values:
            raise ValueError("it reads no other node")
        if len(values) == 1:
            return values[0]
        are_pixels = self.pixels_alone.issuperset(values)
        if not are_pixels:
            values = [self._as_vector(f"{node.name}.{k}", value) for k, value in enumerate(values)]
        total = self.add(f"{node.name}+", values, {"op": "add"})
        if are_pixels:
            self.pixels_alone.add(total)
        return total

    def _as_vector(self, name: str, value: str) -> str:
        """A value of a graph whose input is (W,) as the vector that it is in NIR."""
        if value not in self.pixels_alone:
            return value
        return self.add(f"{name}.vector", [value], {"op": "flatten"})
