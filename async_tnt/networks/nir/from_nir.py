"""Layers of a spiking network from a NIR graph."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.refusals import RefusedError
from async_tnt.networks.nir.graph import Graph, Node
from async_tnt.networks.nir.nodes import (
    LINEAR_RULES,
    Rule,
    Source,
    array_of,
    floats_of,
    title_of,
)
from async_tnt.networks.nir.reader import GraphReader, Layers, Weights
from async_tnt.networks.spiking.operations import CURRENT_ROLES, FIRING, OUTPUTS, RESETS
from async_tnt.volume.config import TNTConfig

Reset = Literal["subtract", "value"]

PolarityOrder = Literal["off_first", "on_first"]

ORDERS = get_args(PolarityOrder)

OFF_FIRST: PolarityOrder = "off_first"
"""The order of published graphs of N-MNIST, and of the library tonic."""

LEAKY = ("LIF", "LI", "CubaLIF", "CubaLI")
"""Nodes whose input is multiplied by the time step of the program that trained them."""


class Meaning(NamedTuple):
    """What a graph leaves open."""

    reset: Reset | None
    """How neurons are reset that have fired."""
    dt: float | None
    """The time step, in seconds, of the program that trained the network."""
    polarity: PolarityOrder | None
    """The order of the input's two channels. None is `OFF_FIRST`."""


class SpikingLayers(NamedTuple):
    """The layers of a graph, and the sensor that it reads."""

    layers: Layers
    weights: Weights
    sensor: tuple[int, int]
    """(width, height)."""


def layers_from_nir(graph: Graph, meaning: Meaning) -> SpikingLayers:
    """The layers of a graph.

    Raises
    ------
    ParameterValueError, ParameterTypeError : the graph leaves something open that `meaning` does
        not say, or the value is none of those that are known.
    NotImplementedError : nodes have no meaning at an event. The message names them.
    ValueError : the graph does not fit together.
    """
    _check_meaning(graph, meaning)
    reader = _SpikingReader(graph, meaning)
    layers, weights = reader.read()
    assert reader.sensor is not None  # the output reads it
    if not layers or layers[-1]["op"] not in OUTPUTS:
        raise NotImplementedError(
            "the graph's last node must be of neurons (IF, LIF, CubaLIF, LI or CubaLI), as other "
            "values are there only while an event passes"
        )
    if layers[-1]["name"] in reader.pixels_alone:
        _make_vector(layers, weights, reader.sensor[0])
    return SpikingLayers(layers, weights, reader.sensor)


def _check_meaning(graph: Graph, meaning: Meaning) -> None:
    """Refuse a meaning that leaves something open, or has an unknown value."""
    kinds = {node.kind for node in graph.nodes.values()}
    if meaning.polarity is not None and meaning.polarity not in ORDERS:
        raise ParameterValueError(
            "polarity", f"must be {' or '.join(ORDERS)}", short(meaning.polarity)
        )
    if meaning.reset is None and kinds & {"IF", "LIF", "CubaLIF"}:
        rule = (
            f"must be {' or '.join(RESETS)}: NIR leaves open how a neuron is reset. sinabs, and "
            "snnTorch by default, subtract the threshold; Norse resets to v_reset"
        )
        raise ParameterTypeError("reset", rule)
    if meaning.reset is not None and meaning.reset not in RESETS:
        raise ParameterValueError("reset", f"must be {' or '.join(RESETS)}", short(meaning.reset))
    if meaning.dt is None and kinds & set(LEAKY):
        rule = (
            "is missing: a leaky neuron's input counts r dt / tau, where dt is the time step, in "
            "seconds, of the program that trained the network"
        )
        raise ParameterTypeError("dt", rule)
    if meaning.dt is not None:
        is_number = isinstance(meaning.dt, (int, float)) and not isinstance(meaning.dt, bool)
        if not is_number or not 0 < meaning.dt < np.inf:
            raise ParameterValueError("dt", "must be a positive number", short(meaning.dt))


class _SpikingReader(GraphReader):
    """The layers of a spiking network's nodes.

    Attributes
    ----------
    sensor : (width, height), when the input has been read.
    """

    def __init__(self, graph: Graph, meaning: Meaning) -> None:
        super().__init__(graph, _rules(meaning))
        self._polarity = meaning.polarity or OFF_FIRST
        self.sensor: tuple[int, int] | None = None

    def input(self, node: Node) -> str:
        """The events, in the order of the input's channels."""
        sides = np.atleast_1d(array_of(node, "shape")).tolist()
        # a vector has no polarity: its one channel takes both
        with_channels = [1, *sides] if len(sides) == 1 else sides
        is_of_events = len(with_channels) in (2, 3) and with_channels[0] in (1, 2)
        if not is_of_events or not np.isfinite(sides).all() or self.sensor is not None:
            raise RefusedError(
                "Input",
                f"{title_of(node)} must be the only one, with a shape (1 or 2, H, W), (1 or 2, W) "
                f"or (W,): polarity, row and column of an event; got {short(tuple(sides))}",
            )
        if any(side != np.floor(side) for side in sides):
            raise ValueError(f"its shape must be whole numbers, got {short(tuple(sides))}")
        self.is_line = len(sides) < 3
        n_channels, *rows, width = (int(side) for side in with_channels)
        sensor = width, rows[0] if rows else 1
        try:
            TNTConfig(sensor=sensor, grid=sensor, representation="count")
        except ParameterValueError as error:  # it is about the file, not about a parameter
            raise ValueError(f"its shape {short(tuple(sides))}: {error}") from None
        self.sensor = sensor
        value = self._channels(node, n_channels)
        if len(sides) == 1:
            self.pixels_alone.add(value)
        return value

    def _channels(self, node: Node, n_channels: int) -> str:
        """The events in one channel, or in two in the order that the meaning says."""
        if n_channels == 1:
            return self.add(node.name, [VOLUME], _sum_of_polarities())
        if self._polarity == "on_first":
            return VOLUME
        return self.add(node.name, [VOLUME], {"op": "pick", "channels": [1, 0]})


def _sum_of_polarities() -> dict[str, Any]:
    """The convolution of one pixel that adds the two channels of a volume."""
    return {
        "op": "conv",
        "kernel": [1, 1],
        "stride": [1, 1],
        "padding": [0, 0, 0, 0],
        "dilation": [1, 1],
        "groups": 1,
        "tensors": {"weight": np.ones((1, 2, 1, 1), np.float32)},
    }


def _make_vector(layers: Layers, weights: Weights, width: int) -> None:
    """Make the last neurons, a map (1, 1, width), the vector (width,) that they are in NIR.

    A flattened map cannot be an output. A dense layer of the identity makes it a vector: it adds
    zeros to each number, which leaves it as it is.
    """
    last = layers[-1]
    name = last["name"]
    identity = f"{name}.identity.weight"
    weights[identity] = np.eye(width, dtype=np.float32)
    layers[-1:] = [
        {"op": "flatten", "name": f"{name}.vector", "inputs": last["inputs"]},
        {
            "op": "dense",
            "name": f"{name}.identity",
            "inputs": [f"{name}.vector"],
            "weights": {"weight": identity},
        },
        {**last, "inputs": [f"{name}.identity"]},
    ]
    for tensor in last["weights"].values():
        values = weights[tensor].reshape(-1)
        weights[tensor] = np.repeat(values, width) if values.size == 1 else values


# -- rules of nodes --------------------------------------------------------------------------------


def _rules(meaning: Meaning) -> dict[str, Rule]:
    """Type of a node -> its rule."""
    return {
        **LINEAR_RULES,
        "Scale": _scale,
        "IF": _neurons(meaning, "if", "r", "v_threshold"),
        "LIF": _neurons(meaning, "lif", "tau", "r", "v_leak", "v_threshold"),
        "CubaLIF": _neurons(meaning, "cuba_lif", *CURRENT_ROLES, "v_threshold"),
        "LI": _neurons(meaning, "li", "tau", "r", "v_leak"),
        "CubaLI": _neurons(meaning, "cuba_li", *CURRENT_ROLES),
        "Threshold": _threshold,
    }


def _for_each_neuron(source: Source, values: np.ndarray) -> np.ndarray:
    """A parameter of neurons in the shape that layers have: a line is a map of one row."""
    if source.is_line and values.ndim == 2:
        return values[:, np.newaxis, :]
    if source.is_pixels_alone and values.size > 1:
        return values.reshape(1, 1, -1)
    return values


def _scale(source: Source, node: Node) -> dict[str, Any]:
    scale = _for_each_neuron(source, floats_of(node, "scale"))
    return {"op": "scale", "tensors": {"scale": scale}}


def _threshold(source: Source, node: Node) -> dict[str, Any]:
    threshold = _for_each_neuron(source, floats_of(node, "threshold"))
    return {"op": "threshold", "tensors": {"threshold": threshold}}


def _neurons(meaning: Meaning, op: str, *roles: str) -> Rule:
    def rule(source: Source, node: Node) -> dict[str, Any]:
        tensors = {role: _for_each_neuron(source, floats_of(node, role)) for role in roles}
        layer: dict[str, Any] = {"op": op, "tensors": tensors}
        if op in FIRING:
            layer["reset"] = meaning.reset
            reset_to = floats_of(node, "v_reset") if "v_reset" in node.fields else np.zeros(0)
            if reset_to.any():  # without it, it is 0
                tensors["v_reset"] = _for_each_neuron(source, reset_to)
        if "v_leak" in roles:
            assert meaning.dt is not None
            layer["dt"] = float(meaning.dt)
        return layer

    return rule
