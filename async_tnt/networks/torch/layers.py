"""The calls of known operations in the trace of a torch module, and the layers they become."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import fx

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.graph import (
    VOLUME,
    ReadNetwork,
    layer_shapes,
    needed_layers,
)


@dataclass(frozen=True)
class Call:
    """A node of the trace that is a known operation, with all of its arguments.

    Parameters
    ----------
    module : the torch module that is called, or None.
    """

    node: fx.Node
    arguments: Mapping[str, Any]
    module: Any

    def __getitem__(self, name: str) -> Any:
        return self.arguments[name]

    @property
    def written(self) -> Any:
        """The node of the tensor that a call in place writes to; None for other calls."""
        target = self.node.target
        name = target if self.node.op == "call_method" else getattr(target, "__name__", "")
        if str(name).endswith("_") or self.arguments.get("inplace"):
            return self.arguments["input"]
        return self.arguments.get("out")


class Grouped(NamedTuple):
    """How the channels of a map are arranged by a view, see `arranging.view`."""

    groups: int
    is_transposed: bool = False


class LayerList:
    """The layers that the calls of a trace have become so far, and the weights of these layers.

    Parameters
    ----------
    shape : shape of a volume, (C, H, W).
    prefix : prefix of the weights' names.

    Attributes
    ----------
    names : node -> the layer that computes the node's value. A view has the layer of the map that
        it views.
    parts : node -> the layers that compute the parts of the node's value, for a value that is a
        tuple. None stands for a part without channels.
    channels_last : nodes whose value has its channels as last axis. Their layers compute the map
        with the channels as first axis.
    grouped : node -> how the node's value divides the channels of a map into groups, for a value
        that is such a view.
    """

    def __init__(self, shape: tuple[int, ...], prefix: str) -> None:
        self._volume = shape
        self.prefix = prefix
        self.layers: list[dict[str, Any]] = []
        self.weights: dict[str, np.ndarray] = {}
        self.names: dict[fx.Node, str] = {}
        self.parts: dict[fx.Node, list[str | None]] = {}
        self.channels_last: set[fx.Node] = set()
        self.grouped: dict[fx.Node, Grouped] = {}

    def add(
        self, op: str, call: Call, sources: Iterable[Any] | None = None, **parameters: Any
    ) -> str:
        """Add a layer that a call becomes; returns its name.

        Parameters
        ----------
        sources : the layer's inputs, nodes or names of layers; by default the call's only input.
        """
        used_names = {VOLUME, *(layer["name"] for layer in self.layers)}
        name = call.node.name
        if call.module is not None and str(call.node.target) not in used_names:
            name = str(call.node.target)
        while name in used_names:
            name += "_"
        nodes = [call["input"]] if sources is None else sources
        inputs = [self.source(node) for node in nodes]
        self.layers.append({"op": op, "name": name, "inputs": inputs, **parameters})
        return name

    def source(self, node: Any) -> str:
        """The name of the layer that computes a node's value.

        If `node` is the name of a layer already, the result is this name.
        """
        if isinstance(node, str):
            return node
        expect_form(node not in self.grouped, "a view of channels in groups")
        expect_form(node not in self.parts, "a stack or tuple of maps here")
        return self.source_of_view(node)

    def source_of_view(self, node: Any) -> str:
        """The name of the layer that computes a node's value, or the map that the value views."""
        if isinstance(node, torch.Tensor):
            raise NotImplementedError(
                f"a constant of shape {tuple(node.shape)} here has no compiled form"
            )
        if not isinstance(node, fx.Node) or node not in self.names:
            raise NotImplementedError(f"the value {node} is not computed from the volume")
        return self.names[node]

    def shape(self, node: Any) -> tuple[int, ...]:
        """The shape of a node's value, (C, H, W) or (N,)."""
        tensors = {name: values.shape for name, values in self.weights.items()}
        source = node if isinstance(node, str) else self.source_of_view(node)
        return layer_shapes(self.layers, self._volume, tensors, outputs=())[source]

    def needed_for(self, outputs: Mapping[str, fx.Node]) -> ReadNetwork:
        """The layers that compute the values of some nodes, see `needed_layers`."""
        for node in outputs.values():
            expect_form(node not in self.channels_last, "a tensor with its channels last")
        layers = {name: self.source(node) for name, node in outputs.items()}
        return needed_layers(self.layers, self.weights, layers)

    def tensors(self, call: Call, **roles: str) -> dict[str, str]:
        """Keep tensors of the called module as weights.

        Parameters
        ----------
        roles : role -> the module's attribute, which may be None.

        Returns
        -------
        Role -> the tensor's name, for the attributes that are not None.
        """
        weights = {}
        for role, attribute in roles.items():
            tensor = getattr(call.module, attribute)
            if tensor is not None:
                name = f"{self.prefix}{call.node.target}.{attribute}"
                weights[role] = name
                self.weights[name] = float_array(tensor)
        return weights

    def constants(self, call: Call, **roles: str) -> dict[str, str]:
        """Keep arguments of a called function as weights. They must be tensors of the module.

        Parameters
        ----------
        roles : role -> the argument's name.

        Returns
        -------
        Role -> the tensor's name, for the arguments that are not None.
        """
        weights = {}
        for role, argument in roles.items():
            tensor = call[argument]
            if tensor is not None:
                expect_form(isinstance(tensor, torch.Tensor), f"a {argument} that is computed")
                # no module's tensor has () in its name
                weights[role] = f"{self.prefix}{call.node.name}().{role}"
                self.weights[weights[role]] = float_array(tensor)
        return weights


def float_array(tensor: torch.Tensor) -> np.ndarray:
    """The values of a floating-point tensor as float32. A tensor of another type is refused."""
    expect_form(tensor.is_floating_point(), f"a weight of type {tensor.dtype}, not floating point,")
    return np.asarray(tensor.detach().cpu().float())
