"""Events by their pixels: filter them and count them.

Columns are checked (int64, uint16, uint16, uint8) and on the sensor; their first n events are read.
Another thread may change them meanwhile, so a pixel is read once, and never leads beyond an array.
"""

import numpy as np

from async_tnt.kernels.jit import compiled_without_gil
from async_tnt.kernels.volume.records import store

KEEP, MASKED, OUTSIDE = 0, 1, 2


@compiled_without_gil
def keep_events(t, x, y, p, n, verdicts, left, top, records):
    """Write the events whose pixel is kept as packed records, in their order.

    Parameters
    ----------
    verdicts : uint8, shape (H, W). KEEP, MASKED or OUTSIDE.
    left, top : int. Subtracted from x and y; not more than those of any kept pixel.
    records : uint8, shape (13 n,). Overwritten: t int64, x uint16, y uint16, p uint8 of each kept
        event.

    Returns
    -------
    n_kept, n_masked : int.
    """
    kept = 0
    masked = 0
    height, width = verdicts.shape
    for i in range(n):
        column = min(np.int64(x[i]), width - 1)
        row = min(np.int64(y[i]), height - 1)
        verdict = verdicts[row, column]
        at = 13 * kept  # without a branch: an event that is not kept is overwritten by the next one
        store(records, at, t[i], np.int64)
        store(records, at + 8, column - left, np.uint16)
        store(records, at + 10, row - top, np.uint16)
        store(records, at + 12, p[i], np.uint8)
        kept += verdict == KEEP
        masked += verdict == MASKED
    return kept, masked


@compiled_without_gil
def count_events(x, y, n, counts):
    """counts[y_i, x_i] += 1; int64, shape (H, W), updated in place."""
    height, width = counts.shape
    for i in range(n):
        counts[min(np.int64(y[i]), height - 1), min(np.int64(x[i]), width - 1)] += 1
