"""Operations that put maps together, or their numbers into another order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.kernels.network.program import PICK, PRODUCT, SUM, TOTAL
from async_tnt.networks.layers.layer import CHANNELS, POSITIVE, Layer, Shape
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
    block = layer["block"]
    output = step_list.output_of(layer)
    picked = np.arange(source.channels).reshape(output.channels, block**2).T.reshape(-1)
    return _add_pick(step_list, source, output, picked.tolist(), block=block)


def _add_pick(
    step_list: StepList, source: Map, output: Map, picked: Sequence[int], **options: Any
) -> Map:
    zeros = np.zeros(output.channels)
    return step_list.add(PICK, [source], output, [], zeros, picked=picked, **options)


def _pick_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    channels = inputs[0][0]
    if max(layer["channels"]) >= channels:
        raise ValueError(f"its channels must be below {channels}, got {max(layer['channels'])}")
    return (len(layer["channels"]), *inputs[0][1:])


def _pick_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    output = Map(len(layer["channels"]), source.rows, source.columns)
    return _add_pick(step_list, source, output, layer["channels"])


def _add_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(set(inputs)) > 1 and len(inputs) > 2:
        raise ValueError(f"its inputs must have one shape, got {', '.join(map(str, inputs))}")
    return _shape_of_two(inputs)


def _shape_of_two(inputs: list[Shape]) -> Shape:
    """The shape of a product or sum of two inputs."""
    shape = inputs[0]
    for other in inputs[1:]:
        if other == shape:
            continue
        are_maps = len(shape) == len(other) == 3
        channels = {shape[0], other[0]} - {1}
        sides = {shape[1:], other[1:]} - {(1, 1)}
        if not are_maps or len(channels) > 1 or len(sides) > 1:
            raise ValueError(
                "its inputs must have one shape, or one place or channel for all, got "
                f"{', '.join(map(str, inputs))}"
            )
        shape = (max(shape[0], other[0]), *max(shape[1:], other[1:]))
    return shape


def _add_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    first = inputs[0]
    if any(one.sides != first.sides or one.channels != first.channels for one in inputs):
        return _add_of_two(TOTAL, step_list, inputs)
    ones = np.ones((len(inputs), first.channels))
    return step_list.add(SUM, inputs, first.like(), ones, np.zeros(first.channels))


def _multiply_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(inputs) > 2:
        raise ValueError(f"must have 2 inputs, got {len(inputs)}")
    return _shape_of_two(inputs)


def _multiply_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    return _add_of_two(PRODUCT, step_list, inputs)


def _add_of_two(kind: int, step_list: StepList, inputs: list[Map]) -> Map:
    rows, columns = max(source.sides for source in inputs)
    output = Map(max(source.channels for source in inputs), rows, columns)
    return step_list.add(kind, inputs, output, [], np.zeros(output.channels))


def _concat_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len({shape[1:] for shape in inputs}) > 1:
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
        name="pick",
        description="Some channels of the input, in the order of `channels`.",
        parameters={"channels": CHANNELS},
        shape=_pick_shape,
        steps=_pick_steps,
    ),
    Operation(
        name="multiply",
        description=(
            "The product of two inputs. Their shapes are the same, or one of them has one place or "
            "one channel, which counts for all."
        ),
        shape=_multiply_shape,
        steps=_multiply_steps,
        n_inputs=2,
    ),
    Operation(
        name="add",
        description=(
            "The sum of two or more inputs of one shape, or of two whose shapes may differ as in a "
            "product."
        ),
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
