"""Upsampling that no convolution computes: between corners, and of a single place."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.network.program import PICK, SUM
from async_tnt.networks.layers.layer import BLOCK, SIDES, Layer, Shape
from async_tnt.networks.layers.operation import Operation, expect_map
from async_tnt.networks.layers.places import spread_axis
from async_tnt.networks.layers.steps import Map, StepList
from async_tnt.networks.layers.uneven_windows import place_weights

REACH = 3
"""Places of the input along one axis that the places of a block depend on."""


def _corners_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    expect_map(inputs[0])
    channels, rows, columns = inputs[0]
    return channels, layer["block"] * rows, layer["block"] * columns


def _corners_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Compute the places of each block as channels, then spread them."""
    (source,) = inputs
    block = layer["block"]
    channels = source.channels
    zeros = np.zeros(channels)
    rows = corner_taps(source.rows, block)
    columns = corner_taps(source.columns, block)
    wide = Map(block**2 * channels, source.rows, source.columns)
    for i in range(block):
        for j in range(block):
            step_list.add(
                SUM,
                inputs,
                wide,
                place_weights(rows[i], columns[j], channels),
                zeros,
                own_weights=True,
                kernel=(REACH, REACH),
                padding=(1, 1),
                channel=(i * block + j) * channels,
            )
    output = step_list.output_of(layer)
    picked = range(wide.channels)  # the places of a block already lie one after another
    return step_list.add(PICK, [wide], output, [], zeros, picked=picked, block=block)


def corner_taps(n: int, factor: int) -> np.ndarray:
    """The weights of the inputs m - 1, m and m + 1 in the places of block m, along one axis.

    The corners of input and output lie on each other: place q of the output lies at
    c = q (n - 1) / (factor n - 1) of the input, and a single place at 0. It is
    (1 - f) x_j + f x_(j+1), where j is the whole part of c and f the rest. Place q = factor m + r
    is in block m, and m - 1 < c < m + 1.

    Returns
    -------
    (factor, n, 3): by r, then by m.

    Examples
    --------
    >>> corner_taps(2, 2) * 3  # at 0, 1/3, 2/3 and 1
    array([[[0., 3., 0.],
            [1., 2., 0.]],
    <BLANKLINE>
           [[0., 2., 1.],
            [0., 3., 0.]]])
    """
    taps = np.zeros((factor, n, REACH))
    last = max(1, factor * n - 1)
    for r in range(factor):
        for m in range(n):
            whole, rest = divmod((factor * m + r) * (n - 1), last)
            share = rest / last
            taps[r, m, whole - m + 1] += 1 - share
            if rest:
                taps[r, m, whole - m + 2] += share
    return taps


def _expand_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if inputs[0][1:] != (1, 1):
        raise ValueError(f"its input must be a map of one place, got {inputs[0]}")
    return inputs[0][0], *layer["size"]


def _expand_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    zeros = np.zeros(source.channels)
    output = step_list.output_of(layer)
    return step_list.add(PICK, inputs, output, [], zeros, picked=range(source.channels))


UPSAMPLING = (
    Operation(
        name="bilinear_corners",
        description=(
            "Bilinear upsampling to block x block places for each place, where the corners of "
            "input and output lie on each other."
        ),
        parameters={"block": BLOCK},
        shape=_corners_shape,
        steps=_corners_steps,
        places=spread_axis,
        kernel=lambda layer, source, output: (REACH, REACH),
        own_weights=True,
    ),
    Operation(
        name="expand",
        description="The numbers of a map of one place, at each place of a map of `size`.",
        parameters={"size": SIDES},
        shape=_expand_shape,
        steps=_expand_steps,
    ),
)
