"""Mean poolings whose windows hold different numbers of inputs.

They are computed with windows of one size, in which each output place has weights of its own. The
weights come from the rows and the columns, one axis at a time.

Along one axis, a window is a row of taps: tap i of output place k reads the input
`k stride - before + i`. The inputs whose mean is wanted are the span of the place. The share of a
tap is its factor in this mean: 1 / n for the n inputs that lie in the span and inside the map, 0
for all other taps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class AdaptiveSpans(NamedTuple):
    """The inputs of each place of an adaptive pooling, along one axis.

    Parameters
    ----------
    spans : for each place, the index of its first input, and the index behind its last input.
    stride, before : tap i of place k reads the input k stride - before + i.
    kernel : the number of taps of a place.
    """

    spans: list[tuple[int, int]]
    stride: int
    before: int
    kernel: int


def inside_shares(n: int, n_inputs: int, kernel: int, stride: int, before: int) -> np.ndarray:
    """The shares of a mean pooling in which padding does not count, along one axis.

    The array has the shape (n, kernel).
    """
    starts = [k * stride - before for k in range(n)]
    spans = [(start, start + kernel) for start in starts]
    return shares_of(spans, n_inputs, stride, before, kernel)


def last_windows(side: int, kernel: int, stride: int, before: int) -> tuple[int, int]:
    """The indices of two windows of a pooling with `ceil_mode`, along one axis.

    The first is the last window if the number of windows is rounded up. The second is the last
    window that begins inside the input or the padding at the front.
    """
    last_rounded_up = math.ceil((side + 2 * before - kernel) / stride)
    last_inside = (side + before - 1) // stride
    return last_rounded_up, last_inside


def padding_of_ceil_mode(side: int, kernel: int, stride: int, before: int) -> int:
    """The padding at the end that gives a pooling the windows of torch's `ceil_mode`.

    With `ceil_mode` the last window may reach beyond the padded input, but it must begin inside the
    input or the padding at the front.
    """
    last = min(last_windows(side, kernel, stride, before))
    return last * stride + kernel - before - side


def adaptive_spans(n: int, n_inputs: int) -> AdaptiveSpans:
    """The inputs of an adaptive pooling to `n` places, along one axis.

    Place k is the mean of the inputs from floor(k n_inputs / n) to ceil((k + 1) n_inputs / n).
    """
    spans = []
    for k in range(n):
        first = k * n_inputs // n
        end = math.ceil((k + 1) * n_inputs / n)
        spans.append((first, end))
    stride = max(1, n_inputs // n)
    # If there are more places than inputs, the span of place k may begin before input k stride.
    before = max(k * stride - first for k, (first, _) in enumerate(spans))
    kernel = max(end - k * stride + before for k, (_, end) in enumerate(spans))
    return AdaptiveSpans(spans, stride, before, kernel)


def adaptive_shares(n: int, n_inputs: int) -> tuple[np.ndarray, int, int]:
    """The shares of an adaptive pooling to `n` places along one axis, its stride and `before`."""
    spans, stride, before, kernel = adaptive_spans(n, n_inputs)
    return shares_of(spans, n_inputs, stride, before, kernel), stride, before


def adaptive_matrix(n: int, n_inputs: int) -> np.ndarray:
    """The share of each input in each place of an adaptive pooling, (n, n_inputs)."""
    shares, stride, before = adaptive_shares(n, n_inputs)
    # the matrix is wide enough for all taps, also for taps in front of the inputs and behind them
    matrix = np.zeros((n, before + n * stride + shares.shape[1] + n_inputs))
    for k, row in enumerate(shares):
        matrix[k, k * stride : k * stride + len(row)] = row
    return matrix[:, before : before + n_inputs]


def shares_of(
    spans: Sequence[tuple[int, int]], n_inputs: int, stride: int, before: int, kernel: int
) -> np.ndarray:
    """The share of each tap in the mean of its place, (places, taps).

    A span may reach beyond the inputs. Only the inputs that exist count.

    Examples
    --------
    >>> shares_of([(-1, 2), (1, 4)], 3, 2, 1, 3)
    array([[0. , 0.5, 0.5],
           [0.5, 0.5, 0. ]])
    """
    inputs = np.arange(len(spans))[:, None] * stride - before + np.arange(kernel)
    first, end = np.array(spans).T[:, :, None]
    is_inside = (inputs >= np.maximum(first, 0)) & (inputs < np.minimum(end, n_inputs))
    shares: np.ndarray = is_inside / is_inside.sum(axis=1, keepdims=True)
    return shares


def place_weights(rows: np.ndarray, columns: np.ndarray, channels: int) -> np.ndarray:
    """The weights of each place: the share of its row times the share of its column.

    The array has the shape (rows, columns, taps, C) and is read-only.
    """
    products = np.einsum("yi,xj->yxij", rows, columns).astype(np.float32)
    shares = products.reshape(len(rows), len(columns), -1, 1)
    return np.broadcast_to(shares, (*shares.shape[:3], channels))
