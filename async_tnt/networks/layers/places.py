"""Where the places of a map lie on the grid."""

from __future__ import annotations

from typing import NamedTuple

from async_tnt.networks.layers.layer import Layer


class Axis(NamedTuple):
    """The rows or the columns of a map.

    Parameters
    ----------
    first : the middle of the grid pixels that the first row or column depends on.
    distance : grid pixels from the middle of a row or column to the middle of the next.
    n : the number of rows or columns.
    """

    first: float
    distance: float
    n: int


def axis_through_window(layer: Layer, k: int, axis: Axis) -> Axis:
    """The axis of a layer's output: the input's axis, moved by the layer's window.

    A layer without a window does not change the axis.

    Parameters
    ----------
    k : 0 for rows, 1 for columns.
    axis : axis of the layer's input.
    """
    if "kernel" not in layer:
        return axis
    # from the first to the last tap of a window
    reach = (layer["kernel"][k] - 1) * layer.get("dilation", (1, 1))[k]
    before = layer["padding"][k]
    after = layer["padding"][2 + k]
    stride = layer["stride"][k]
    n = (axis.n + before + after - reach - 1) // stride + 1
    first = axis.first + axis.distance * (reach / 2 - before)  # the middle of the first window
    return Axis(first, axis.distance * stride, n)


def divided_axis(layer: Layer, k: int, axis: Axis) -> Axis:
    """The axis of the output of a pooling whose places divide the input evenly.

    The number of places is the layer's `size`, or 1 if the layer has no `size`.
    """
    n = layer.get("size", (1, 1))[k]
    first = axis.first + axis.distance * (axis.n / n - 1) / 2
    return Axis(first, axis.distance * axis.n / n, n)


def padded_axis(layer: Layer, k: int, axis: Axis) -> Axis:
    """The axis of the output of a padding."""
    before = layer["padding"][k]
    after = layer["padding"][2 + k]
    return Axis(axis.first - axis.distance * before, axis.distance, before + axis.n + after)


def spread_axis(layer: Layer, k: int, axis: Axis) -> Axis:
    """The axis of the output of a layer that turns each place into a block of places."""
    block = layer["block"]
    first = axis.first + axis.distance * (1 / block - 1) / 2
    return Axis(first, axis.distance / block, axis.n * block)
