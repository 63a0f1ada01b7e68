"""Clocks of few bits, unwrapped."""

# mypy: disallow-untyped-defs=False
# (Numba functions: their types are in the docstrings)

import numpy as np

from async_tnt.kernels.jit import compiled


@compiled
def next_time(time, raw, period):
    """The time that a clock of so many steps shows as `raw`, nearest to the time before.

    A step of less than half a period back is disorder, or a bit that fell over: later times are not moved by it.
    A larger one is a wrap. No time lies before 0: what would, was a long gap.

    Parameters
    ----------
    time : the unwrapped time before, or -1 at the start.
    raw : what the clock shows, in [0, period).
    """
    if time < 0:
        return raw
    step = (raw - time) % period
    if step >= period // 2 and time + step >= period:
        step -= period
    return time + step


@compiled
def unwrap_times(t, time, period):
    """`next_time` for each of t: int64, updated in place. Returns the last one."""
    for i in range(t.size):
        time = next_time(time, t[i], period)
        t[i] = time
    return time


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
