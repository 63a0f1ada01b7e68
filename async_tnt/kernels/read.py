"""Between windows and readers: empty a volume, round its cells into the array that people see, store a
window's events for a replay."""

import numpy as np

from . import state as S
from .jit import compiled


@compiled
def empty_volume(buffer, start_us, limit_us, n_intervals, height):
    """Open a window: no events, all cells zero. Counters go on."""
    ints = buffer[S.N_FLOATS : S.CELLS].view(np.int64)
    for i in range(S.CELLS, buffer.size):
        buffer[i] = 0.0
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
    ints[S.BIN_LO] = 0  # the whole array is to be refreshed
    ints[S.BIN_HI] = n_intervals - 1
    ints[S.ROW_LO] = 0
    ints[S.ROW_HI] = height - 1


@compiled
def copy_cells(buffer, array, n_intervals):
    """array[b, y, x] = cells[b, y, x, 0] + cells[b - 1, y, x, 1], where cells changed since the last read.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Its marks of change are cleared.
    array : float32, shape (C, H, W). Updated in place. With C = 2 B, the OFF bins behind the ON bins.
    n_intervals : int. B.
    """
    ints = buffer[S.N_FLOATS : S.CELLS].view(np.int64)
    n_bins, height, width = array.shape
    cells = buffer[S.CELLS :].reshape(n_bins, height + 1, width + 1, 2)
    bin_lo = ints[S.BIN_LO]
    bin_hi = min(ints[S.BIN_HI] + 1, n_intervals - 1)
    row_lo = ints[S.ROW_LO]
    row_hi = min(ints[S.ROW_HI] + 1, height - 1)
    for first in range(0, n_bins, n_intervals):
        for b in range(first + bin_lo, first + bin_hi + 1):
            for y in range(row_lo, row_hi + 1):
                out = array[b, y]
                early = cells[b, y]
                if b > first:
                    late = cells[b - 1, y]
                    for x in range(width):
                        out[x] = early[x, 0] + late[x, 1]
                else:
                    for x in range(width):
                        out[x] = early[x, 0]
    ints[S.BIN_LO] = S.FAR
    ints[S.BIN_HI] = -1
    ints[S.ROW_LO] = S.FAR
    ints[S.ROW_HI] = -1


@compiled
def store_events(buffer, t, x, y, p, first, last, stored_t, stored_x, stored_y, stored_p, n_stored):
    """What `absorb` does for a landmark known only at the read: count and sum, and store the events.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place, its cells excepted.
    t, x, y, p, first, last : as for `absorb`.
    stored_t, stored_x, stored_y, stored_p : columns. Updated in place from `n_stored` on; what exceeds them
        is counted in the sums and not stored.

    Returns
    -------
    first : int. The first event not taken (at or after LIMIT_US).
    n_stored : int. Events stored now.
    """
    ints = buffer[S.N_FLOATS : S.CELLS].view(np.int64)
    while first < last and t[first] < ints[S.LIMIT_US]:
        ints[S.RECEIVED] += 1
        if t[first] < ints[S.START_US]:
            ints[S.LATE] += 1
        else:
            ints[S.N] += 1
            ints[S.SUM_X] += x[first]
            ints[S.SUM_Y] += y[first]
            ints[S.SUM_T] += t[first] - ints[S.START_US]
            ints[S.NEWEST_US] = max(ints[S.NEWEST_US], t[first])
            if n_stored < stored_t.size:
                stored_t[n_stored] = t[first]
                stored_x[n_stored] = x[first]
                stored_y[n_stored] = y[first]
                stored_p[n_stored] = p[first]
                n_stored += 1
        first += 1
    return first, n_stored
