"""The classifier's dense layers, where they are out of date: pooled 2 -> partials -> hidden units -> logits.

partial[Y, X, u] = sum over filters g of pooled2[Y, X, g] w[Y, X, g, u]
hidden[u] = ReLU(bias[u] + sum over rows Y of (sum over X of partial[Y, X, u]))
logit[k] = bias[k] + sum over u of hidden[u] w[u, k]
"""

import numpy as np

from . import layout as L
from .jit import compiled, inlined
from .simd import LANES, ZERO, fma, vectorized

UNITS = 64  # of a dense tile


@inlined
def dense_tile_plain(inputs, first, n_inputs, weights, first_weight, out, first_out):
    """out[j] = sum over f of in[f] w[f, j]        UNITS units j, in the order of f

    Parameters
    ----------
    inputs : float32; `n_inputs` from `first` on.
    weights : float32; (n_inputs, UNITS) from `first_weight` on.
    out : float32; (UNITS,) from `first_out` on. Updated in place.
    """
    for j in range(UNITS):
        total = np.float32(0)
        for f in range(n_inputs):
            total = fma(inputs[first + f], weights[first_weight + f * UNITS + j], total)
        out[first_out + j] = total


@vectorized(dense_tile_plain)
def dense_tile(simd, inputs, first, n_inputs, weights, first_weight, out, first_out):
    lanes = range(0, UNITS, LANES)

    def add_input(f, sums):
        value = simd.spread(simd.at(inputs, simd.add(first, f)))
        at = simd.add(first_weight, simd.mul(f, UNITS))
        return [
            simd.fma(value, simd.load(weights, simd.add(at, j)), total) for j, total in zip(lanes, sums, strict=True)
        ]

    for j, total in zip(lanes, simd.loop(n_inputs, [ZERO] * len(lanes), add_input), strict=True):
        simd.store(total, out, simd.add(first_out, j))


@compiled
def forward_partials(layout, weights, maps, dirty):
    """What each dirty place adds to the hidden units, and the sums of its row. Returns whether any was dirty."""
    n_inputs, n_filters, n_units = layout[L.G_USED], layout[L.G], layout[L.U]
    n_rows, n_columns = layout[L.ROWS_2], layout[L.COLUMNS_2]
    any_row = False
    for row in range(n_rows):
        if dirty[layout[L.DIRTY_3] + row] == 0:
            continue
        dirty[layout[L.DIRTY_3] + row] = 0
        any_row = True
        cells = layout[L.DIRTY_3] + n_rows + row * n_columns
        for column in range(n_columns):
            if dirty[cells + column] == 0:
                continue
            dirty[cells + column] = 0
            place = row * n_columns + column
            inputs = layout[L.POOLED_2] + place * n_filters
            for unit in range(0, n_units, UNITS):
                block = layout[L.DENSE_1] + (place * n_units + unit) * n_inputs
                dense_tile(maps, inputs, n_inputs, weights, block, maps, layout[L.PARTIAL] + place * n_units + unit)
        partials = layout[L.PARTIAL] + row * n_columns * n_units
        _sum_vectors(maps, partials, n_columns, n_units, layout[L.ROW_SUMS] + row * n_units)
    return any_row


@compiled
def forward_logits(layout, weights, maps):
    """Hidden units and logits, from the sums of all rows."""
    n_units, n_used, n_classes = layout[L.U], layout[L.U_USED], layout[L.K]
    hidden, logits = np.uint64(layout[L.HIDDEN]), np.uint64(layout[L.LOGITS])
    _sum_vectors(maps, layout[L.ROW_SUMS], layout[L.ROWS_2], n_units, layout[L.HIDDEN])
    bias = np.uint64(layout[L.BIAS_3])
    for j in range(n_units):
        u = np.uint64(j)
        total = maps[hidden + u] + weights[bias + u]
        maps[hidden + u] = np.float32(0) if total < 0 else total
    bias = np.uint64(layout[L.BIAS_4])
    for k in range(n_classes):
        maps[logits + np.uint64(k)] = weights[bias + np.uint64(k)]
    for j in range(n_used):
        value = maps[hidden + np.uint64(j)]
        row = np.uint64(layout[L.DENSE_2] + j * n_classes)
        for k in range(n_classes):
            u = np.uint64(k)
            maps[logits + u] += value * weights[row + u]


@inlined
def _sum_vectors(maps, source, n, size, target):
    """maps[target..] = the sum of n vectors of this size, in their order."""
    to = np.uint64(target)
    for j in range(size):
        maps[to + np.uint64(j)] = 0
    for k in range(n):
        at = np.uint64(source + k * size)
        for j in range(size):
            u = np.uint64(j)
            maps[to + u] += maps[at + u]
