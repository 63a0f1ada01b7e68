"""Filter events by their pixels, and count the events of each pixel.

Columns are checked (int64, uint16, uint16, uint8) and on the sensor. Their first n events are read.
Another thread may change them meanwhile, so a pixel is read once, and never leads beyond an array.
"""

import numpy as np
from numba import int64, uint8, uint16

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.volume.records import COLUMNS, store

# what happens to the events of a pixel
KEEP = 0  # they are kept
MASKED = 1  # they are dropped, because the pixel is in a mask
OUTSIDE = 2  # they are dropped, because the pixel is outside the region

RECORD_BYTES = 13
"""Bytes of a packed record: t int64, x uint16, y uint16, p uint8."""


# Nine parameters: Numba takes columns faster one by one than in a tuple.
@entry_point(*COLUMNS, int64, uint8[:, ::1], int64, int64, uint8[::1], nogil=True)
def keep_events(t, x, y, p, n, verdicts, left, top, records):
    """Write the events whose pixel is kept as packed records, in their order.

    Parameters
    ----------
    t, x, y, p : columns, see above.
    n : int. Events.
    verdicts : uint8, shape (H, W). KEEP, MASKED or OUTSIDE.
    left, top : int. Subtracted from x and y. No kept pixel has a smaller x or y.
    records : uint8, shape (RECORD_BYTES n,). Overwritten with a record of each kept event.

    Returns
    -------
    n_kept, n_masked : int.
    """
    n_kept = 0
    n_masked = 0
    height, width = verdicts.shape
    for i in range(n):
        column = min(np.int64(x[i]), width - 1)
        row = min(np.int64(y[i]), height - 1)
        verdict = verdicts[row, column]
        # There is no branch: an event that is not kept is overwritten by the next one.
        record = RECORD_BYTES * n_kept
        store(records, record, t[i], np.int64)
        store(records, record + 8, column - left, np.uint16)
        store(records, record + 10, row - top, np.uint16)
        store(records, record + 12, p[i], np.uint8)
        n_kept += verdict == KEEP
        n_masked += verdict == MASKED
    return n_kept, n_masked


@entry_point(uint16[::1], uint16[::1], int64, int64[:, ::1], nogil=True)
def count_events(x, y, n, counts):
    """Count the first n events by their pixels: counts[y_i, x_i] += 1.

    Parameters
    ----------
    counts : int64, shape (H, W). Updated in place.
    """
    height, width = counts.shape
    for i in range(n):
        row = min(np.int64(y[i]), height - 1)
        column = min(np.int64(x[i]), width - 1)
        counts[row, column] += 1
