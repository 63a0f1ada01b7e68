"""Empty a volume's cells for a new window, and round them to the array that users read."""

import numpy as np
from numba import float32, int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.slices import begin_slices

ARRAY = float32[:, :, ::1]
"""Numba's type of a volume's array."""


@entry_point(S.STATE, ARRAY, int64, int64, int64)
def empty_volume(buffer, array, start_us, limit_us, epoch):
    """Open a window without events, in which all cells are zero. The counts are kept.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    array : float32, shape (C, H, W). Updated in place, or left for the next read to update.
    start_us, limit_us : int. START_US and LIMIT_US of the window.
    epoch : int. A number that no window had before.
    """
    ints = buffer.view(np.int64)
    log_start = ints[S.LOG]
    n_log = ints[S.N_LOG]

    # Zero all cells or, where that costs less, only the cells of the logged events. `shows_empty`
    # says whether the array shows the empty window afterwards.
    if n_log * S.CELLS_PER_LOGGED > log_start - S.CELLS:
        for i in range(S.CELLS, log_start):
            buffer[i] = 0.0
        # An array that shows no event of the window is zero already.
        shows_empty = ints[S.N_READ] == 0
    else:
        row = ints[S.ROW]
        second = ints[S.SECOND]
        for k in range(log_start, log_start + n_log):
            for place in (ints[k], ints[k] + row, ints[k] + second, ints[k] + second + row):
                buffer[place] = 0.0
                buffer[place + 1] = 0.0
        # Now that all cells are zero, copy those that the array shows with other values.
        for k in range(log_start, log_start + ints[S.N_READ]):
            _copy_around(buffer, ints, ints[k], array)
        shows_empty = ints[S.N_READ] >= 0

    ints[S.N_LOG] = 0
    ints[S.EPOCH] = epoch
    _note_read(ints)
    if not shows_empty:
        mark_unread(ints)

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
    ints[S.RING_FIRST] = 0
    ints[S.RING_N] = 0
    begin_slices(ints)
    ints[S.DECIDED_FROM_US] = S.NEVER_US
    ints[S.CLOSED_KEPT] = ints[S.KEPT]
    ints[S.CLOSED_TAU_ZERO] = ints[S.TAU_ZERO]


@entry_point(S.STATE, ARRAY)
def cells_to_float32(buffer, array):
    """Bring the array up to date:  array[b, y, x] = cells[b, y, x].

    Parameters
    ----------
    buffer : float64, the volume's `state`. The kernel notes in it what has been read.
    array : float32, shape (C, H, W). Updated in place.
    """
    ints = buffer.view(np.int64)
    n_changed = ints[S.N_LOG] - ints[S.N_READ]
    if n_changed * S.CELLS_PER_LOGGED > array.size:
        _copy_planes(buffer, ints, array)
    else:
        for k in range(ints[S.N_READ], ints[S.N_LOG]):
            # LOG_SIZE is a power of two, so `&` gives the remainder of a division by it.
            place_in_log = k & (ints[S.LOG_SIZE] - 1)
            _copy_around(buffer, ints, ints[ints[S.LOG] + place_in_log], array)
    _note_read(ints)


@inlined
def cell_at(ints, corner, has_slices):
    """Plane, row and column of an event's corner, the inverse of `splat.place_event`.

    Parameters
    ----------
    corner : int. Index of the cell in the volume's buffer.
    has_slices : bool. Whether the window has slices, see `slices`: a number that kernels keep.
    """
    row = ints[S.ROW]
    plane = ints[S.PLANE]
    place = corner - S.CELLS
    b = place // plane
    y = (place - b * plane) // row
    x = place - b * plane - y * row
    if has_slices:
        b = _turned(ints, b, -ints[S.PHASE])
    return b, y, x


@inlined
def row_at(ints, b, y, has_slices):
    """Index of the first cell of a row of channel b. For `has_slices` see `cell_at`."""
    if has_slices:
        b = _turned(ints, b, ints[S.PHASE])
    return S.CELLS + b * ints[S.PLANE] + y * ints[S.ROW]


@inlined
def _turned(ints, b, phase):
    """Channel b, or its plane, in the turn of the bins of its polarity."""
    n_bins = ints[S.SPAN_US] // ints[S.SLICE_US]
    first = b // n_bins * n_bins
    return first + (b - first + phase + n_bins) % n_bins


@inlined
def mark_unread(ints):
    """Let the next read copy all cells, whatever the array shows."""
    ints[S.N_READ] = S.UNREAD
    ints[S.INTERVAL_LO] = 0
    ints[S.INTERVAL_HI] = S.NO_INTERVAL


@inlined
def _note_read(ints):
    """Mark the array as up to date: it shows all events of the window."""
    ints[S.N_READ] = ints[S.N_LOG]
    ints[S.INTERVAL_LO] = S.NO_INTERVAL
    ints[S.INTERVAL_HI] = -1


@compiled
def _copy_planes(buffer, ints, array):
    """Copy all cells of the bins that changed into the array, as float32."""
    n_channels, height, width = array.shape
    # With `split` polarity, the OFF bins lie OFF_SHIFT cells behind the ON bins. Otherwise
    # OFF_SHIFT is 0, and each channel is a bin of its own.
    n_bins = ints[S.OFF_SHIFT] // ints[S.PLANE] or n_channels
    has_slices = ints[S.SLICE_US] != 0
    for b in range(n_channels):
        # Events in interval i change the bins i and i + 1.
        if not ints[S.INTERVAL_LO] <= b % n_bins <= ints[S.INTERVAL_HI] + 1:
            continue
        for y in range(height):
            row_start = np.uint64(row_at(ints, b, y, has_slices))
            for x in range(width):
                array[b, y, x] = buffer[row_start + np.uint64(x)]


@inlined
def _copy_around(buffer, ints, corner, array):
    """Copy the cells that an event at this corner changed into the array, as float32."""
    n_channels, height, width = array.shape
    has_slices = ints[S.SLICE_US] != 0
    b0, y0, x0 = cell_at(ints, corner, has_slices)
    for b in range(b0, min(b0 + 2, n_channels)):
        for y in range(y0, min(y0 + 2, height)):
            row_start = np.uint64(row_at(ints, b, y, has_slices))
            for x in range(x0, min(x0 + 2, width)):
                array[np.uint64(b), np.uint64(y), np.uint64(x)] = buffer[row_start + np.uint64(x)]
