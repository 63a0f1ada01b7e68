"""Clocks of few bits, unwrapped: a whole row of times at once."""

import numpy as np

from async_tnt.kernels.evt import unwrap_times


def unwrapped(raw: np.ndarray, time: int, period: int) -> tuple[np.ndarray, int]:
    """Times of a clock that starts anew after `period`, in one row.

    Parameters
    ----------
    raw : integers in [0, period).
    time : the last unwrapped time before them, or -1.

    Returns
    -------
    int64 times, and the last of them.
    """
    t = raw.astype(np.int64)
    return t, int(unwrap_times(t, np.int64(time), np.int64(period)))
