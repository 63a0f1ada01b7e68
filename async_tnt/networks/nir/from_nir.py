"""Layers of a spiking network from a NIR graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.refusals import Refusals, RefusedError
from async_tnt.networks.nir.graph import Graph, Node, in_order
from async_tnt.networks.spiking.operations import CURRENT_ROLES, FIRING, OUTPUTS, RESETS
from async_tnt.volume.config import TNTConfig

Reset = Literal["subtract", "value"]

PolarityOrder = Literal["off_first", "on_first"]

ORDERS = get_args(PolarityOrder)

LEAKY = ("LIF", "LI", "CubaLIF", "CubaLI")
"""Nodes whose input counts by the time step of the program that trained them."""


class Meaning(NamedTuple):
    """What a graph leaves open."""

    reset: Reset | None
    """How neurons are reset that have fired."""
    dt: float | None
    """The time step, in seconds, of the program that trained the network."""
    polarity: PolarityOrder
    """The order of the input's two channels."""


class SpikingLayers(NamedTuple):
    """The layers of a graph, and the sensor that it reads."""

    layers: list[dict[str, Any]]
    weights: dict[str, np.ndarray]
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
    reader = _Reader(graph, meaning)
    for node in in_order(graph):
        reader.read(node)
    return reader.finished()


def _check_meaning(graph: Graph, meaning: Meaning) -> None:
    """Refuse a meaning that leaves something open, or has an unknown value."""
    kinds = {node.kind for node in graph.nodes.values()}
    if meaning.polarity not in ORDERS:
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


class _Reader:
    """The layers of the nodes that have been read so far."""

    def __init__(self, graph: Graph, meaning: Meaning) -> None:
        self.meaning = meaning
        self.layers: list[dict[str, Any]] = []
        self.weights: dict[str, np.ndarray] = {}
        self._sources: dict[str, list[str]] = {name: [] for name in graph.nodes}
        for source, target in graph.edges:
            self._sources[target].append(source)
        self._value_of: dict[str, str] = {}
        self._sensor: tuple[int, int] | None = None
        self.is_line = False
        """Whether the input is a line of pixels, (channels, W) or (W,), without rows."""
        self._pixels_alone: set[str] = set()
        """Values of a graph whose input is (W,), before its first dense layer.

        In NIR they are vectors. Here they are maps (1, 1, W).
        """
        self.reads_pixels_alone = False
        """Whether the node that is read now reads one of these."""
        self._output: str | None = None
        self._refused = Refusals()

    def read(self, node: Node) -> None:
        """Add the layers of a node."""
        try:
            if node.kind == "Input" and not self._sources[node.name]:
                self._value_of[node.name] = self._input(node)
                return
            value = self._sum_of_sources(node)
            if node.kind in ("Input", "Output"):  # those of a graph inside the graph, too
                self._value_of[node.name] = value
                if node.kind == "Output":
                    self._output = value
                return
            rule = RULES.get(node.kind)
            if rule is None:
                raise RefusedError(node.kind, f"{_title(node)} has no meaning here")
            self.reads_pixels_alone = value in self._pixels_alone
            layer = rule(self, node)
            if self.reads_pixels_alone and layer["op"] == "dense":
                value = self._as_vector(node.name, value)
            elif self.reads_pixels_alone and layer["op"] != "flatten":
                self._pixels_alone.add(node.name)
            self._value_of[node.name] = self.add(node.name, [value], layer)
        except RefusedError as error:
            self._refused.add(error)
            self._value_of[node.name] = VOLUME  # so that later nodes are read, too
        except (NotImplementedError, ValueError) as error:
            if not self._refused:
                raise type(error)(f"{_title(node)}: {error}") from None
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
        are_pixels = self._pixels_alone.issuperset(values)
        if not are_pixels:
            values = [self._as_vector(f"{node.name}.{k}", value) for k, value in enumerate(values)]
        total = self.add(f"{node.name}+", values, {"op": "add"})
        if are_pixels:
            self._pixels_alone.add(total)
        return total

    def _as_vector(self, name: str, value: str) -> str:
        """A value of a graph whose input is (W,) as the vector that it is in NIR."""
        if value not in self._pixels_alone:
            return value
        return self.add(f"{name}.vector", [value], {"op": "flatten"})

    def _input(self, node: Node) -> str:
        """The events, in the order of the input's channels."""
        sides = np.atleast_1d(_array(node, "shape")).tolist()
        # a vector has no polarity: its one channel takes both
        with_channels = [1, *sides] if len(sides) == 1 else sides
        is_of_events = len(with_channels) in (2, 3) and with_channels[0] in (1, 2)
        if not is_of_events or not np.isfinite(sides).all() or self._sensor is not None:
            raise RefusedError(
                "Input",
                f"{_title(node)} must be the only one, with a shape (1 or 2, H, W), (1 or 2, W) or "
                f"(W,): polarity, row and column of an event; got {short(tuple(sides))}",
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
        self._sensor = sensor
        value = self._channels(node, n_channels)
        if len(sides) == 1:
            self._pixels_alone.add(value)
        return value

    def _channels(self, node: Node, n_channels: int) -> str:
        """The events in one channel, or in two in the order that the meaning says."""
        if n_channels == 1:
            ones = np.ones((1, 2, 1, 1), np.float32)
            return self.add(
                node.name, [VOLUME], {**_window(1, 1, 0), **CONV, "tensors": {"weight": ones}}
            )
        if self.meaning.polarity == "on_first":
            return VOLUME
        return self.add(node.name, [VOLUME], {"op": "pick", "channels": [1, 0]})

    def for_each_neuron(self, values: np.ndarray) -> np.ndarray:
        """A parameter of neurons in the shape that layers have: a line is a map of one row."""
        if self.is_line and values.ndim == 2:
            return values[:, np.newaxis, :]
        if self.reads_pixels_alone and values.size > 1:
            return values.reshape(1, 1, -1)
        return values

    def finished(self) -> SpikingLayers:
        """All layers. Those that the output does not need are left out."""
        self._refused.raise_if_any()
        if self._sensor is None or self._output is None:
            raise ValueError("the graph must have an Input and an Output")
        needed = {self._output}
        kept: list[dict[str, Any]] = []
        for layer in reversed(self.layers):
            if layer["name"] in needed:
                needed.update(layer["inputs"])
                kept.insert(0, layer)
        if not kept or kept[-1]["op"] not in OUTPUTS:
            raise NotImplementedError(
                "the graph's last node must be of neurons (IF, LIF, CubaLIF, LI or CubaLI), as "
                "other values are there only while an event passes"
            )
        tensors = {name for layer in kept for name in layer.get("weights", {}).values()}
        weights = {name: values for name, values in self.weights.items() if name in tensors}
        return SpikingLayers(kept, weights, self._sensor)


def _title(node: Node) -> str:
    """A node in a message: its name and its type."""
    kind = node.kind if node.kind.isidentifier() else short(node.kind)
    return f"node {short(node.name)} ({kind})"


# -- fields of nodes -------------------------------------------------------------------------------


def _array(node: Node, name: str) -> np.ndarray:
    """A field as an array of numbers."""
    if name not in node.fields:
        raise ValueError(f"it has no field {name!r}")
    try:
        values = np.asarray(node.fields[name])
    except ValueError:  # lists of different lengths
        raise ValueError(f"{name} must be numbers, got {short(node.fields[name])}") from None
    if values.dtype.kind not in "fiu":
        raise ValueError(f"{name} must be numbers, got {short(node.fields[name])}")
    return values


def _floats(node: Node, name: str) -> np.ndarray:
    """A field as float32."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(_array(node, name), np.float32)


def _whole(node: Node, name: str, n: int = 2) -> list[int]:
    """A field of n whole numbers; one number counts for all."""
    values = _array(node, name)
    is_whole = np.isfinite(values) & (values == np.floor(values))
    if values.size not in (1, n) or not is_whole.all():
        raise ValueError(f"{name} must be {n} whole numbers, got {short(values.tolist())}")
    return [int(value) for value in np.broadcast_to(values.reshape(-1), (n,))]


def _window(kernel: int, stride: int, padding: int) -> dict[str, Any]:
    return {"kernel": [kernel] * 2, "stride": [stride] * 2, "padding": [padding] * 4}


CONV: dict[str, Any] = {"op": "conv", "dilation": [1, 1], "groups": 1}


# -- rules of nodes --------------------------------------------------------------------------------


def _conv_2d(reader: _Reader, node: Node) -> dict[str, Any]:
    _check_axes(reader, 2)
    weight = _floats(node, "weight")
    if weight.ndim != 4:
        raise ValueError(f"weight must be (F, C, ky, kx), got {weight.shape}")
    return _conv(node, weight, _whole(node, "stride"), _whole(node, "dilation"), is_line=False)


def _conv_1d(reader: _Reader, node: Node) -> dict[str, Any]:
    """A convolution along a line: one of a map with one row."""
    _check_axes(reader, 1)
    weight = _floats(node, "weight")
    if weight.ndim != 3:
        raise ValueError(f"weight must be (F, C, kx), got {weight.shape}")
    (stride,) = _whole(node, "stride", 1)
    (dilation,) = _whole(node, "dilation", 1)
    return _conv(node, weight[:, :, np.newaxis, :], [1, stride], [1, dilation], is_line=True)


def _check_axes(reader: _Reader, n_axes: int) -> None:
    """Refuse a node of maps for an input that is a line, and the other way round."""
    if reader.is_line == (n_axes == 1):
        return
    needed = "(1 or 2, W)" if n_axes == 1 else "(1 or 2, H, W)"
    raise ValueError(f"it needs a graph whose input has a shape {needed}")


def _conv(
    node: Node, weight: np.ndarray, stride: list[int], dilation: list[int], is_line: bool
) -> dict[str, Any]:
    """A convolution with weights (F, C, ky, kx). Along a line, its padding has one number."""
    kernel = list(weight.shape[2:])
    tensors = {"weight": weight}
    bias = _floats(node, "bias") if "bias" in node.fields else np.zeros(0, np.float32)
    if bias.any():
        tensors["bias"] = bias  # the check of values refuses it
    return {
        "op": "conv",
        "kernel": kernel,
        "stride": stride,
        "padding": _padding(node, kernel, dilation, is_line),
        "dilation": dilation,
        "groups": _whole(node, "groups", 1)[0],
        "tensors": tensors,
    }


def _padding(node: Node, kernel: list[int], dilation: list[int], is_line: bool) -> list[int]:
    """The padding [top, left, bottom, right], which may be "same" or "valid" in NIR."""
    padding = node.fields.get("padding")
    if isinstance(padding, bytes):  # as files hold texts
        padding = padding.decode("utf-8", "replace")
    if isinstance(padding, str):
        if padding == "valid":
            return [0, 0, 0, 0]
        if padding != "same":
            raise ValueError(f"padding must be numbers, 'same' or 'valid', got {short(padding)}")
        reach = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        top, left = (side // 2 for side in reach)
        return [top, left, reach[0] - top, reach[1] - left]
    if is_line:
        (columns,) = _whole(node, "padding", 1)
        return [0, columns, 0, columns]
    rows, columns = _whole(node, "padding")
    return [rows, columns, rows, columns]


def _pool(op: str) -> Rule:
    def rule(reader: _Reader, node: Node) -> dict[str, Any]:
        _check_axes(reader, 2)
        rows, columns = _whole(node, "padding")
        return {
            "op": op,
            "kernel": _whole(node, "kernel_size"),
            "stride": _whole(node, "stride"),
            "padding": [rows, columns, rows, columns],
        }

    return rule


def _flatten(reader: _Reader, node: Node) -> dict[str, Any]:
    (start,) = _whole(node, "start_dim", 1)
    (end,) = _whole(node, "end_dim", 1)
    last_axis = 0 if reader.reads_pixels_alone else 1 if reader.is_line else 2
    if start != 0 or end not in (-1, last_axis):
        raise NotImplementedError(f"a Flatten from {start} to {end}, not of all axes (0 to -1)")
    return {"op": "flatten"}


def _affine(reader: _Reader, node: Node) -> dict[str, Any]:
    tensors = {"weight": _floats(node, "weight")}
    bias = _floats(node, "bias") if "bias" in node.fields else np.zeros(0, np.float32)
    if bias.any():
        tensors["bias"] = bias  # the check of values refuses it
    return {"op": "dense", "tensors": tensors}


def _scale(reader: _Reader, node: Node) -> dict[str, Any]:
    scale = reader.for_each_neuron(_floats(node, "scale"))
    return {"op": "scale", "tensors": {"scale": scale}}


def _threshold(reader: _Reader, node: Node) -> dict[str, Any]:
    threshold = reader.for_each_neuron(_floats(node, "threshold"))
    return {"op": "threshold", "tensors": {"threshold": threshold}}


def _neurons(op: str, *roles: str) -> Rule:
    def rule(reader: _Reader, node: Node) -> dict[str, Any]:
        tensors = {role: reader.for_each_neuron(_floats(node, role)) for role in roles}
        layer: dict[str, Any] = {"op": op, "tensors": tensors}
        if op in FIRING:
            layer["reset"] = reader.meaning.reset
            reset_to = _floats(node, "v_reset") if "v_reset" in node.fields else np.zeros(0)
            if reset_to.any():  # without it, it is 0
                tensors["v_reset"] = reader.for_each_neuron(reset_to)
        if "v_leak" in roles:
            assert reader.meaning.dt is not None
            layer["dt"] = float(reader.meaning.dt)
        return layer

    return rule


Rule = Callable[[_Reader, Node], dict[str, Any]]
"""Adds a node's layer: its fields without name and inputs, and `tensors`, role -> weights."""

RULES: dict[str, Rule] = {
    "Conv1d": _conv_1d,
    "Conv2d": _conv_2d,
    "SumPool2d": _pool("sum_pool"),
    "AvgPool2d": _pool("average_pool"),
    "Flatten": _flatten,
    "Affine": _affine,
    "Linear": _affine,
    "Scale": _scale,
    "IF": _neurons("if", "r", "v_threshold"),
    "LIF": _neurons("lif", "tau", "r", "v_leak", "v_threshold"),
    "CubaLIF": _neurons("cuba_lif", *CURRENT_ROLES, "v_threshold"),
    "LI": _neurons("li", "tau", "r", "v_leak"),
    "CubaLI": _neurons("cuba_li", *CURRENT_ROLES),
    "Threshold": _threshold,
}
"""Type of a node -> its rule."""
