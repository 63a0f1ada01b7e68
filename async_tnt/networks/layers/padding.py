"""Padding: further rows and columns around a map, of zeros or of the numbers at its edge."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.network.program import SUM
from async_tnt.networks.layers.layer import PADDING, Layer, Shape
from async_tnt.networks.layers.operation import Operation, expect_map
from async_tnt.networks.layers.places import padded_axis
from async_tnt.networks.layers.steps import Map, StepList
from async_tnt.networks.layers.uneven_windows import place_weights


def _pad_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    expect_map(inputs[0])
    channels, rows, columns = inputs[0]
    top, left, bottom, right = layer["padding"]
    return channels, top + rows + bottom, left + columns + right


def _zero_pad_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Copy the input to its place in a larger map; the copy reads zeros around the input."""
    (source,) = inputs
    top, left, _, _ = layer["padding"]
    ones = np.ones((1, source.channels))
    zeros = np.zeros(source.channels)
    output = step_list.output_of(layer)
    return step_list.add(SUM, inputs, output, ones, zeros, padding=(top, left))


def _edge_pad_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Add a step that pads the rows, and a step that pads the columns.

    Each place reads one of several taps, see `edge_taps`.
    """
    (source,) = inputs
    top, left, bottom, right = layer["padding"]
    output = step_list.output_of(layer)
    zeros = np.zeros(source.channels)
    tall = source
    if top or bottom:
        tall = Map(source.channels, output.rows, source.columns)
        rows = edge_taps(source.rows, top, bottom)
        weights = place_weights(rows, np.ones((source.columns, 1)), source.channels)
        step_list.add(
            SUM,
            [source],
            tall,
            weights,
            zeros,
            own_weights=True,
            kernel=(rows.shape[1], 1),
            padding=(top + bottom, 0),
        )
    columns = edge_taps(source.columns, left, right)
    return step_list.add(
        SUM,
        [tall],
        output,
        place_weights(np.ones((output.rows, 1)), columns, source.channels),
        zeros,
        own_weights=True,
        kernel=(1, columns.shape[1]),
        padding=(0, left + right),
    )


def edge_taps(n: int, before: int, after: int) -> np.ndarray:
    """Which tap a place of an edge padding reads, along one axis: 1 for it, 0 for the others.

    Place k of the output is input j = min(max(k - before, 0), n - 1). Tap i of place k reads the
    input k - (before + after) + i.

    Returns
    -------
    (before + n + after, before + after + 1).

    Examples
    --------
    >>> edge_taps(2, 1, 1)
    array([[0., 0., 1.],
           [0., 1., 0.],
           [0., 1., 0.],
           [1., 0., 0.]])
    """
    places = np.arange(before + n + after)
    inputs = np.clip(places - before, 0, n - 1)
    taps = np.zeros((len(places), before + after + 1))
    taps[places, inputs - places + before + after] = 1.0
    return taps


PADDINGS = (
    Operation(
        name="zero_pad",
        description="The input in a frame of zeros.",
        parameters={"padding": PADDING},
        shape=_pad_shape,
        steps=_zero_pad_steps,
        places=padded_axis,
    ),
    Operation(
        name="edge_pad",
        description="The input in a frame that repeats the numbers at its edge.",
        parameters={"padding": PADDING},
        shape=_pad_shape,
        steps=_edge_pad_steps,
        places=padded_axis,
        kernel=lambda layer, source, output: [
            layer["padding"][axis] + layer["padding"][2 + axis] + 1 for axis in (0, 1)
        ],
        own_weights=True,
    ),
)
