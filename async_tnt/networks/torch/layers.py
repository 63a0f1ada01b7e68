"""What a trace of a torch module is read into: calls of known operations, and the layers they
become."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import fx

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.graph import VOLUME, layer_shapes


@dataclass(frozen=True)
class Call:
    """A node of the trace that is a known operation, with all of its arguments."""

    node: fx.Node
    arguments: Mapping[str, Any]
    module: Any
    """The torch module that is called, or None."""

    def __getitem__(self, name: str) -> Any:
        return self.arguments[name]

    @property
    def written(self) -> Any:
        """The node whose value its result replaces, as of in-place operations; or None."""
        target = self.node.target
        name = target if self.node.op == "call_method" else getattr(target, "__name__", "")
        in_place = str(name).endswith("_") or bool(self.arguments.get("inplace"))
        return self.arguments["input"] if in_place else self.arguments.get("out")


class LayerList:
    """The layers of a trace and their weights, so far; for volumes of this shape, (C, H, W)."""

    def __init__(self, shape: tuple[int, ...], prefix: str) -> None:
        self._volume, self.prefix = shape, prefix
        self.layers: list[dict[str, Any]] = []
        self.weights: dict[str, np.ndarray] = {}
        self.names: dict[fx.Node, str] = {}
        """Of the layer whose value a node has."""

    def add(
        self, op: str, call: Call, sources: Iterable[Any] | None = None, **parameters: Any
    ) -> str:
        """Add a layer of a call; returns its name. `sources` are by default its only input."""
        taken = {VOLUME, *(layer["name"] for layer in self.layers)}
        node = call.node
        name = (
            str(node.target)
            if call.module is not None and str(node.target) not in taken
            else node.name
        )
        while name in taken:
            name += "_"
        inputs = [self.source(node) for node in ([call["input"]] if sources is None else sources)]
        self.layers.append({"op": op, "name": name, "inputs": inputs, **parameters})
        return name

    def source(self, node: Any) -> str:
        """The layer whose value a node has; a layer's name stays."""
        if isinstance(node, str):
            return node
        if isinstance(node, torch.Tensor):
            raise NotImplementedError(
                f"a constant of shape {tuple(node.shape)} here has no compiled form"
            )
        if not isinstance(node, fx.Node) or node not in self.names:
            raise NotImplementedError(f"the value {node} is not computed from the volume")
        return self.names[node]

    def shape(self, node: Any) -> tuple[int, ...]:
        """(C, H, W) or (N,)."""
        tensors = {name: values.shape for name, values in self.weights.items()}
        return layer_shapes(self.layers, self._volume, tensors, partial=True)[self.source(node)]

    def needed_for(self, output: fx.Node) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
        """The layers that a node's value is computed from, the last one its own, and their
        weights."""
        needed = {self.source(output)}
        expect_form(needed != {VOLUME}, "the volume itself")
        layers: list[dict[str, Any]] = []
        for layer in reversed(self.layers):
            if layer["name"] in needed:
                needed.update(layer["inputs"])
                layers.insert(0, layer)
        used = {name for layer in layers for name in layer.get("weights", {}).values()}
        return layers, {name: values for name, values in self.weights.items() if name in used}

    def tensors(self, call: Call, **roles: str) -> dict[str, str]:
        """Keep a module's tensors; role -> name, without those that are None."""
        weights = {}
        for role, attribute in roles.items():
            if (tensor := getattr(call.module, attribute)) is not None:
                weights[role] = f"{self.prefix}{call.node.target}.{attribute}"
                self.weights[weights[role]] = float_array(tensor)
        return weights


def float_array(tensor: torch.Tensor) -> np.ndarray:
    """The values as float32; a NotImplementedError for a tensor that is not of floating point."""
    expect_form(tensor.is_floating_point(), f"a weight of type {tensor.dtype}, not floating point,")
    return np.asarray(tensor.detach().cpu().float())
