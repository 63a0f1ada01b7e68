"""Bring a classifier's input up to date, and mark what of its maps can no longer be right.

A pixel of a map reaches the pooled cells whose 2x2 places lie within one pixel of it, through the 3x3 taps: rows
(y - 1) // 2 to (y + 1) // 2 of the next map. Only numbers that differ are marked, so that events which the
transform threw out cost nothing further.
"""

import numpy as np

from . import layout as P
from . import state as S
from .jit import compiled, inlined
from .rounding import CELLS, round_cells_checked, round_eight

NUMBERS_PER_LOGGED = 100  # one logged event, here and there in memory, costs as much as so many cells in order


@compiled
def watch_cells(buffer, plan, maps, dirty):
    """Make the input that of a volume, from its cells:

        input[y + 1, c, x + 1] = cells[c, y, x, 0] + cells[c - 1, y, x, 1], rounded to float32 as in `read`

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    plan, maps, dirty : the classifier's, see `plan`. Updated in place.
    """
    ints = buffer.view(np.int64)
    n_new = ints[S.N_LOG] - plan[P.N_SEEN]
    n_cells = plan[P.CHANNELS] * plan[P.HEIGHT] * plan[P.WIDTH]
    same_window = plan[P.EPOCH] == ints[S.EPOCH]
    if same_window and n_new <= ints[S.LOG_SIZE] and n_new * NUMBERS_PER_LOGGED <= n_cells:
        for k in range(plan[P.N_SEEN], ints[S.N_LOG]):
            _watch_corner(buffer, ints, ints[ints[S.LOG] + (k & (ints[S.LOG_SIZE] - 1))], plan, maps, dirty)
    else:
        _watch_all(buffer, ints, plan, maps, dirty)
    plan[P.EPOCH] = ints[S.EPOCH]
    plan[P.N_SEEN] = ints[S.N_LOG]


@compiled
def watch_array(volume, plan, maps, dirty):
    """Make the input that of an array (C, H, W), and mark everything."""
    n_channels, height, width = volume.shape
    for c in range(n_channels):
        for y in range(height):
            at = np.uint64(plan[P.INPUT] + ((y + 1) * n_channels + c) * (width + 2) + 1)
            for x in range(width):
                maps[at + np.uint64(x)] = volume[c, y, x]
    for k in range(plan[P.DIRTY_1], dirty.size):
        dirty[k] = 1
    plan[P.EPOCH] = 0


@inlined
def mark(plan, dirty, which, n_rows, n_columns, y_lo, y_hi, x_lo, x_hi):
    """Mark the cells that the pixels y_lo..y_hi, x_lo..x_hi (inclusive) of the map before can reach."""
    first_x = max(x_lo - 1, 0) >> 1
    last_x = min((x_hi + 1) >> 1, n_columns - 1)
    for row in range(max(y_lo - 1, 0) >> 1, min((y_hi + 1) >> 1, n_rows - 1) + 1):
        dirty[np.uint64(plan[which] + row)] = 1
        cells = plan[which] + n_rows + row * n_columns
        for column in range(first_x, last_x + 1):
            dirty[np.uint64(cells + column)] = 1


@inlined
def _watch_corner(buffer, ints, corner, plan, maps, dirty):
    """The eight cells of an event."""
    n_channels, height, width = plan[P.CHANNELS], plan[P.HEIGHT], plan[P.WIDTH]
    row, plane = ints[S.ROW], ints[S.PLANE]
    n_intervals = ints[S.OFF_SHIFT] // plane if ints[S.OFF_SHIFT] > 0 else n_channels
    c0 = (corner - S.CELLS) // plane
    y0 = (corner - S.CELLS - c0 * plane) // row
    x0 = (corner - S.CELLS - c0 * plane - y0 * row) // 2
    changed = False
    for c in range(c0, min(c0 + 2, n_channels)):
        is_first = c == 0 or c == n_intervals  # nothing comes from a bin before
        for y in range(y0, min(y0 + 2, height)):
            early = np.uint64(S.CELLS + c * plane + y * row + 2 * x0)
            late = early - np.uint64(plane) + np.uint64(1)
            at = np.uint64(plan[P.INPUT] + ((y + 1) * n_channels + c) * (width + 2) + x0 + 1)
            for k in range(min(2, width - x0)):
                x = np.uint64(k)
                value = np.float32(buffer[early + x + x] + (0.0 if is_first else buffer[late + x + x]))
                changed |= maps[at + x] != value
                maps[at + x] = value
    if changed:
        mark(plan, dirty, P.DIRTY_1, plan[P.ROWS_1], plan[P.COLUMNS_1], y0, y0 + 1, x0, x0 + 1)


@compiled
def _watch_all(buffer, ints, plan, maps, dirty):
    """All cells, row by row of the image."""
    n_channels, height, width = plan[P.CHANNELS], plan[P.HEIGHT], plan[P.WIDTH]
    n_rows = plan[P.ROWS_1]
    row, plane = ints[S.ROW], ints[S.PLANE]
    n_intervals = ints[S.OFF_SHIFT] // plane if ints[S.OFF_SHIFT] > 0 else n_channels
    marks = plan[P.TILE]  # of this row's pixels, from the one before the first to the one past the last
    for y in range(height):
        for x in range(width + 2):
            maps[np.uint64(marks + x)] = 0
        for c in range(n_channels):
            at = plan[P.INPUT] + ((y + 1) * n_channels + c) * (width + 2) + 1
            early = S.CELLS + c * plane + y * row
            is_first = c == 0 or c == n_intervals  # nothing comes from a bin before
            late = early if is_first else early - plane + 1
            if width < CELLS:
                round_cells_checked(buffer, early, late, width, maps, at, marks + 1)
            else:
                for k in range(0, width, CELLS):
                    x = min(k, width - CELLS)  # the last eight overlap those before: they do not differ twice
                    round_eight(buffer, early + 2 * x, late + 2 * x, maps, at + x, marks + 1 + x)
        _mark_row(plan, maps, marks, dirty, max(y - 1, 0) >> 1, min((y + 1) >> 1, n_rows - 1))


@inlined
def _mark_row(plan, maps, marks, dirty, upper, lower):
    """`mark` for a row of pixels, which reaches these two rows of cells (or twice the same)."""
    n_rows, n_columns = plan[P.ROWS_1], plan[P.COLUMNS_1]
    upper_cells = plan[P.DIRTY_1] + n_rows + upper * n_columns
    lower_cells = plan[P.DIRTY_1] + n_rows + lower * n_columns
    changed = np.uint8(0)
    for column in range(n_columns):
        i = np.uint64(marks + 2 * column)
        near = maps[i] + maps[i + np.uint64(1)] + maps[i + np.uint64(2)] + maps[i + np.uint64(3)]
        flag = np.uint8(near > 0)
        dirty[np.uint64(upper_cells + column)] |= flag
        dirty[np.uint64(lower_cells + column)] |= flag
        changed |= flag
    dirty[plan[P.DIRTY_1] + upper] |= changed
    dirty[plan[P.DIRTY_1] + lower] |= changed
