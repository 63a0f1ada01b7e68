"""Bring a classifier's input up to date, and mark the cells of its first map that depend on a change as dirty.

Only values that differ are marked, so events that the transform dropped cost nothing further.
"""

import numpy as np
from llvmlite import ir

from . import layout as L
from . import state as S
from .forward import mark_dirty
from .jit import compiled, inlined
from .readout import cell_at, cell_value, parts_of, strides_of
from .simd import vectorized

NUMBERS_PER_LOGGED = 100  # one logged event, scattered in memory, costs as much as so many cells in order


@compiled
def sync_input(buffer, layout, maps, dirty):
    """Copy a volume to the input, from its cells:

        input[y + 1, c, x + 1] = cells[c, y, x, 0] + cells[c - 1, y, x, 1], rounded to float32 as in `readout`

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    layout, maps, dirty : the classifier's, see `layout`. Updated in place.
    """
    ints = buffer.view(np.int64)
    n_new = ints[S.N_LOG] - layout[L.N_SEEN]
    n_cells = layout[L.CHANNELS] * layout[L.HEIGHT] * layout[L.WIDTH]
    same_window = layout[L.EPOCH] == ints[S.EPOCH]
    if same_window and n_new <= ints[S.LOG_SIZE] and n_new * NUMBERS_PER_LOGGED <= n_cells:
        for k in range(layout[L.N_SEEN], ints[S.N_LOG]):
            _sync_corner(buffer, ints, ints[ints[S.LOG] + (k & (ints[S.LOG_SIZE] - 1))], layout, maps, dirty)
    else:
        _sync_all(buffer, ints, layout, maps, dirty)
    layout[L.EPOCH] = ints[S.EPOCH]
    layout[L.N_SEEN] = ints[S.N_LOG]


@compiled
def set_input(volume, layout, maps, dirty):
    """Copy an array (C, H, W) to the input, and mark everything as dirty."""
    n_channels, height, width = volume.shape
    for c in range(n_channels):
        for y in range(height):
            at = np.uint64(layout[L.INPUT] + ((y + 1) * n_channels + c) * (width + 2) + 1)
            for x in range(width):
                maps[at + np.uint64(x)] = volume[c, y, x]
    for k in range(layout[L.DIRTY_1], dirty.size):
        dirty[k] = 1
    layout[L.EPOCH] = 0


@inlined
def _sync_corner(buffer, ints, corner, layout, maps, dirty):
    """The eight cells of an event."""
    n_channels, height, width = layout[L.CHANNELS], layout[L.HEIGHT], layout[L.WIDTH]
    strides = strides_of(ints)
    c0, y0, x0 = cell_at(strides, corner)
    changed = False
    for c in range(c0, min(c0 + 2, n_channels)):
        for y in range(y0, min(y0 + 2, height)):
            lower, upper, is_first = parts_of(strides, c, y, x0)
            at = np.uint64(layout[L.INPUT] + ((y + 1) * n_channels + c) * (width + 2) + x0 + 1)
            for k in range(min(2, width - x0)):
                value = np.float32(cell_value(buffer, lower, upper, is_first, k))
                changed |= maps[at + np.uint64(k)] != value
                maps[at + np.uint64(k)] = value
    if changed:
        mark_dirty(layout, dirty, L.DIRTY_1, layout[L.ROWS_1], layout[L.COLUMNS_1], y0, y0 + 1, x0, x0 + 1)


@compiled
def _sync_all(buffer, ints, layout, maps, dirty):
    """All cells, row by row of the image."""
    n_channels, height, width = layout[L.CHANNELS], layout[L.HEIGHT], layout[L.WIDTH]
    strides = strides_of(ints)
    changed = layout[L.TILE]  # flags of this row's pixels, from the one before the first to the one past the last
    for y in range(height):
        for x in range(width + 2):
            maps[np.uint64(changed + x)] = 0
        for c in range(n_channels):
            at = layout[L.INPUT] + ((y + 1) * n_channels + c) * (width + 2) + 1
            lower, upper, is_first = parts_of(strides, c, y, 0)
            upper = lower if is_first else upper
            if width < 8:
                round_cells(buffer, lower, upper, width, maps, at, changed + 1)
            else:
                for k in range(0, width, 8):
                    x = min(k, width - 8)  # the last eight overlap those before: they do not differ twice
                    round_eight(buffer, lower + 2 * x, upper + 2 * x, maps, at + x, changed + 1 + x)
        _mark_row(layout, maps, changed, dirty, max(y - 1, 0) >> 1, min((y + 1) >> 1, layout[L.ROWS_1] - 1))


@inlined
def round_cells(buffer, lower, upper, n, maps, at, changed):
    """Neighbouring cells of a row, rounded to float32 and compared with the input.

    Parameters
    ----------
    buffer : float64, a volume's `state`.
    lower, upper : int. The `parts_of` the first cell; of a first bin, the lower one twice.
    maps : float32. Values from `at` on are updated in place; flags from `changed` on become 1 where they differed.
    """
    for x in range(n):
        value = np.float32(cell_value(buffer, lower, upper, lower == upper, x))
        if maps[at + x] != value:
            maps[changed + x] = 1
        maps[at + x] = value


@inlined
def round_eight_plain(buffer, lower, upper, maps, at, changed):
    """`round_cells` of eight. LLVM's own vector code for it is three times slower: it needs every other number, and
    flags go to another place than values."""
    round_cells(buffer, lower, upper, 8, maps, at, changed)


@vectorized(round_eight_plain)
def round_eight(simd, buffer, lower, upper, maps, at, changed):
    builder = simd.builder
    singles, doubles = ir.VectorType(ir.FloatType(), 8), ir.VectorType(ir.DoubleType(), 8)
    pairs = ir.VectorType(ir.DoubleType(), 16)

    def every_other(index):
        mask = ir.Constant(ir.VectorType(ir.IntType(32), 8), list(range(0, 16, 2)))
        return builder.shuffle_vector(simd.load(buffer, index, pairs), ir.Constant(pairs, ir.Undefined), mask)

    # a select, not a branch: an unused read at `lower` is in the cache already
    is_first = builder.icmp_signed("==", upper, lower)
    uppers = builder.select(is_first, ir.Constant(doubles, [0.0] * 8), every_other(upper))
    value = builder.fptrunc(builder.fadd(every_other(lower), uppers), singles)
    differs = builder.fcmp_unordered("!=", simd.load(maps, at, singles), value)
    flags = builder.select(differs, ir.Constant(singles, [1.0] * 8), simd.load(maps, changed, singles))
    simd.store(value, maps, at)
    simd.store(flags, maps, changed)


@inlined
def _mark_row(layout, maps, changed, dirty, upper, lower):
    """`mark_dirty` for a row of pixels, which reaches these two rows of cells (or twice the same)."""
    n_rows, n_columns = layout[L.ROWS_1], layout[L.COLUMNS_1]
    upper_cells = layout[L.DIRTY_1] + n_rows + upper * n_columns
    lower_cells = layout[L.DIRTY_1] + n_rows + lower * n_columns
    any_changed = np.uint8(0)
    for column in range(n_columns):
        i = np.uint64(changed + 2 * column)
        near = maps[i] + maps[i + np.uint64(1)] + maps[i + np.uint64(2)] + maps[i + np.uint64(3)]
        flag = np.uint8(near > 0)
        dirty[np.uint64(upper_cells + column)] |= flag
        dirty[np.uint64(lower_cells + column)] |= flag
        any_changed |= flag
    dirty[layout[L.DIRTY_1] + upper] |= any_changed
    dirty[layout[L.DIRTY_1] + lower] |= any_changed
