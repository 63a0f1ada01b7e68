"""From layers to steps of the compiled interpreter: what `kernels.program` describes, before it is
laid out in memory.

Normalizations are folded into the step before them, activations become part of it. A dense layer
that reads a map becomes three steps, a global average pooling two: what each place adds, the sum of
each row, the sum of the rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from async_tnt.kernels.network.functions import FUNCTIONS
from async_tnt.kernels.network.program import FUNCTION, MAXIMUM, MIX, SPREAD, SUM
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.operations import Layer
from async_tnt.networks.layers.uneven_windows import adaptive_shares, inside_shares, place_weights


@dataclass(eq=False)
class Map:
    """Numbers (rows, columns, channels) within a frame of `fill`; a vector has one place."""

    channels: int
    rows: int
    columns: int
    fill: float = 0.0
    frame: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Places above, to the left, below, to the right."""
    writers: list[Step] = field(default_factory=list)
    """Whose places change; none for the volume."""


@dataclass(eq=False)
class Step:
    """A map, or some channels of it, from other maps.

    name : of the layer that it computes or belongs to.
    kind : MIX (one input), SUM (several of one shape are taps of one sum), MAXIMUM, FUNCTION or
        SPREAD (one).
    weights : of a MIX (F, C / groups, kernel_y, kernel_x), with `own_weights` (rows, columns, F,
        C); of a SUM (taps, C), tap by tap of an input, input by input, with `own_weights` (rows,
        columns, taps, C).
    bias, slopes : (F,) or (C,).
    channel : where in the output its channels begin.
    rows, columns : of the output that are computed; all, at first.
    """

    name: str
    kind: int
    inputs: list[Map]
    output: Map
    weights: np.ndarray
    bias: np.ndarray
    kernel: tuple[int, int] = (1, 1)
    stride: tuple[int, int] = (1, 1)
    padding: tuple[int, int] = (0, 0)
    dilation: tuple[int, int] = (1, 1)
    groups: int = 1
    own_weights: bool = False
    applied: int = 0
    """Of a FUNCTION, its place in `FUNCTIONS`."""
    block: int = 1
    """Of a SPREAD, the side of what one place of its input becomes."""
    channel: int = 0
    rows: int = field(init=False)
    columns: int = field(init=False)
    slopes: np.ndarray = field(init=False)
    low: float = -np.inf
    high: float = np.inf

    def __post_init__(self) -> None:
        self.output.writers.append(self)
        self.rows, self.columns = self.output.rows, self.output.columns
        self.slopes = np.ones(len(self.bias), np.float32)

    @property
    def is_activated(self) -> bool:
        """Whether the result is scaled where it is negative, or limited."""
        return bool((self.slopes != 1).any()) or self.low != -np.inf or self.high != np.inf

    @property
    def reads(self) -> tuple[int, int]:
        """How many rows and columns of its inputs it reads, from their first ones on: frame after
        them included."""
        rows, columns = (
            (-(-out // self.block) - 1) * self.stride[k]
            + (self.kernel[k] - 1) * self.dilation[k]
            - self.padding[k]
            + 1
            for k, out in enumerate((self.rows, self.columns))
        )
        return rows, columns


def steps_of(
    layers: Sequence[Layer], volume: Map, tensors: Mapping[str, np.ndarray]
) -> tuple[list[Step], Map]:
    """The steps of a network whose layers have been checked, in order, and the map of its output.

    The last layer may be a `heatmap_centroid`, which is no step: then the output is its heatmap.
    """
    return _Lowering(layers, volume, tensors).run()


class _Lowering:
    def __init__(
        self, layers: Sequence[Layer], volume: Map, tensors: Mapping[str, np.ndarray]
    ) -> None:
        self._layers, self._volume, self._tensors = layers, volume, tensors
        shape = volume.channels, volume.rows, volume.columns
        self._shapes: Mapping[str, Any] = layer_shapes(
            layers, shape, {name: w.shape for name, w in tensors.items()}
        )
        self._readers = self._count_readers()
        self._steps: list[Step] = []
        self._name = ""  # of the layer that is next
        self._maps: dict[str, Map] = {}

    def _count_readers(self) -> Counter[str]:
        """How many layers read what a layer computes, through a flatten, too; the output is read
        once."""
        origins: dict[str, str] = {}
        readers: Counter[str] = Counter()
        for layer in self._layers:
            read = [origins.get(name, name) for name in layer["inputs"]]
            if layer["op"] == "flatten":
                origins[layer["name"]] = read[0]
            else:
                readers.update(read)
        output: str = self._layers[-1]["name"]
        readers[origins.get(output, output)] += 1
        readers.update({name: readers[origin] - readers[name] for name, origin in origins.items()})
        return readers

    def run(self) -> tuple[list[Step], Map]:
        self._maps[VOLUME] = volume = self._volume
        for layer in self._layers:
            inputs = [self._maps[name] for name in layer["inputs"]]
            self._name = layer["name"]
            if layer["op"] in FUNCTIONS:
                self._maps[layer["name"]] = self._function(layer["op"], inputs)
            else:
                self._maps[layer["name"]] = getattr(self, f"_{layer['op']}")(layer, inputs)
        output = self._maps[self._layers[-1]["name"]]
        return self._steps, self._copy(
            volume, replace(volume, writers=[])
        ) if output is volume else output

    def _tensor(self, layer: Layer, role: str, default: float, n: int) -> np.ndarray:
        name = layer["weights"].get(role)
        return np.full(n, default, np.float32) if name is None else self._tensors[name]

    def _add_step(
        self, kind: int, inputs: list[Map], output: Map, weights: Any, bias: Any, **options: Any
    ) -> Map:
        weights, bias = np.asarray(weights, np.float32), np.asarray(bias, np.float32)
        self._steps.append(Step(self._name, kind, inputs, output, weights, bias, **options))
        return output

    def _copy(self, source: Map, output: Map, channel: int = 0) -> Map:
        ones = np.ones((1, source.channels))
        return self._add_step(
            SUM, [source], output, ones, np.zeros(source.channels), channel=channel
        )

    def _own_step(self, layer: Layer, inputs: list[Map], *, linear: bool = False) -> Step:
        """The step to fold a layer into: the one before it if nothing else reads that, otherwise a
        copy."""
        (source,) = inputs
        if len(source.writers) == 1 and self._readers[layer["inputs"][0]] == 1:
            step = source.writers[0]
            if (
                not step.is_activated
                and step.kind != SPREAD
                and (step.kind in (MIX, SUM) or not linear)
            ):
                return step
        return self._copy(source, replace(source, fill=0.0, writers=[])).writers[0]

    def _conv(self, layer: Layer, inputs: list[Map]) -> Map:
        (source,) = inputs
        w = self._tensors[layer["weights"]["weight"]]
        n_filters, per_group = w.shape[:2]
        bias = self._tensor(layer, "bias", 0.0, n_filters)
        options = _window(layer) | {"dilation": tuple(layer["dilation"])}
        output = Map(*self._shapes[layer["name"]])
        if layer["groups"] == n_filters == source.channels:
            return self._add_step(SUM, inputs, output, w.reshape(n_filters, -1).T, bias, **options)
        return self._add_step(
            MIX, inputs, output, w, bias, groups=source.channels // per_group, **options
        )

    def _dense(self, layer: Layer, inputs: list[Map]) -> Map:
        (source,) = inputs
        w = self._tensors[layer["weights"]["weight"]]
        n_units = len(w)
        bias = self._tensor(layer, "bias", 0.0, n_units)
        w = w.reshape(n_units, source.channels, source.rows, source.columns)
        if source.rows * source.columns == 1:
            return self._add_step(MIX, inputs, Map(n_units, 1, 1), w, bias)
        parts = Map(n_units, source.rows, source.columns)
        self._add_step(
            MIX, inputs, parts, w.transpose(2, 3, 0, 1), np.zeros(n_units), own_weights=True
        )
        return self._sum_of_places(parts, 1.0, bias)

    def _sum_of_places(self, source: Map, factor: float, bias: np.ndarray) -> Map:
        """Row by row, then of the rows: after a change, one row is summed again."""
        channels, sides = source.channels, (source.rows, source.columns)
        if 1 not in sides:
            row_sums = Map(channels, source.rows, 1)
            ones = np.ones((source.columns, channels))
            source = self._add_step(
                SUM, [source], row_sums, ones, np.zeros(channels), kernel=(1, source.columns)
            )
        kernel = source.rows, source.columns
        weights = np.full((source.rows * source.columns, channels), factor)
        return self._add_step(SUM, [source], Map(channels, 1, 1), weights, bias, kernel=kernel)

    def _batch_norm(self, layer: Layer, inputs: list[Map]) -> Map:
        n = len(self._tensors[layer["weights"]["mean"]])
        mean, variance, weight, bias = (
            self._tensor(layer, role, default, n).astype(np.float64)
            for role, default in (("mean", 0.0), ("variance", 1.0), ("weight", 1.0), ("bias", 0.0))
        )
        factor = weight / np.sqrt(variance + layer["epsilon"])
        step = self._own_step(layer, inputs, linear=True)
        along = factor if step.kind == SUM else factor[:, None, None, None]
        step.weights = (step.weights * along).astype(np.float32)
        step.bias = ((step.bias - mean) * factor + bias).astype(np.float32)
        return step.output

    def _relu(self, layer: Layer, inputs: list[Map]) -> Map:
        step = self._own_step(layer, inputs)
        step.low = 0.0
        return step.output

    def _clip(self, layer: Layer, inputs: list[Map]) -> Map:
        step = self._own_step(layer, inputs)
        step.low = -np.inf if layer["low"] is None else layer["low"]
        step.high = np.inf if layer["high"] is None else layer["high"]
        return step.output

    def _leaky_relu(self, layer: Layer, inputs: list[Map]) -> Map:
        step = self._own_step(layer, inputs)
        step.slopes[:] = layer["slope"]
        return step.output

    def _prelu(self, layer: Layer, inputs: list[Map]) -> Map:
        step = self._own_step(layer, inputs)
        step.slopes[:] = self._tensors[layer["weights"]["slope"]]
        return step.output

    def _function(self, name: str, inputs: list[Map]) -> Map:
        (source,) = inputs
        output = replace(source, fill=0.0, frame=(0, 0, 0, 0), writers=[])
        applied = list(FUNCTIONS).index(name)
        return self._add_step(
            FUNCTION, inputs, output, [], np.zeros(source.channels), applied=applied
        )

    def _hardsigmoid(self, layer: Layer, inputs: list[Map]) -> Map:
        """clip(x / 6 + 1/2, 0, 1)"""
        step = self._own_step(layer, inputs, linear=True)
        step.weights, step.bias = (
            step.weights / np.float32(6),
            step.bias / np.float32(6) + np.float32(0.5),
        )
        step.low, step.high = 0.0, 1.0
        return step.output

    def _max_pool(self, layer: Layer, inputs: list[Map]) -> Map:
        (source,) = inputs
        if any(layer["padding"]):  # with what is less than any number
            framed = replace(source, fill=-np.inf, frame=(0, 0, 0, 0), writers=[])
            source = self._copy(source, framed)
        output = Map(*self._shapes[layer["name"]])
        return self._add_step(
            MAXIMUM, [source], output, [], np.zeros(source.channels), **_window(layer)
        )

    def _average_pool(self, layer: Layer, inputs: list[Map]) -> Map:
        return self._pool(layer, inputs, 1.0 / (layer["kernel"][0] * layer["kernel"][1]))

    def _sum_pool(self, layer: Layer, inputs: list[Map]) -> Map:
        return self._pool(layer, inputs, 1.0)

    def _pool(self, layer: Layer, inputs: list[Map], factor: float) -> Map:
        (source,) = inputs
        if tuple(layer["kernel"]) == (source.rows, source.columns) and not any(layer["padding"]):
            return self._sum_of_places(source, factor, np.zeros(source.channels))
        weights = np.full((layer["kernel"][0] * layer["kernel"][1], source.channels), factor)
        output = Map(*self._shapes[layer["name"]])
        return self._add_step(
            SUM, inputs, output, weights, np.zeros(source.channels), **_window(layer)
        )

    def _inside_average_pool(self, layer: Layer, inputs: list[Map]) -> Map:
        output, window = Map(*self._shapes[layer["name"]]), _window(layer)
        sides = (output.rows, output.columns), (inputs[0].rows, inputs[0].columns)
        axes = map(inside_shares, *sides, window["kernel"], window["stride"], window["padding"])
        return self._uneven_pool(inputs, output, *axes, **window)

    def _adaptive_average_pool(self, layer: Layer, inputs: list[Map]) -> Map:
        output = Map(*self._shapes[layer["name"]])
        rows, stride_y, above = adaptive_shares(output.rows, inputs[0].rows)
        columns, stride_x, before = adaptive_shares(output.columns, inputs[0].columns)
        window = {"kernel": (rows.shape[1], columns.shape[1]), "stride": (stride_y, stride_x)}
        return self._uneven_pool(inputs, output, rows, columns, padding=(above, before), **window)

    def _uneven_pool(
        self, inputs: list[Map], output: Map, rows: Any, columns: Any, **window: Any
    ) -> Map:
        weights, zeros = place_weights(rows, columns, output.channels), np.zeros(output.channels)
        return self._add_step(SUM, inputs, output, weights, zeros, own_weights=True, **window)

    def _global_average_pool(self, layer: Layer, inputs: list[Map]) -> Map:
        (source,) = inputs
        return self._sum_of_places(
            source, 1.0 / (source.rows * source.columns), np.zeros(source.channels)
        )

    def _depth_to_space(self, layer: Layer, inputs: list[Map]) -> Map:
        (source,) = inputs
        if len(source.writers) > 1:
            source = self._copy(source, replace(source, fill=0.0, frame=(0, 0, 0, 0), writers=[]))
        output = Map(*self._shapes[layer["name"]])
        return self._add_step(
            SPREAD, [source], output, [], np.zeros(output.channels), block=layer["block"]
        )

    def _add(self, layer: Layer, inputs: list[Map]) -> Map:
        first = inputs[0]
        output = Map(first.channels, first.rows, first.columns)
        weights = np.ones((len(inputs), first.channels))
        return self._add_step(SUM, inputs, output, weights, np.zeros(first.channels))

    def _concat(self, layer: Layer, inputs: list[Map]) -> Map:
        output = Map(sum(source.channels for source in inputs), inputs[0].rows, inputs[0].columns)
        channel = 0
        for source in inputs:
            self._copy(source, output, channel)
            channel += source.channels
        return output

    def _flatten(self, layer: Layer, inputs: list[Map]) -> Map:
        return inputs[0]  # dense layers know their input as a map

    _heatmap_centroid = _flatten  # no step: see `steps_of`


def _window(layer: Layer) -> dict[str, Any]:
    return {
        "kernel": tuple(layer["kernel"]),
        "stride": tuple(layer["stride"]),
        "padding": tuple(layer["padding"][:2]),
    }
