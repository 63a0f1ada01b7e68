"""Layers by which maps grow: transposed convolutions and upsampling.

They are a convolution on the small map, whose channels then become blocks of places
(depth_to_space). So they need no operation of their own, and compute the same sums.

With stride s, kernel K, dilation d and padding p, a transposed convolution adds input i, times tap
k, to the place q = s i + d k - p of its output, along each axis. Let q = s m + r, with the phase
0 <= r < s. Then input m + o has part in it with the tap k for which d k = r + p - s o. So each
phase is a filter of an ordinary convolution over the offsets o.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form


@dataclass(frozen=True)
class Enlarging:
    """A convolution, and the size of the blocks that its channels become.

    Parameters
    ----------
    weight : (filters, channels / groups, kernel y, kernel x), with `block`**2 filters for each
        channel of the result.
    bias : (filters,), or None.
    padding : top, left, bottom, right.
    groups, block : groups of the convolution; block of the depth_to_space.
    """

    weight: np.ndarray
    bias: np.ndarray | None
    padding: list[int]
    groups: int
    block: int

    @property
    def conv(self) -> dict[str, Any]:
        """The parameters of the convolution's layer, without its weights."""
        return {
            "kernel": list(self.weight.shape[2:]),
            "stride": [1, 1],
            "padding": self.padding,
            "dilation": [1, 1],
            "groups": self.groups,
        }


def nearest(channels: int, factor: int) -> Enlarging:
    """Each place becomes factor x factor places with its number."""
    weight = np.ones((channels * factor**2, 1, 1, 1), np.float32)
    return Enlarging(weight, None, [0, 0, 0, 0], channels, factor)


def bilinear(channels: int, factor: int) -> Enlarging:
    """Bilinear upsampling to factor x factor places, of a map with an edge of one place.

    Along each axis, phase r of place i lies at c = (r + 1/2) / factor - 1/2 beside it: it is
    (1 - |c|) x_i + |c| times the neighbour on the side of c. At the borders the neighbour is the
    place itself, so the map has to be padded by its edge first.
    """
    c = (np.arange(factor) + 0.5) / factor - 0.5
    taps = np.stack([np.maximum(-c, 0), 1 - np.abs(c), np.maximum(c, 0)], 1)
    phases = np.einsum("ay,bx->abyx", taps, taps).reshape(-1, 1, 3, 3)
    weight = np.tile(phases, (channels, 1, 1, 1)).astype(np.float32)
    return Enlarging(weight, None, [0, 0, 0, 0], channels, factor)


EDGE = [1, 1, 1, 1]
"""The padding of a map before `bilinear`."""


def transposed_convolution(
    weight: np.ndarray,
    bias: np.ndarray | None,
    sides: Sequence[int],
    *,
    stride: Sequence[int],
    padding: Sequence[int],
    output_padding: Sequence[int],
    dilation: Sequence[int],
    groups: int,
) -> Enlarging:
    """The layers of a transposed convolution, see the module's docstring.

    Parameters
    ----------
    weight : (channels, filters / groups, kernel y, kernel x), as torch and ONNX have it.
    bias : (filters,), or None.
    sides : rows and columns of the input.
    stride, output_padding, dilation : y and x.
    padding : top, left, bottom, right.

    Raises
    ------
    NotImplementedError : the strides differ, or the output has no whole number of blocks.
    """
    expect_form(stride[0] == stride[1], f"a transposed convolution with strides {list(stride)}")
    block = int(stride[0])
    axes = [
        _phases(
            weight.shape[2 + axis],
            sides[axis],
            block,
            (padding[axis], padding[2 + axis]),
            output_padding[axis],
            dilation[axis],
        )
        for axis in (0, 1)
    ]
    (taps_y, before_y, after_y), (taps_x, before_x, after_x) = axes
    channels, filters_of_group = weight.shape[:2]
    in_group = channels // groups
    # by group: (groups, channels of a group, filters of a group, kernel y, kernel x)
    grouped = weight.reshape(groups, in_group, filters_of_group, *weight.shape[2:])
    phases = np.zeros(
        (groups, filters_of_group, block, block, in_group, taps_y.shape[1], taps_x.shape[1]),
        np.float32,
    )
    for r_y, o_y in np.argwhere(taps_y >= 0):
        for r_x, o_x in np.argwhere(taps_x >= 0):
            tap = grouped[:, :, :, taps_y[r_y, o_y], taps_x[r_x, o_x]]
            phases[:, :, r_y, r_x, :, o_y, o_x] = tap.transpose(0, 2, 1)
    conv_weight = phases.reshape(-1, in_group, *phases.shape[5:])
    conv_bias = None if bias is None else np.repeat(np.asarray(bias, np.float32), block**2)
    return Enlarging(conv_weight, conv_bias, [before_y, before_x, after_y, after_x], groups, block)


def _phases(
    kernel: int, side: int, stride: int, padding: tuple[int, int], extra: int, dilation: int
) -> tuple[np.ndarray, int, int]:
    """The taps of each phase, and the padding of the convolution, along one axis.

    Returns
    -------
    taps : (stride, offsets): the tap of the kernel at each offset, -1 where there is none.
    before, after : padding of the convolution.
    """
    size = (side - 1) * stride - sum(padding) + dilation * (kernel - 1) + extra + 1
    words = f"a transposed convolution to {size} places by strides of {stride}"
    expect_form(size % stride == 0, words)
    # phase r, offset o -> tap
    found = {}
    for r in range(stride):
        for k in range(kernel):
            o, rest = divmod(r + padding[0] - dilation * k, stride)
            if rest == 0:
                found[r, o] = k
    offsets = [o for _, o in found] or [0]
    first = min(offsets)
    n_offsets = max(offsets) - first + 1
    taps = np.full((stride, n_offsets), -1)
    for (r, o), k in found.items():
        taps[r, o - first] = k
    before = -first
    after = size // stride - side - before + n_offsets - 1
    expect_form(before >= 0 and after >= 0, "a transposed convolution that cuts off places")
    return taps, before, after
