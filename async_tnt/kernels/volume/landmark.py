"""Displacement: an event's position relative to its landmark, over its TNT time, in O(1) per event.

Landmarks are kept in sensor pixels, where sums are sums of whole numbers and therefore exact; the
map to the grid is linear, so it can follow later. The transform of one coordinate,

    u = (x_g - l_g) / tau + c       x_g = x (W - 1) / (Ws - 1)      tau = t_max dt / window_us

is evaluated with one division for both coordinates,

    u = numerator / denominator * SCALE_X + c       SCALE_X = (W - 1) / (Ws - 1) * window_us / t_max

    fixed      numerator = x - l          denominator = dt
    running    numerator = n x - S_x      denominator = n dt
    line       numerator = x - l_x,i      denominator = dt

where n, S_x, S_t are the count and the sums over the events so far, this one included. The running
landmark is S_x / n, and x - S_x / n = (n x - S_x) / n. `n x - S_x` is a whole number: the running
centroid itself costs no rounding. The formulas return (numerator_x, numerator_y, denominator) of an
event at x, y and dt >= 0 microseconds after the window's start. The denominator is 0 where tau is
0.

`displace` applies them to a block of events. Each landmark has a loop of its own: Numba counts
references to the slices unless a function is free of branches, and the counting would cost as much
as the work. Formulas take plain numbers, which stay in registers: `displace_line` needs nine of
them.
"""

import numpy as np

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.volume import state as S


@inlined
def block_of(array, slot):
    """A row of the scratch memory, for one number of each event of a block."""
    return array[slot : slot + S.BLOCK]


@inlined
def displace_raw(x, y):
    """The displacement without the transform: the pixel itself."""
    return np.float64(x), np.float64(y), 1.0


@inlined
def displace_fixed(x, y, dt, fixed_x, fixed_y):
    """The displacement of an event from a given landmark."""
    return np.float64(x) - fixed_x, np.float64(y) - fixed_y, np.float64(dt)


@inlined
def displace_running(x, y, dt, n, sum_x, sum_y):
    """The displacement of an event from the centroid of the events so far."""
    count = np.float64(n)
    return (
        count * np.float64(x) - np.float64(sum_x),
        count * np.float64(y) - np.float64(sum_y),
        count * np.float64(dt),
    )


@inlined
def displace_line(buffer, x, y, dt, n, sum_x, sum_y, sum_t, remove_flow):
    """The displacement of an event from the running line.

    The event is added to the line's centred sums first.

    The line is the ridge regression, with penalty 1, of x (and y) on the window fraction
    f = dt / window_us. With the penalty, a few events give nearly their centroid.

        m_x = C_xf / (C_ff + 1)         l_x = mean_x - m_x mean_f

    By Welford's update, with d_x = n x - S_x and d_f = n f - S_f,

        C_xf,n = C_xf,n-1 + (x_n - mean_x,n) (f_n - mean_f,n) n / (n - 1)
               = C_xf,n-1 + d_x d_f / (n (n - 1))

    Plain sums of x f would be simpler, but lose nine digits to cancellation in a late burst. With
    `remove_flow` the event is displaced from the line itself:

        x - l_x - m_x f = (d_x - m_x d_f) / n
    """
    window_us = buffer[S.WINDOW_US]
    count = np.float64(n)
    sum_f = np.float64(sum_t) / window_us
    d_x = count * np.float64(x) - np.float64(sum_x)
    d_y = count * np.float64(y) - np.float64(sum_y)
    d_f = (count * np.float64(dt) - np.float64(sum_t)) / window_us
    if n > 1:
        weight = d_f / (count * (count - 1.0))
        buffer[S.C_XF] += d_x * weight
        buffer[S.C_YF] += d_y * weight
        buffer[S.C_FF] += d_f * weight
    slope_x = buffer[S.C_XF] / (buffer[S.C_FF] + 1.0)
    slope_y = buffer[S.C_YF] / (buffer[S.C_FF] + 1.0)
    if remove_flow:
        return (d_x - slope_x * d_f) / count, (d_y - slope_y * d_f) / count, np.float64(dt)
    return (d_x + slope_x * sum_f) / count, (d_y + slope_y * sum_f) / count, np.float64(dt)


@inlined
def displace(buffer, ints, t, x, y, m):
    """Write the displacement of each event of a block into NUM_X, NUM_Y, DEN.

    Parameters
    ----------
    buffer, ints : the volume's `state`. Its sums are updated; N counts these events already.
    t, x, y : columns of the block's events, all in the window.
    m : int. Events in the block.
    """
    mode = ints[S.MODE]
    if mode == S.MODE_RUNNING:
        _running_block(buffer, ints, t, x, y, m)
    elif mode == S.MODE_FIXED:
        _fixed_block(buffer, ints, t, x, y, m)
    elif mode == S.MODE_RAW:
        _raw_block(buffer, ints, x, y, m)
    else:
        _line_block(buffer, ints, t, x, y, m, mode == S.MODE_LINE_FLOW_REMOVED)


@inlined
def _running_block(buffer, ints, t, x, y, m):
    """Write the displacements from the running centroid of the events up to each one."""
    packed_sums = block_of(ints, S.PREFIX)
    num_x = block_of(buffer, S.NUM_X)
    num_y = block_of(buffer, S.NUM_Y)
    den = block_of(buffer, S.DEN)
    start_us = ints[S.START_US]
    n_before = ints[S.N] - m

    # The sums of x and of y over a block share one number, because each is far below 2**32. So an
    # event takes one addition and one store.
    packed_sum = np.int64(0)
    for i in range(m):
        packed_sum += np.int64(x[i]) | np.int64(y[i]) << 32
        packed_sums[i] = packed_sum

    sum_x = ints[S.SUM_X]
    sum_y = ints[S.SUM_Y]
    for i in range(m):
        num_x[i], num_y[i], den[i] = displace_running(
            x[i],
            y[i],
            t[i] - start_us,
            n_before + i + 1,
            sum_x + (packed_sums[i] & 0xFFFFFFFF),
            sum_y + (packed_sums[i] >> 32),
        )
    ints[S.SUM_X] = sum_x + (packed_sum & 0xFFFFFFFF)
    ints[S.SUM_Y] = sum_y + (packed_sum >> 32)


@inlined
def _fixed_block(buffer, ints, t, x, y, m):
    num_x = block_of(buffer, S.NUM_X)
    num_y = block_of(buffer, S.NUM_Y)
    den = block_of(buffer, S.DEN)
    start_us = ints[S.START_US]
    fixed_x = buffer[S.FIXED_X]
    fixed_y = buffer[S.FIXED_Y]
    for i in range(m):
        num_x[i], num_y[i], den[i] = displace_fixed(x[i], y[i], t[i] - start_us, fixed_x, fixed_y)
    _add_to_sums(ints, x, y, m)


@inlined
def _raw_block(buffer, ints, x, y, m):
    num_x = block_of(buffer, S.NUM_X)
    num_y = block_of(buffer, S.NUM_Y)
    den = block_of(buffer, S.DEN)
    for i in range(m):
        num_x[i], num_y[i], den[i] = displace_raw(x[i], y[i])
    _add_to_sums(ints, x, y, m)


@inlined
def _line_block(buffer, ints, t, x, y, m, remove_flow):
    """Write the displacements from the running line, which each event first updates."""
    num_x = block_of(buffer, S.NUM_X)
    num_y = block_of(buffer, S.NUM_Y)
    den = block_of(buffer, S.DEN)
    start_us = ints[S.START_US]
    n_before = ints[S.N] - m
    sum_x = ints[S.SUM_X]
    sum_y = ints[S.SUM_Y]
    sum_t = ints[S.SUM_T]
    for i in range(m):
        dt = t[i] - start_us
        sum_x += x[i]
        sum_y += y[i]
        sum_t += dt
        num_x[i], num_y[i], den[i] = displace_line(
            buffer, x[i], y[i], dt, n_before + i + 1, sum_x, sum_y, sum_t, remove_flow
        )
    ints[S.SUM_X] = sum_x
    ints[S.SUM_Y] = sum_y
    ints[S.SUM_T] = sum_t


@inlined
def _add_to_sums(ints, x, y, m):
    sum_x = np.int64(0)
    sum_y = np.int64(0)
    for i in range(m):
        sum_x += x[i]
        sum_y += y[i]
    ints[S.SUM_X] += sum_x
    ints[S.SUM_Y] += sum_y
