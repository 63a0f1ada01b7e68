"""What happens to a volume's cells between events: emptied for a window, and rounded to the array that users read."""

import numpy as np

from . import state as S
from .jit import compiled, inlined


@compiled
def empty_volume(buffer, array, start_us, limit_us, epoch):
    """Open a window: no events, all cells and the array zero. Counts go on.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    array : float32, shape (C, H, W). Updated in place.
    epoch : int. A number that no window had before.
    """
    ints = buffer.view(np.int64)
    first = ints[S.LOG]
    n_log = ints[S.N_LOG]
    if n_log > ints[S.LOG_SIZE] or n_log * S.NUMBERS_PER_EMPTIED > first - S.CELLS:
        for i in range(S.CELLS, first):
            buffer[i] = 0.0
        array[:] = 0.0
    else:
        row = ints[S.ROW]
        for k in range(first, first + n_log):
            for place in (ints[k], ints[k] + row):
                buffer[place] = 0.0
                buffer[place + 1] = 0.0
                buffer[place + 2] = 0.0
                buffer[place + 3] = 0.0
        for k in range(first, first + ints[S.N_READ]):  # now that all cells are zero
            _copy_around(buffer, ints, ints[k], array)
    ints[S.N_LOG] = 0
    ints[S.EPOCH] = epoch
    _note_read(ints)
    buffer[S.C_XF] = 0.0
    buffer[S.C_YF] = 0.0
    buffer[S.C_FF] = 0.0
    ints[S.START_US] = start_us
    ints[S.LIMIT_US] = limit_us
    ints[S.N] = 0
    ints[S.SUM_X] = 0
    ints[S.SUM_Y] = 0
    ints[S.SUM_T] = 0
    ints[S.NEWEST_US] = -1
    ints[S.DECIDED_FROM_US] = S.NEVER_US


@compiled
def cells_to_float32(buffer, array, n_bins):
    """Bring the array up to date:  array[b, y, x] = cells[b, y, x, 0] + cells[b - 1, y, x, 1].

    The second part is left out for the first bin of each polarity.

    Parameters
    ----------
    buffer : float64, the volume's `state`. What has been read is noted in it.
    array : float32, shape (C, H, W). Updated in place. With C = 2 B, the OFF bins behind the ON bins.
    n_bins : int. B.
    """
    ints = buffer.view(np.int64)
    n_changed = ints[S.N_LOG] - ints[S.N_READ]
    if n_changed > ints[S.LOG_SIZE] or n_changed * S.NUMBERS_PER_LOGGED > array.size:
        _copy_bins(buffer, ints, array, n_bins)
    else:
        for k in range(ints[S.N_READ], ints[S.N_LOG]):
            _copy_around(buffer, ints, ints[ints[S.LOG] + (k & (ints[S.LOG_SIZE] - 1))], array)
    _note_read(ints)


@inlined
def strides_of(ints):
    """Numbers in a row and in an interval of cells, and from an ON cell to its OFF cell. Read once and passed as values
    to the functions below: the compiler then knows that no store changes them."""
    return ints[S.ROW], ints[S.PLANE], ints[S.OFF_SHIFT]


@inlined
def cell_at(strides, corner):
    """Interval, row and column of the cell at this index, the `corner` of an event: the inverse of
    `splat.place_event`."""
    row, plane, _ = strides
    place = corner - S.CELLS
    b = place // plane
    y = (place - b * plane) // row
    x = (place - b * plane - y * row) // 2
    return b, y, x


@inlined
def parts_of(strides, b, y, x):
    """Indices of the two numbers whose sum is the volume at (b, y, x): the lower bin's weight of interval b and the
    upper bin's of the interval before; and whether b is a first bin, which has no interval before it."""
    row, plane, off_shift = strides
    lower = S.CELLS + b * plane + y * row + 2 * x
    is_first = (b == 0) | (b * plane == off_shift)
    return lower, lower - plane + 1, is_first


@inlined
def cell_value(buffer, lower, upper, is_first, k):
    """The volume's number k pixels to the right of the one that `parts_of` was called for."""
    i = np.uint64(k) + np.uint64(k)
    return buffer[np.uint64(lower) + i] + (0.0 if is_first else buffer[np.uint64(upper) + i])


@inlined
def _note_read(ints):
    ints[S.N_READ] = ints[S.N_LOG]
    ints[S.INTERVAL_LO] = S.NO_INTERVAL
    ints[S.INTERVAL_HI] = -1


@compiled
def _copy_bins(buffer, ints, array, n_bins):
    """`cells_to_float32` for all cells of the bins that changed.

    Row by row of the image through all bins, so that each row of cells comes from memory once, and whole: of a loop
    over every other number LLVM makes gathers, which take five times as long on many processors.
    """
    n_channels, height, width = array.shape
    row, plane, _ = strides_of(ints)
    uppers = np.empty(width)  # weights of the interval before, to the bin at hand
    for y in range(height):
        for first in range(0, n_channels, n_bins):  # twice with OFF bins
            start = first + ints[S.INTERVAL_LO]
            uppers[:] = 0.0
            if start > first:
                at = np.uint64(S.CELLS + (start - 1) * plane + y * row + 1)
                for x in range(width):
                    uppers[x] = buffer[at + np.uint64(2 * x)]
            for b in range(start, min(first + ints[S.INTERVAL_HI] + 2, first + n_bins)):
                at = np.uint64(S.CELLS + b * plane + y * row)
                for x in range(width):
                    lower = at + np.uint64(2 * x)
                    array[b, y, x] = buffer[lower] + uppers[x]
                    uppers[x] = buffer[lower + np.uint64(1)]


@inlined
def _copy_around(buffer, ints, corner, array):
    """`cells_to_float32` for the eight numbers that an event at this corner changed."""
    n_channels, height, width = array.shape
    strides = strides_of(ints)
    b0, y0, x0 = cell_at(strides, corner)
    for b in range(b0, min(b0 + 2, n_channels)):
        for y in range(y0, min(y0 + 2, height)):
            lower, upper, is_first = parts_of(strides, b, y, x0)
            for k in range(min(2, width - x0)):
                value = cell_value(buffer, lower, upper, is_first, k)
                array[np.uint64(b), np.uint64(y), np.uint64(x0) + np.uint64(k)] = value
