"""A block of events' displacements from their landmarks, and the sums that go on from block to block.

Each landmark has a function of its own: Numba counts references to the slices below unless a function is free
of branches, and that would cost as much as the work.
"""

import numpy as np

from . import state as S
from .jit import compiled
from .landmark import displace_fixed, displace_line, displace_raw, displace_running


@compiled
def displace(buffer, ints, t, x, y, m):
    """The displacement of each event from its landmark (see `landmark`) into NUM_X, NUM_Y, DEN.

    Parameters
    ----------
    buffer, ints : the volume's `state`; its sums are updated, N counts these events already.
    t, x, y : columns of m events, all in the window.
    """
    mode = ints[S.MODE]
    if mode == S.MODE_RUNNING:
        _displace_running(buffer, ints, t, x, y, m)
    elif mode == S.MODE_FIXED:
        _displace_fixed(buffer, ints, t, x, y, m)
    elif mode == S.MODE_RAW:
        _displace_raw(buffer, ints, x, y, m)
    else:
        _displace_line(buffer, ints, t, x, y, m, mode == S.MODE_LINE_FLOW_REMOVED)


@compiled
def _displace_running(buffer, ints, t, x, y, m):
    sums = ints[S.PREFIX : S.PREFIX + S.BLOCK]
    num_x = buffer[S.NUM_X : S.NUM_X + S.BLOCK]
    num_y = buffer[S.NUM_Y : S.NUM_Y + S.BLOCK]
    den = buffer[S.DEN : S.DEN + S.BLOCK]
    start_us = ints[S.START_US]
    n = ints[S.N] - m
    # Both sums of a block, each far below 2**32, in one number: one addition and one store.
    both = np.int64(0)
    for i in range(m):
        both += np.int64(x[i]) | np.int64(y[i]) << 32
        sums[i] = both
    sum_x = ints[S.SUM_X]
    sum_y = ints[S.SUM_Y]
    for i in range(m):
        num_x[i], num_y[i], den[i] = displace_running(
            x[i], y[i], t[i] - start_us, n + i + 1, sum_x + (sums[i] & 0xFFFFFFFF), sum_y + (sums[i] >> 32)
        )
    ints[S.SUM_X] = sum_x + (both & 0xFFFFFFFF)
    ints[S.SUM_Y] = sum_y + (both >> 32)


@compiled
def _displace_fixed(buffer, ints, t, x, y, m):
    num_x = buffer[S.NUM_X : S.NUM_X + S.BLOCK]
    num_y = buffer[S.NUM_Y : S.NUM_Y + S.BLOCK]
    den = buffer[S.DEN : S.DEN + S.BLOCK]
    start_us = ints[S.START_US]
    fixed_x = buffer[S.FIXED_X]
    fixed_y = buffer[S.FIXED_Y]
    for i in range(m):
        num_x[i], num_y[i], den[i] = displace_fixed(x[i], y[i], t[i] - start_us, fixed_x, fixed_y)
    _sum_up(ints, x, y, m)


@compiled
def _displace_raw(buffer, ints, x, y, m):
    num_x = buffer[S.NUM_X : S.NUM_X + S.BLOCK]
    num_y = buffer[S.NUM_Y : S.NUM_Y + S.BLOCK]
    den = buffer[S.DEN : S.DEN + S.BLOCK]
    for i in range(m):
        num_x[i], num_y[i], den[i] = displace_raw(x[i], y[i])
    _sum_up(ints, x, y, m)


@compiled
def _displace_line(buffer, ints, t, x, y, m, remove_flow):
    num_x = buffer[S.NUM_X : S.NUM_X + S.BLOCK]
    num_y = buffer[S.NUM_Y : S.NUM_Y + S.BLOCK]
    den = buffer[S.DEN : S.DEN + S.BLOCK]
    start_us = ints[S.START_US]
    n = ints[S.N] - m
    sum_x = ints[S.SUM_X]
    sum_y = ints[S.SUM_Y]
    sum_t = ints[S.SUM_T]
    for i in range(m):
        dt = t[i] - start_us
        sum_x += x[i]
        sum_y += y[i]
        sum_t += dt
        num_x[i], num_y[i], den[i] = displace_line(buffer, x[i], y[i], dt, n + i + 1, sum_x, sum_y, sum_t, remove_flow)
    ints[S.SUM_X] = sum_x
    ints[S.SUM_Y] = sum_y
    ints[S.SUM_T] = sum_t


@compiled
def _sum_up(ints, x, y, m):
    sum_x = np.int64(0)
    sum_y = np.int64(0)
    for i in range(m):
        sum_x += x[i]
        sum_y += y[i]
    ints[S.SUM_X] += sum_x
    ints[S.SUM_Y] += sum_y
