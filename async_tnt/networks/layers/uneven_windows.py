"""Mean poolings whose windows hold different numbers of places, as kernels of one size with weights
of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def inside_shares(n: int, n_inputs: int, kernel: int, stride: int, before: int) -> np.ndarray:
    """Along one axis, of a pooling over the places inside the input: see `shares_of`."""
    starts = [k * stride - before for k in range(n)]
    return shares_of(
        [(start, start + kernel) for start in starts], n_inputs, stride, before, kernel
    )


def adaptive_spans(n: int, n_inputs: int) -> tuple[list[tuple[int, int]], int, int, int]:
    """Along one axis, of an adaptive pooling to `n` places: first input and end of each, and
    stride, before and kernel as for `shares_of`.

    Place k is the mean of the inputs from floor(k n_inputs / n) to ceil((k + 1) n_inputs / n).
    """
    spans = [(k * n_inputs // n, -(-(k + 1) * n_inputs // n)) for k in range(n)]
    stride = max(1, n_inputs // n)
    # above 0 with more places than inputs
    before = max(k * stride - first for k, (first, _) in enumerate(spans))
    return spans, stride, before, max(end - k * stride + before for k, (_, end) in enumerate(spans))


def adaptive_shares(n: int, n_inputs: int) -> tuple[np.ndarray, int, int]:
    """Along one axis, of an adaptive pooling to `n` places: see `shares_of`; the stride, and how
    many places before."""
    spans, stride, before, kernel = adaptive_spans(n, n_inputs)
    return shares_of(spans, n_inputs, stride, before, kernel), stride, before


def adaptive_matrix(n: int, n_inputs: int) -> np.ndarray:
    """(n, n_inputs): what each input adds to each place of an adaptive pooling."""
    shares, stride, before = adaptive_shares(n, n_inputs)
    matrix = np.zeros((n, before + n * stride + shares.shape[1] + n_inputs))
    for k, row in enumerate(shares):
        matrix[k, k * stride : k * stride + len(row)] = row
    return matrix[:, before : before + n_inputs]


def shares_of(
    spans: Sequence[tuple[int, int]], n_inputs: int, stride: int, before: int, kernel: int
) -> np.ndarray:
    """(places, taps): what each tap adds to the mean over the part of a place's span that lies
    inside the input.

    Tap i of place k is the input k stride - before + i.

    Examples
    --------
    >>> shares_of([(-1, 2), (1, 4)], 3, 2, 1, 3)
    array([[0. , 0.5, 0.5],
           [0.5, 0.5, 0. ]])
    """
    at = np.arange(len(spans))[:, None] * stride - before + np.arange(kernel)
    first, end = np.array(spans).T[:, :, None]
    inside = (at >= np.maximum(first, 0)) & (at < np.minimum(end, n_inputs))
    shares: np.ndarray = inside / inside.sum(axis=1, keepdims=True)
    return shares


def place_weights(rows: np.ndarray, columns: np.ndarray, channels: int) -> np.ndarray:
    """(rows, columns, taps, C), read-only, from the shares along both axes: those of its row times
    its column's."""
    shares = (
        np.einsum("yi,xj->yxij", rows, columns)
        .astype(np.float32)
        .reshape(len(rows), len(columns), -1, 1)
    )
    return np.broadcast_to(shares, (*shares.shape[:3], channels))
