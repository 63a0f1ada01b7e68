"""Events by their pixels: filter them, count them, and draw them as images.

Columns are checked (int64, uint16, uint16, uint8) and on the sensor; their first n events are read.
"""

import numpy as np

from .jit import compiled, compiled_without_gil
from .records import store

KEEP, MASKED, OUTSIDE = 0, 1, 2


@compiled_without_gil
def keep_events(t, x, y, p, n, verdicts, left, top, records):
    """Write the events whose pixel is kept as packed records, in their order.

    Parameters
    ----------
    verdicts : uint8, shape (H, W). KEEP, MASKED or OUTSIDE.
    left, top : int. Subtracted from x and y; not more than those of any kept pixel.
    records : uint8, shape (13 n,). Overwritten: t int64, x uint16, y uint16, p uint8 of each kept event.

    Returns
    -------
    n_kept, n_masked : int.
    """
    kept = 0
    masked = 0
    for i in range(n):
        verdict = verdicts[y[i], x[i]]
        at = 13 * kept  # without a branch: an event that is not kept is overwritten by the next one
        store(records, at, t[i], np.int64)
        store(records, at + 8, x[i] - left, np.uint16)
        store(records, at + 10, y[i] - top, np.uint16)
        store(records, at + 12, p[i], np.uint8)
        kept += verdict == KEEP
        masked += verdict == MASKED
    return kept, masked


@compiled_without_gil
def count_events(x, y, n, counts):
    """counts[y_i, x_i] += 1; int64, shape (H, W), updated in place."""
    for i in range(n):
        counts[y[i], x[i]] += 1


@compiled
def add_counts(x, y, p, n, image):
    """image[c, y_i, x_i] += 1, with c = 0 for ON and 1 for OFF; int32, shape (2, H, W), updated in place."""
    for i in range(n):
        image[1 - np.int64(p[i]), y[i], x[i]] += 1


@compiled
def add_counts_and_times(t, x, y, p, n, start_us, window_us, image):
    """image[c, y_i, x_i] += 1, and image[2 + c, y_i, x_i] becomes f_i where that is larger, for events in the window.

    Rounding to float32 keeps the order, so the largest rounded f is the largest f rounded: packets and the order of
    events make no difference.

    Parameters
    ----------
    start_us, window_us : int. f_i = (t_i - start_us) / window_us; events with f_i outside [0, 1) are skipped.
    image : float32, shape (4, H, W). Updated in place.
    """
    for i in range(n):
        dt = t[i] - start_us
        if 0 <= dt < window_us:
            c = 1 - np.int64(p[i])
            f = np.float32(dt / window_us)
            image[c, y[i], x[i]] += np.float32(1.0)
            if f > image[2 + c, y[i], x[i]]:
                image[2 + c, y[i], x[i]] = f
