"""A spiking network as flat arrays that compiled code reads.

Each layer becomes a stage, see `kernels.spiking.layout`, with two exceptions. A flatten is the
stage before it, read in another order. A linear layer that only neurons read becomes a link of
their stage.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.vectors import BLOCK
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.spiking.operations import (
    INTEGRATORS,
    LINEAR,
    NEURONS,
    SCALE,
    SPIKING_OPERATIONS,
    SUBTRACT,
)

US_PER_S = 1e6

KINDS = {
    "if": L.INTEGRATE,
    "lif": L.LEAKY,
    "li": L.LEAKY,
    "cuba_lif": L.CURRENT_BASED,
    "cuba_li": L.CURRENT_BASED,
    "threshold": L.STATELESS,
}
"""Operation of neurons -> its kind in kernels."""

IS_NEURON = {operation.name for operation in NEURONS}

IS_LINEAR = {*LINEAR, SCALE.name}


class SpikingProgram(NamedTuple):
    """The arrays of a spiking network, and where its numbers lie in a window's state."""

    program: np.ndarray
    """int64, see `kernels.spiking.layout`."""
    weights: np.ndarray
    """float32: of convolutions and dense layers."""
    params: np.ndarray
    """float64: of neurons and poolings."""
    empty: np.ndarray
    """float64: the state of a window without events."""
    counted: np.ndarray
    """int64: where in a state numbers of the window alone lie, such as counts of spikes."""
    stages: dict[str, StageMemory]
    """Layer of neurons, or the output's layer -> where its numbers lie."""


class StageMemory(NamedTuple):
    """Where the numbers of a stage lie in a state. Offsets are -1 for what it does not have."""

    shape: Shape
    """The layer's output: (C, H, W), or (N,)."""
    map_shape: Shape
    """The same as a map (C, H, W). Its numbers lie in the order [row, column, channel], with
    `width_of(C)` numbers for each place."""
    membranes: int
    n_spikes: int
    n_added: int
    counts: int
    first_us: int
    stage: int
    """Where the stage's record begins in the program."""


@dataclass
class _Stage:
    """A stage of a program that is being made."""

    map_shape: Shape
    links: list[_Link] = field(default_factory=list)
    neurons: int = L.NONE
    reset: int = L.SUBTRACT
    fires: bool = False
    params: np.ndarray = field(default_factory=lambda: np.empty((L.N_PARAMS, 0)))
    """(N_PARAMS, numbers of one parameter)."""


@dataclass
class _Link:
    """A link of a program that is being made."""

    source: int
    kind: int
    fields: dict[int, int] = field(default_factory=dict)
    weights: np.ndarray | None = None
    factor: float = 1.0
    """The weight of a pooling."""


def make_spiking_program(
    layers: Sequence[Layer], volume: Shape, tensors: Mapping[str, np.ndarray]
) -> SpikingProgram:
    """The program of a spiking network's layers, which have been checked.

    Parameters
    ----------
    volume : (2, H, W), the events.
    tensors : name -> float32 weights.
    """
    maker = _Maker(layers, volume, tensors)
    for layer in layers:
        maker.add(layer)
    return maker.finished()


class _Maker:
    """Makes stages of layers."""

    def __init__(
        self, layers: Sequence[Layer], volume: Shape, tensors: Mapping[str, np.ndarray]
    ) -> None:
        shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
        self._shapes = layer_shapes(layers, volume, shapes, operations=SPIKING_OPERATIONS)
        self._layers = {layer["name"]: layer for layer in layers}
        self._n_readers = Counter(name for layer in layers for name in layer["inputs"])
        self._output = layers[-1]["name"]
        self._tensors = tensors
        self._stages = [_Stage(volume)]
        self._stage_of = {VOLUME: 0}
        self._channels = [0, 1]

    def add(self, layer: Layer) -> None:
        """Add the stage of a layer, unless it becomes a link."""
        name = layer["name"]
        op = layer["op"]
        if op == "pick":
            self._channels = list(layer["channels"])
            self._stage_of[name] = 0
        elif op == "flatten":
            self._stage_of[name] = self._stage_of[layer["inputs"][0]]
        elif op in IS_NEURON:
            self._add_neurons(layer)
        elif not self._becomes_link(layer):
            shape = _as_map(self._shapes[name])
            self._add_stage(name, _Stage(shape, self._links_of(layer)))

    def _becomes_link(self, layer: Layer) -> bool:
        """Whether only neurons read a linear layer."""
        name = layer["name"]
        if layer["op"] not in IS_LINEAR or self._n_readers[name] != 1 or name == self._output:
            return False
        readers = [other for other in self._layers.values() if name in other["inputs"]]
        return readers[0]["op"] in IS_NEURON

    def _add_stage(self, name: str, stage: _Stage) -> None:
        self._stage_of[name] = len(self._stages)
        self._stages.append(stage)

    def _add_neurons(self, layer: Layer) -> None:
        (read,) = layer["inputs"]
        if read in self._stage_of:
            source = self._stage_of[read]
            stage = _Stage(self._stages[source].map_shape, [_Link(source, L.COPIED)])
        else:
            stage = _Stage(_as_map(self._shapes[read]), self._links_of(self._layers[read]))
        stage.neurons = KINDS[layer["op"]]
        stage.reset = L.SUBTRACT if layer.get("reset") == SUBTRACT else L.TO_VALUE
        stage.fires = layer["op"] not in INTEGRATORS
        stage.params = self._params_of(layer, stage.map_shape)
        self._add_stage(layer["name"], stage)

    def _params_of(self, layer: Layer, map_shape: Shape) -> np.ndarray:
        """The parameters of neurons, (N_PARAMS, numbers of one), by place and channel.

        Where all places have the same parameters, there is one number for each channel.
        """
        n_channels = map_shape[0]
        rows = np.zeros((L.N_PARAMS, n_channels, *map_shape[1:]))
        values = {
            role: _spread_over(self._tensors[name], map_shape)
            for role, name in layer["weights"].items()
        }
        rows[L.GAIN] = values.get("r", 1.0)
        rows[L.THRESHOLD] = values.get("v_threshold", values.get("threshold", np.inf))
        rows[L.RESET_TO] = values.get("v_reset", 0.0)
        if "tau" in values:
            rows[L.GAIN] = values["r"] * layer["dt"] / values["tau"]
            rows[L.LEAK] = values["v_leak"]
            rows[L.RATE] = 1.0 / (values["tau"] * US_PER_S)
        if "tau_syn" in values:
            rows[L.GAIN] = values["w_in"] * layer["dt"] / values["tau_syn"]
            rows[L.LEAK] = values["v_leak"]
            rows[L.RATE] = 1.0 / (values["tau_mem"] * US_PER_S)
            rows[L.CURRENT_RATE] = 1.0 / (values["tau_syn"] * US_PER_S)
            rows[L.RESISTANCE] = values["r"]
        first_place = rows[:, :, :1, :1]
        if (rows == first_place).all():
            rows = first_place
        filled = _filled(rows.transpose(0, 2, 3, 1))
        # what fills a block up never fires
        filled[L.THRESHOLD, ..., n_channels:] = np.inf
        return filled.reshape(L.N_PARAMS, -1)

    def _links_of(self, layer: Layer) -> list[_Link]:
        """The links of a linear layer, in the order of its inputs."""
        if layer["op"] == "add":
            return [_Link(self._stage_of[name], L.COPIED) for name in layer["inputs"]]
        source = self._stage_of[layer["inputs"][0]]
        source_shape = self._stages[source].map_shape
        if layer["op"] == SCALE.name:
            scale = _spread_over(self._tensor(layer, "scale"), source_shape)
            return [_Link(source, L.SCALED, weights=_filled(scale.transpose(1, 2, 0)))]
        if layer["op"] == "dense":
            weight = self._tensor(layer, "weight")
            # [row, column, channel, output], each channel of the blocks' filling included
            by_input = weight.reshape(len(weight), *source_shape).transpose(2, 3, 1, 0)
            n_filling = width_of(source_shape[0]) - source_shape[0]
            by_input = np.pad(by_input, ((0, 0), (0, 0), (0, n_filling), (0, 0)))
            return [_Link(source, L.DENSE, weights=_filled(by_input))]
        fields = {
            L.KERNEL_Y: layer["kernel"][0],
            L.KERNEL_X: layer["kernel"][1],
            L.STRIDE_Y: layer["stride"][0],
            L.STRIDE_X: layer["stride"][1],
            L.PADDING_Y: layer["padding"][0],
            L.PADDING_X: layer["padding"][1],
        }
        if layer["op"] != "conv":
            is_mean = layer["op"] == "average_pool"
            factor = 1.0 / math.prod(layer["kernel"]) if is_mean else 1.0
            return [_Link(source, L.POOLING, fields, factor=factor)]
        fields[L.DILATION_Y] = layer["dilation"][0]
        fields[L.DILATION_X] = layer["dilation"][1]
        fields[L.GROUPS] = layer["groups"]
        weight = self._tensor(layer, "weight")
        grouped = weight.reshape(layer["groups"], -1, *weight.shape[1:])
        # [group, filter, channel, ky, kx] -> [group, channel, ky, kx, filter]
        by_channel = grouped.transpose(0, 2, 3, 4, 1)
        if layer["groups"] == 1:
            by_channel = _filled(by_channel)
        return [_Link(source, L.CONVOLUTION, fields, weights=by_channel)]

    def _tensor(self, layer: Layer, role: str) -> np.ndarray:
        return self._tensors[layer["weights"][role]]

    def finished(self) -> SpikingProgram:
        """The program of all stages."""
        arrays = _Arrays(self._stages)
        arrays.program[L.CHANNEL_OF_ON] = self._channels.index(0)
        arrays.program[L.CHANNEL_OF_OFF] = self._channels.index(1)
        output = self._stage_of[self._output]
        arrays.lay_out(output)
        stages = {}
        for name, number in self._stage_of.items():
            if name != VOLUME and self._layers[name]["op"] != "pick":
                stages[name] = arrays.memory_of(number, self._shapes[name])
        return SpikingProgram(
            arrays.program,
            arrays.weights,
            arrays.params,
            arrays.empty_state(),
            np.array(arrays.counted, np.int64),
            stages,
        )


class _Arrays:
    """The arrays of a program, and the layout of a state."""

    def __init__(self, stages: list[_Stage]) -> None:
        self._stages = stages
        n_links = sum(len(stage.links) for stage in stages)
        links = L.FIRST_STAGE + len(stages) * L.STAGE_SIZE
        self.program = np.zeros(links + n_links * L.LINK_SIZE, np.int64)
        self.program[L.N_STAGES] = len(stages)
        self._next_link = links
        self._n_state = 0
        self._weights: list[np.ndarray] = []
        self._params: list[np.ndarray] = []
        self._at_rest: list[tuple[int, np.ndarray]] = []
        self.counted: list[int] = []
        """Where numbers of the window alone lie in the state."""

    @property
    def weights(self) -> np.ndarray:
        """float32."""
        return np.concatenate([np.zeros(0, np.float32), *self._weights]).astype(np.float32)

    @property
    def params(self) -> np.ndarray:
        """float64."""
        return np.concatenate([np.zeros(0), *self._params])

    def lay_out(self, output: int) -> None:
        """Write the records of all stages. `output` is the number of the output's stage."""
        for number, stage in enumerate(self._stages):
            self._lay_out_stage(number, stage, number == output)

    def _lay_out_stage(self, number: int, stage: _Stage, is_output: bool) -> None:
        channels, rows, columns = stage.map_shape
        width = width_of(channels)
        n = width * rows * columns
        record = self._record(number)
        record[L.LINKS] = self._next_link
        record[L.N_LINKS] = len(stage.links)
        record[[L.CHANNELS, L.ROWS, L.COLUMNS, L.WIDTH]] = channels, rows, columns, width
        record[L.NEURONS] = stage.neurons
        record[L.RESET] = stage.reset
        record[L.FIRES] = stage.fires
        n_listed = channels * rows * columns if number else 1
        record[L.SUMS] = self._room(n if number else 0)
        record[L.LIST] = self._room(n_listed)
        record[L.VALUES] = self._room(n_listed)
        record[L.N_ACTIVE] = self._room(1)
        record[L.BOX] = self._room(4)
        record[L.N_SPIKES] = self._room(1)
        record[L.N_ADDED] = self._room(1)
        self.counted += [int(record[L.N_SPIKES]), int(record[L.N_ADDED])]
        record[[L.MEMBRANES, L.CURRENTS, L.TIMES, L.COUNTS, L.FIRST_US]] = -1
        record[[L.WATCHED, L.N_WATCHED, L.IS_WATCHED]] = -1
        if stage.neurons == L.CURRENT_BASED:
            for slot in (L.CURRENTS, L.WATCHED, L.IS_WATCHED):
                record[slot] = self._room(n)
            record[L.N_WATCHED] = self._room(1)
        if stage.neurons != L.NONE:
            record[L.MEMBRANES] = self._room(n)
            record[L.TIMES] = self._room(rows * columns)
            record[L.PARAMS] = sum(map(len, self._params))
            record[L.PARAMS_SIZE] = stage.params.shape[1]
            self._params.append(stage.params.reshape(-1))
            # the rest of all neurons, or of one place's
            rest = np.resize(stage.params[L.LEAK], n)
            self._at_rest.append((int(record[L.MEMBRANES]), rest))
        if is_output:
            record[L.COUNTS] = self._room(n)
            record[L.FIRST_US] = self._room(n)
            self._at_rest.append((int(record[L.FIRST_US]), np.full(n, -1.0)))
            for slot in (L.COUNTS, L.FIRST_US):
                self.counted += range(int(record[slot]), int(record[slot]) + n)
        for link in stage.links:
            self._lay_out_link(link)

    def _record(self, number: int) -> np.ndarray:
        first = L.FIRST_STAGE + number * L.STAGE_SIZE
        return self.program[first : first + L.STAGE_SIZE]

    def _room(self, n: int) -> int:
        """Room for n numbers in the state; returns where it begins."""
        first = self._n_state
        self._n_state += n
        return first

    def _lay_out_link(self, link: _Link) -> None:
        record = self.program[self._next_link : self._next_link + L.LINK_SIZE]
        self._next_link += L.LINK_SIZE
        record[L.FROM] = link.source
        record[L.KIND] = link.kind
        for place, value in link.fields.items():
            record[place] = value
        if link.kind == L.POOLING:
            record[L.WEIGHTS] = sum(map(len, self._params))
            self._params.append(np.array([link.factor]))
        elif link.weights is not None:
            record[L.WEIGHTS] = sum(map(len, self._weights))
            self._weights.append(np.ascontiguousarray(link.weights, np.float32).reshape(-1))

    def empty_state(self) -> np.ndarray:
        """The state of a window without events: neurons are at rest."""
        state = np.zeros(self._n_state)
        for first, values in self._at_rest:
            state[first : first + len(values)] = values
        return state

    def memory_of(self, number: int, shape: Shape) -> StageMemory:
        """Where the numbers of a stage lie, whose layer has an output of this shape."""
        record = self._record(number)
        return StageMemory(
            shape,
            self._stages[number].map_shape,
            int(record[L.MEMBRANES]),
            int(record[L.N_SPIKES]),
            int(record[L.N_ADDED]),
            int(record[L.COUNTS]),
            int(record[L.FIRST_US]),
            L.FIRST_STAGE + number * L.STAGE_SIZE,
        )


def width_of(n_channels: int) -> int:
    """How many numbers a place with so many channels has, with those that fill its last block."""
    return math.ceil(n_channels / BLOCK) * BLOCK


def _filled(values: np.ndarray) -> np.ndarray:
    """Values whose last axis is filled up with zeros to whole blocks."""
    n_filling = width_of(values.shape[-1]) - values.shape[-1]
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, n_filling)])


def _as_map(shape: Shape) -> Shape:
    """A shape as that of a map: a vector (N,) is a map of one place."""
    if len(shape) == 3:
        return shape
    return shape[0], 1, 1


def _spread_over(values: np.ndarray, map_shape: Shape) -> np.ndarray:
    """Values of each channel, or of each number, as a map: float64."""
    as_float = values.astype(np.float64)
    if as_float.size == map_shape[0]:
        return np.broadcast_to(as_float.reshape(-1, 1, 1), map_shape)
    return as_float.reshape(map_shape)
