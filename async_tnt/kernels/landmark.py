"""Landmarks in O(1) per event: an event's position relative to its landmark, over its TNT time.

Landmarks are kept in sensor pixels, where sums are sums of whole numbers and therefore exact; the map to the
grid is linear, so it may follow. The transform of one coordinate,

    u = (x_g - l_g) / tau + c       x_g = x (W - 1) / (Ws - 1)      tau = t_max dt / window_us

is evaluated with one division for both coordinates,

    u = numerator / denominator * SCALE_X + c       SCALE_X = (W - 1) / (Ws - 1) * window_us / t_max

    fixed      numerator = x - l          denominator = dt
    running    numerator = n x - S_x      denominator = n dt        because x - S_x / n = (n x - S_x) / n
    line       numerator = x - l_x,i      denominator = dt

where n, S_x, S_t are count and sums over the events so far, this one included. `n x - S_x` is a whole number:
the running centroid itself costs no rounding. Each function returns (numerator_x, numerator_y, denominator)
of an event at x, y and dt >= 0 microseconds after the window's start; the denominator is 0 where tau is.
"""

import numpy as np

from . import state as S
from .jit import inlined


@inlined
def displace_raw(x, y):
    """No transform: the pixel itself."""
    return np.float64(x), np.float64(y), 1.0


@inlined
def displace_fixed(x, y, dt, fixed_x, fixed_y):
    """From a landmark given from outside."""
    return np.float64(x) - fixed_x, np.float64(y) - fixed_y, np.float64(dt)


@inlined
def displace_running(x, y, dt, n, sum_x, sum_y):
    """From the centroid of the events so far."""
    count = np.float64(n)
    return (
        count * np.float64(x) - np.float64(sum_x),
        count * np.float64(y) - np.float64(sum_y),
        count * np.float64(dt),
    )


@inlined
def displace_line(buffer, x, y, dt, n, sum_x, sum_y, sum_t, remove_flow):
    """From the running ridge line of x (and y) against window fraction f = dt / window_us; takes the event
    into the line's centred sums first.

        m_x = C_xf / (C_ff + 1)         l_x = mean_x - m_x mean_f

    By Welford's update, with d_x = n x - S_x and d_f = n f - S_f,

        C_xf,n = C_xf,n-1 + (x_n - mean_x,n) (f_n - mean_f,n) n / (n - 1) = C_xf,n-1 + d_x d_f / (n (n - 1))

    Plain sums of x f would be simpler and lose nine digits to cancellation in a late burst. With
    `remove_flow` the event is displaced from the line itself: x - l_x - m_x f = (d_x - m_x d_f) / n.
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
