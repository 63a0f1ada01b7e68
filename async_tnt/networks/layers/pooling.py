"""Pooling: maxima, means and sums over the places of a window, or over all places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from async_tnt.kernels.network.program import MAXIMUM, SUM
from async_tnt.networks.layers.layer import PADDING, SIDES, Layer, Shape
from async_tnt.networks.layers.operation import (
    Operation,
    expect_map,
    sides_through_window,
    window_of,
)
from async_tnt.networks.layers.places import divided_axis
from async_tnt.networks.layers.steps import Map, StepList
from async_tnt.networks.layers.uneven_windows import (
    adaptive_shares,
    adaptive_spans,
    inside_shares,
    place_weights,
)


def _pool_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    sides = sides_through_window(layer, inputs[0])
    top, left, bottom, right = layer["padding"]
    if max(top, bottom) >= layer["kernel"][0] or max(left, right) >= layer["kernel"][1]:
        raise ValueError(f"padding {layer['padding']} must be less than kernel {layer['kernel']}")
    return inputs[0][0], *sides


def _max_pool_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    if any(layer["padding"]):
        # The padding must never be the maximum. So the pooling reads a copy of the input in a frame
        # of -inf.
        source = step_list.copy(source, source.like(fill=-np.inf))
    zeros = np.zeros(source.channels)
    return step_list.add(
        MAXIMUM, [source], step_list.output_of(layer), [], zeros, **window_of(layer)
    )


def _average_pool_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    rows, columns = layer["kernel"]
    return _sums_of_windows(step_list, layer, inputs, 1.0 / (rows * columns))


def _sum_pool_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    return _sums_of_windows(step_list, layer, inputs, 1.0)


def _sums_of_windows(step_list: StepList, layer: Layer, inputs: list[Map], factor: float) -> Map:
    """Add a step that sums each window, and multiplies the sum by a factor; returns its map."""
    (source,) = inputs
    rows, columns = layer["kernel"]
    zeros = np.zeros(source.channels)
    # one window over the whole input
    if source.sides == (rows, columns) and not any(layer["padding"]):
        return step_list.sum_of_places(source, factor, zeros)
    weights = np.full((rows * columns, source.channels), factor)
    return step_list.add(
        SUM, inputs, step_list.output_of(layer), weights, zeros, **window_of(layer)
    )


def _inside_average_pool_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    output = step_list.output_of(layer)
    window = window_of(layer)
    kernel_y, kernel_x = window["kernel"]
    stride_y, stride_x = window["stride"]
    above, before = window["padding"]
    rows = inside_shares(output.rows, source.rows, kernel_y, stride_y, above)
    columns = inside_shares(output.columns, source.columns, kernel_x, stride_x, before)
    weights = place_weights(rows, columns, output.channels)
    zeros = np.zeros(output.channels)
    return step_list.add(SUM, inputs, output, weights, zeros, own_weights=True, **window)


def _adaptive_pool_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    expect_map(inputs[0])
    rows, columns = layer["size"]
    return inputs[0][0], rows, columns


def _adaptive_pool_kernel(layer: Layer, source: Shape, output: Shape) -> Sequence[int]:
    """The number of taps along each axis, rows first, see `AdaptiveSpans`."""
    return [
        adaptive_spans(n, n_inputs).kernel
        for n, n_inputs in zip(output[1:], source[1:], strict=True)
    ]


def _adaptive_average_pool_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    output = step_list.output_of(layer)
    rows, stride_y, above = adaptive_shares(output.rows, source.rows)
    columns, stride_x, before = adaptive_shares(output.columns, source.columns)
    return step_list.add(
        SUM,
        inputs,
        output,
        place_weights(rows, columns, output.channels),
        np.zeros(output.channels),
        own_weights=True,
        kernel=(rows.shape[1], columns.shape[1]),
        stride=(stride_y, stride_x),
        padding=(above, before),
    )


def _global_pool_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    expect_map(inputs[0])
    return inputs[0][0], 1, 1


def _global_average_pool_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    factor = 1.0 / (source.rows * source.columns)
    return step_list.sum_of_places(source, factor, np.zeros(source.channels))


_WINDOW = {"kernel": SIDES, "stride": SIDES, "padding": PADDING}

POOLING = (
    Operation(
        name="max_pool",
        description="The largest number of each window, of the places inside the input.",
        parameters=_WINDOW,
        shape=_pool_shape,
        steps=_max_pool_steps,
    ),
    Operation(
        name="average_pool",
        description="The mean of each window; padded places count, as zeros.",
        parameters=_WINDOW,
        shape=_pool_shape,
        steps=_average_pool_steps,
    ),
    Operation(
        name="sum_pool",
        description="The sum of each window.",
        parameters=_WINDOW,
        shape=_pool_shape,
        steps=_sum_pool_steps,
    ),
    Operation(
        name="inside_average_pool",
        description="The mean of each window; padded places do not count.",
        parameters=_WINDOW,
        shape=_pool_shape,
        steps=_inside_average_pool_steps,
        own_weights=True,
    ),
    Operation(
        name="adaptive_average_pool",
        description=(
            "To `size` places: place k of n is the mean of the m inputs from floor(k m / n) to "
            "ceil((k + 1) m / n), along each axis."
        ),
        parameters={"size": SIDES},
        shape=_adaptive_pool_shape,
        steps=_adaptive_average_pool_steps,
        places=divided_axis,
        kernel=_adaptive_pool_kernel,
        own_weights=True,
    ),
    Operation(
        name="global_average_pool",
        description="The mean of all places, (C, 1, 1).",
        shape=_global_pool_shape,
        steps=_global_average_pool_steps,
        places=divided_axis,
    ),
)
