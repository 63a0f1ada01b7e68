"""Operations that put maps together, or their numbers into another order."""

from __future__ import annotations

import math

import numpy as np

from async_tnt.kernels.network.program import SPREAD, SUM
from async_tnt.networks.layers.layer import POSITIVE, Layer, Shape
from async_tnt.networks.layers.operation import Operation, expect_map
from async_tnt.networks.layers.places import spread_axis
from async_tnt.networks.layers.steps import Map, StepList


def _depth_to_space_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    expect_map(inputs[0])
    block = layer["block"]
    channels, rows, columns = inputs[0]
    if channels % block**2:
        raise ValueError(f"blocks of {block} x {block} must divide its {channels} channels")
    return channels // block**2, block * rows, block * columns


def _depth_to_space_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    if len(source.writers) > 1:  # a SPREAD needs an input that one step computes
        source = step_list.copy(source, source.like())
    output = step_list.output_of(layer)
    zeros = np.zeros(output.channels)
    return step_list.add(SPREAD, [source], output, [], zeros, block=layer["block"])


def _add_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(set(inputs)) > 1:
        raise ValueError(f"its inputs must have one shape, got {', '.join(map(str, inputs))}")
    return inputs[0]


def _add_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    first = inputs[0]
    ones = np.ones((len(inputs), first.channels))
    return step_list.add(SUM, inputs, first.like(), ones, np.zeros(first.channels))


def _concat_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len({shape[1:] for shape in inputs}) > 1 or len({len(shape) for shape in inputs}) > 1:
        raise ValueError(
            f"its inputs must differ in their channels only, got {', '.join(map(str, inputs))}"
        )
    return sum(shape[0] for shape in inputs), *inputs[0][1:]


def _concat_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    n_channels = sum(source.channels for source in inputs)
    output = Map(n_channels, inputs[0].rows, inputs[0].columns)
    channel = 0
    for source in inputs:
        step_list.copy(source, output, channel)
        channel += source.channels
    return output


def _flatten_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    return (math.prod(inputs[0]),)


def _centroid_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(inputs[0]) != 3 or inputs[0][0] != 1:
        raise ValueError(f"its input must be a heatmap (1, H, W), got {inputs[0]}")
    return (2,)


def _no_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Add no step. Steps that need the layer's output read the map of its input instead."""
    return inputs[0]


JOINING = (
    Operation(
        name="depth_to_space",
        description=(
            "Each place becomes a block of block x block places: its channel "
            "c block^2 + i block + j is channel c of row i, column j of the block."
        ),
        parameters={"block": POSITIVE},
        shape=_depth_to_space_shape,
        steps=_depth_to_space_steps,
        places=spread_axis,
    ),
    Operation(
        name="add",
        description="The sum of two or more inputs of one shape.",
        shape=_add_shape,
        steps=_add_steps,
        n_inputs=2,
    ),
    Operation(
        name="concat",
        description="The channels of two or more inputs, one after the other.",
        shape=_concat_shape,
        steps=_concat_steps,
        n_inputs=2,
    ),
    Operation(
        name="flatten",
        description="All numbers as a vector (C * H * W,), in C order.",
        shape=_flatten_shape,
        steps=_no_steps,
        flat_maps="kept",
    ),
    Operation(
        name="heatmap_centroid",
        description=(
            "The mean place (x, y), in grid pixels, under a softmax over all places of (1, H, W)."
        ),
        shape=_centroid_shape,
        steps=_no_steps,
    ),
)
