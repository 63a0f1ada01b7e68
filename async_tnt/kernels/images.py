"""Images of events: each event changes its own pixel.

Columns are checked (int64, uint16, uint16, uint8); their first n events are read.
"""

import numpy as np

from .jit import compiled


@compiled
def add_counts(x, y, p, n, image):
    """image[c, y_i, x_i] += 1, with c = 0 for ON and 1 for OFF.

    Parameters
    ----------
    image : int32, shape (2, H, W). Updated in place.
    """
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
