"""The classifier, layer by layer, where it is out of date: input -> logits.

    conv 3x3, ReLU, 2x2 mean -> the same -> dense, ReLU -> dense

Each layer computes its dirty cells, keeps them, and marks as dirty the cells of the next layer that depend on those
that changed. With everything dirty this is the plain forward pass. There is no second implementation of it, so an
update and a whole pass cannot differ in a bit.
"""

import numpy as np

from . import layout as L
from .conv_pool import CELLS_1, CELLS_2, FILTERS_1, FILTERS_2, any_input_1, conv_pool_1, conv_pool_2
from .dense import forward_logits, forward_partials
from .jit import compiled, inlined


@compiled
def forward(layout, weights, maps, dirty):
    """Bring the logits up to date with the input.

    Parameters
    ----------
    layout, weights, maps, dirty : the classifier's, see `layout`. Maps, mask and the scratch part of the layout are
        updated in place.
    """
    forward_conv_1(layout, weights, maps, dirty)
    forward_conv_2(layout, weights, maps, dirty)
    if forward_partials(layout, weights, maps, dirty):
        forward_logits(layout, weights, maps)


@compiled
def forward_conv_1(layout, weights, maps, dirty):
    """Input -> pooled 1."""
    n_channels, pitch = layout[L.CHANNELS], layout[L.WIDTH] + 2
    n_filters, n_rows, n_columns = layout[L.F], layout[L.ROWS_1], layout[L.COLUMNS_1]
    for row in range(n_rows):
        if dirty[layout[L.DIRTY_1] + row] == 0:
            continue
        dirty[layout[L.DIRTY_1] + row] = 0
        flags = layout[L.DIRTY_1] + n_rows + row * n_columns
        column = _next_dirty(dirty, flags, 0, n_columns)
        while column < n_columns:
            first = max(min(column, n_columns - CELLS_1), 0)  # at the right edge, also cells that are not dirty
            n = min(CELLS_1, n_columns - first)
            inputs = layout[L.INPUT] + 2 * row * n_channels * pitch + 2 * first
            cells = layout[L.POOLED_1] + ((row + 1) * (n_columns + 2) + first + 1) * n_filters
            n_active = _list_active(maps, inputs, pitch, n_channels, layout)
            lo, hi = n, -1
            for f in range(0, n_filters, FILTERS_1):
                conv_pool_1(
                    maps,
                    inputs,
                    n_channels * pitch,
                    pitch,
                    layout[L.ACTIVE :],
                    n_active,
                    weights,
                    layout[L.CONV_1] + 9 * n_channels * f,
                    layout[L.BIAS_1] + f,
                    maps,
                    layout[L.TILE],
                )
                for cell in range(n):
                    if _replace(maps, layout[L.TILE] + cell * FILTERS_1, cells + cell * n_filters + f, FILTERS_1):
                        lo, hi = min(lo, cell), max(hi, cell)
            if hi >= 0:
                mark_dirty(
                    layout, dirty, L.DIRTY_2, layout[L.ROWS_2], layout[L.COLUMNS_2], row, row, first + lo, first + hi
                )
            for cell in range(first, first + n):
                dirty[flags + cell] = 0
            column = _next_dirty(dirty, flags, first + n, n_columns)


@compiled
def forward_conv_2(layout, weights, maps, dirty):
    """Pooled 1 -> pooled 2."""
    n_channels, pitch = layout[L.F_USED], layout[L.F]
    n_filters, n_rows, n_columns = layout[L.G], layout[L.ROWS_2], layout[L.COLUMNS_2]
    row_pitch = (layout[L.COLUMNS_1] + 2) * pitch
    for row in range(n_rows):
        if dirty[layout[L.DIRTY_2] + row] == 0:
            continue
        dirty[layout[L.DIRTY_2] + row] = 0
        flags = layout[L.DIRTY_2] + n_rows + row * n_columns
        partials = layout[L.DIRTY_3] + n_rows + row * n_columns
        column = _next_dirty(dirty, flags, 0, n_columns)
        while column < n_columns:
            first = max(min(column, n_columns - CELLS_2), 0)
            n = min(CELLS_2, n_columns - first)
            inputs = layout[L.POOLED_1] + 2 * row * row_pitch + 2 * first * pitch
            cells = layout[L.POOLED_2] + (row * n_columns + first) * n_filters
            for f in range(0, n_filters, FILTERS_2):
                conv_pool_2(
                    maps,
                    inputs,
                    row_pitch,
                    pitch,
                    n_channels,
                    weights,
                    layout[L.CONV_2] + 9 * n_channels * f,
                    layout[L.BIAS_2] + f,
                    maps,
                    layout[L.TILE],
                )
                for cell in range(n):
                    if _replace(maps, layout[L.TILE] + cell * FILTERS_2, cells + cell * n_filters + f, FILTERS_2):
                        dirty[partials + first + cell] = 1
                        dirty[layout[L.DIRTY_3] + row] = 1
            for cell in range(first, first + n):
                dirty[flags + cell] = 0
            column = _next_dirty(dirty, flags, first + n, n_columns)


@inlined
def mark_dirty(layout, dirty, which, n_rows, n_columns, y_lo, y_hi, x_lo, x_hi):
    """Mark the cells that the pixels y_lo..y_hi, x_lo..x_hi (inclusive) of the map before can reach.

    A pixel reaches the pooled cells whose 2x2 places lie within one pixel of it, through the 3x3 taps: rows
    (y - 1) // 2 to (y + 1) // 2 of the next map, and columns likewise.
    """
    first_x = max(x_lo - 1, 0) >> 1
    last_x = min((x_hi + 1) >> 1, n_columns - 1)
    for row in range(max(y_lo - 1, 0) >> 1, min((y_hi + 1) >> 1, n_rows - 1) + 1):
        dirty[np.uint64(layout[which] + row)] = 1
        cells = layout[which] + n_rows + row * n_columns
        for column in range(first_x, last_x + 1):
            dirty[np.uint64(cells + column)] = 1


@inlined
def _list_active(maps, inputs, pitch, n_channels, layout):
    """List the channels that are not all zero in a tile, in `layout` from ACTIVE on; returns how many, at least one."""
    layout[L.ACTIVE] = 0
    n_active = 0
    for c in range(n_channels):
        layout[np.uint64(L.ACTIVE + n_active)] = c
        n_active += any_input_1(maps, inputs + c * pitch, n_channels * pitch)
    return max(n_active, 1)


@inlined
def _next_dirty(dirty, flags, column, n_columns):
    while column < n_columns and dirty[flags + column] == 0:
        column += 1
    return column


@inlined
def _replace(maps, source, target, n):
    """Copy n numbers; returns whether any differs from what was there."""
    changed = False
    for k in range(n):
        value = maps[np.uint64(source + k)]
        changed |= value != maps[np.uint64(target + k)]
        maps[np.uint64(target + k)] = value
    return changed
