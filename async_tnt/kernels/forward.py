"""The classifier, layer by layer, where it is out of date: input -> logits.

    conv 3x3, ReLU, 2x2 mean -> the same -> dense, ReLU -> dense

Each layer computes the cells marked for it, keeps them, and marks what of the next layer they reach if they have
changed. With everything marked it is the plain forward pass: there is no other one, so that what is renewed and
what is computed whole cannot differ in a bit.
"""

import numpy as np

from . import layout as P
from .conv_pool import CELLS_1, CELLS_2, FILTERS_1, FILTERS_2, occupied, tile_1, tile_2
from .dense import UNITS, weigh
from .jit import compiled, inlined
from .sync_input import mark


@compiled
def renew(plan, weights, maps, dirty):
    """Bring the logits up to date with the input.

    Parameters
    ----------
    plan, weights, maps, dirty : the classifier's, see `plan`. Maps and marks are updated in place.
    """
    _renew_pooled_1(plan, weights, maps, dirty)
    _renew_pooled_2(plan, weights, maps, dirty)
    if _renew_partials(plan, weights, maps, dirty):
        _renew_logits(plan, weights, maps)


@compiled
def _renew_pooled_1(plan, weights, maps, dirty):
    n_channels, width = plan[P.CHANNELS], plan[P.WIDTH]
    n_filters, n_rows, n_columns = plan[P.F], plan[P.ROWS_1], plan[P.COLUMNS_1]
    pitch = width + 2
    for row in range(n_rows):
        if dirty[plan[P.DIRTY_1] + row] == 0:
            continue
        dirty[plan[P.DIRTY_1] + row] = 0
        marks = plan[P.DIRTY_1] + n_rows + row * n_columns
        column = _next_marked(dirty, marks, 0, n_columns)
        while column < n_columns:
            first = max(min(column, n_columns - CELLS_1), 0)
            n = min(CELLS_1, n_columns - first)
            inputs = plan[P.INPUT] + 2 * row * n_channels * pitch + 2 * first
            cells = plan[P.POOLED_1] + ((row + 1) * (n_columns + 2) + first + 1) * n_filters
            n_active = _find_active(maps, inputs, pitch, n_channels, plan)
            lo, hi = n, -1
            for f in range(0, n_filters, FILTERS_1):
                tile_1(
                    maps,
                    inputs,
                    n_channels * pitch,
                    pitch,
                    plan[P.SIZE :],
                    n_active,
                    weights,
                    plan[P.CONV_1] + 9 * n_channels * f,
                    plan[P.BIAS_1] + f,
                    maps,
                    plan[P.TILE],
                )
                for cell in range(n):
                    if _keep(maps, plan[P.TILE] + cell * FILTERS_1, cells + cell * n_filters + f, FILTERS_1):
                        lo, hi = min(lo, cell), max(hi, cell)
            if hi >= 0:
                mark(plan, dirty, P.DIRTY_2, plan[P.ROWS_2], plan[P.COLUMNS_2], row, row, first + lo, first + hi)
            for cell in range(first, first + n):
                dirty[marks + cell] = 0
            column = _next_marked(dirty, marks, first + n, n_columns)


@compiled
def _renew_pooled_2(plan, weights, maps, dirty):
    n_channels, pitch = plan[P.F_USED], plan[P.F]
    n_filters, n_rows, n_columns = plan[P.G], plan[P.ROWS_2], plan[P.COLUMNS_2]
    row_pitch = (plan[P.COLUMNS_1] + 2) * pitch
    for row in range(n_rows):
        if dirty[plan[P.DIRTY_2] + row] == 0:
            continue
        dirty[plan[P.DIRTY_2] + row] = 0
        marks = plan[P.DIRTY_2] + n_rows + row * n_columns
        partials = plan[P.DIRTY_3] + n_rows + row * n_columns
        column = _next_marked(dirty, marks, 0, n_columns)
        while column < n_columns:
            first = max(min(column, n_columns - CELLS_2), 0)
            n = min(CELLS_2, n_columns - first)
            inputs = plan[P.POOLED_1] + 2 * row * row_pitch + 2 * first * pitch
            cells = plan[P.POOLED_2] + (row * n_columns + first) * n_filters
            for f in range(0, n_filters, FILTERS_2):
                tile_2(
                    maps,
                    inputs,
                    row_pitch,
                    pitch,
                    n_channels,
                    weights,
                    plan[P.CONV_2] + 9 * n_channels * f,
                    plan[P.BIAS_2] + f,
                    maps,
                    plan[P.TILE],
                )
                for cell in range(n):
                    if _keep(maps, plan[P.TILE] + cell * FILTERS_2, cells + cell * n_filters + f, FILTERS_2):
                        dirty[partials + first + cell] = 1
                        dirty[plan[P.DIRTY_3] + row] = 1
            for cell in range(first, first + n):
                dirty[marks + cell] = 0
            column = _next_marked(dirty, marks, first + n, n_columns)


@compiled
def _renew_partials(plan, weights, maps, dirty):
    """What each place adds to the hidden units, and the sums of its row. Returns whether anything changed."""
    n_inputs, n_filters, n_units = plan[P.G_USED], plan[P.G], plan[P.U]
    n_rows, n_columns = plan[P.ROWS_2], plan[P.COLUMNS_2]
    any_row = False
    for row in range(n_rows):
        if dirty[plan[P.DIRTY_3] + row] == 0:
            continue
        dirty[plan[P.DIRTY_3] + row] = 0
        any_row = True
        marks = plan[P.DIRTY_3] + n_rows + row * n_columns
        for column in range(n_columns):
            if dirty[marks + column] == 0:
                continue
            dirty[marks + column] = 0
            place = row * n_columns + column
            for unit in range(0, n_units, UNITS):
                weigh(
                    maps,
                    plan[P.POOLED_2] + place * n_filters,
                    n_inputs,
                    weights,
                    plan[P.DENSE_1] + (place * n_units + unit) * n_inputs,
                    maps,
                    plan[P.PARTIAL] + place * n_units + unit,
                )
        _add_up(maps, plan[P.PARTIAL] + row * n_columns * n_units, n_columns, n_units, plan[P.ROW_SUMS] + row * n_units)
    return any_row


@compiled
def _renew_logits(plan, weights, maps):
    n_units, n_used, n_classes = plan[P.U], plan[P.U_USED], plan[P.K]
    hidden, logits = np.uint64(plan[P.HIDDEN]), np.uint64(plan[P.LOGITS])
    _add_up(maps, plan[P.ROW_SUMS], plan[P.ROWS_2], n_units, plan[P.HIDDEN])
    bias = np.uint64(plan[P.BIAS_3])
    for j in range(n_units):
        u = np.uint64(j)
        total = maps[hidden + u] + weights[bias + u]
        maps[hidden + u] = np.float32(0) if total < 0 else total
    bias = np.uint64(plan[P.BIAS_4])
    for k in range(n_classes):
        maps[logits + np.uint64(k)] = weights[bias + np.uint64(k)]
    for j in range(n_used):
        value = maps[hidden + np.uint64(j)]
        row = np.uint64(plan[P.DENSE_2] + j * n_classes)
        for k in range(n_classes):
            u = np.uint64(k)
            maps[logits + u] += value * weights[row + u]


@inlined
def _find_active(maps, inputs, pitch, n_channels, plan):
    """List the channels in which a tile sees anything in `plan` from SIZE on; returns how many. At least one:
    the sum over none is that over zeros."""
    plan[P.SIZE] = 0
    n_active = 0
    for c in range(n_channels):
        plan[np.uint64(P.SIZE + n_active)] = c
        n_active += occupied(maps, inputs + c * pitch, n_channels * pitch)
    return max(n_active, 1)


@inlined
def _next_marked(dirty, marks, column, n_columns):
    while column < n_columns and dirty[marks + column] == 0:
        column += 1
    return column


@inlined
def _keep(maps, source, target, n):
    """Copy n numbers; whether any differs from what was there."""
    changed = False
    for k in range(n):
        value = maps[np.uint64(source + k)]
        changed |= value != maps[np.uint64(target + k)]
        maps[np.uint64(target + k)] = value
    return changed


@inlined
def _add_up(maps, source, n, size, target):
    """maps[target..] = the sum of n vectors of a size, in their order."""
    to = np.uint64(target)
    for j in range(size):
        maps[to + np.uint64(j)] = 0
    for k in range(n):
        at = np.uint64(source + k * size)
        for j in range(size):
            u = np.uint64(j)
            maps[to + u] += maps[at + u]
