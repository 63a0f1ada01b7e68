"""The loops over events behind the images: each event adds to its own pixel, and nothing else is touched.

Columns are those of `async_tnt.events.Columns`, checked; the first n places count.
"""

import numpy as np

from async_tnt.kernels.jit import compiled


@compiled
def add_counts(x: np.ndarray, y: np.ndarray, p: np.ndarray, n: int, image: np.ndarray) -> None:
    """image[c, y_i, x_i] += 1, with c = 0 for ON and 1 for OFF.

    Parameters
    ----------
    image : int32, shape (2, H, W). Updated in place.
    """
    for i in range(n):
        image[1 - np.int64(p[i]), y[i], x[i]] += 1


@compiled
def add_counts_and_times(
    t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray, n: int, start_us: int, window_us: int, image: np.ndarray
) -> None:
    """image[c, y_i, x_i] += 1 and image[2 + c, y_i, x_i] = max(itself, f_i) for the events in the window.

    The largest f of a pixel, rounded to float32, is the largest of the rounded ones: rounding keeps the order.
    So it makes no difference in which packets, or in which order, the events come.

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
