"""Absorb events into a volume, one by one or in packets, with bit-identical results.

A packet is processed in blocks, each in four passes over arrays that stay in the first-level cache:

    count  ->  displacement from the landmark  ->  place in the volume  ->  splat

The second and third run in vector registers. One event takes the same steps in scalars. Both call
the same formulas of `landmark` and `splat`, and floating point is strict (no fastmath, no
contraction), so how a stream is cut cannot matter.

Where the landmark or the duration is known only when the volume is read, events are stored, and
replayed at that time.

Events are four columns, each an argument of its own, so some functions here have more than eight
parameters: to unpack a tuple of arrays takes Numba longer than to take the arrays.
"""

import numpy as np
from numba import float64, int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.lock import LARGE, release_gil, take_gil
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.landmark import (
    block_of,
    displace,
    displace_fixed,
    displace_line,
    displace_raw,
    displace_running,
)
from async_tnt.kernels.volume.records import COLUMNS, MAX_TIME_US
from async_tnt.kernels.volume.sliding import slide, slide_one
from async_tnt.kernels.volume.splat import add_event, combine_time, grid_of, place_event

# What `absorb_one` returns. With ABSORBED and LATE, the event has been counted.
ABSORBED = 0
# The event is older than the open window.
LATE = 1
# The event is at or after LIMIT_US. Nothing has changed.
AT_LIMIT = 2
# The event breaks a rule. Nothing has changed.
REFUSED = 3


@entry_point(S.STATE, *COLUMNS, int64, int64)
def absorb(buffer, t, x, y, p, first, last):
    """Add the events `first <= i < last` to the open window, up to the first at or after LIMIT_US.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    t, x, y, p : int64, uint16, uint16, uint8, contiguous columns. x and y are on the sensor, and p
        is 0 or 1; this is not checked here. Another thread may change the columns meanwhile, so no
        number that was tested is read a second time to find a cell.
    first, last : int. Places in the columns.

    Returns
    -------
    int : the first event not absorbed.
    """
    ints = buffer.view(np.int64)
    lock = release_gil((last - first >= LARGE) & (ints[S.WITHOUT_GIL] == 0))
    while first < last and ints[S.RING] != 0:  # a window that slides; one round
        first = slide(buffer, ints, t, x, y, p, first, last)
        last = first
    while first < last:
        m = min(S.BLOCK, last - first)
        block_t = t[first : first + m]
        oldest_us, newest_us = _load_times(buffer, block_t, ints[S.START_US], m)

        if (oldest_us >= ints[S.START_US]) & (newest_us < ints[S.LIMIT_US]):
            _count_block(buffer, ints, block_t, m, oldest_us, newest_us)
            displace(buffer, ints, block_t, x[first : first + m], y[first : first + m], m)
            _place(buffer, ints, p[first : first + m], m)
            if ints[S.COMBINE] == S.COMBINE_SUM:
                _splat(buffer, ints, m)
            else:
                _combine_times(buffer, ints, block_t, m)
            first += m
        else:
            # The block has late events, or reaches the limit: its events are added one by one.
            end = first + m
            while first < end:
                time = t[first]
                if time >= ints[S.LIMIT_US]:
                    last = first
                    break
                column = np.int64(x[first])
                row = np.int64(y[first])
                polarity = np.int64(p[first])
                _absorb_event(buffer, ints, time, column, row, polarity)
                first += 1
    take_gil(lock)
    return first


@entry_point(float64[:, ::1], int64[::1], int64[::1], *COLUMNS, int64, int64, calls=(absorb,))
def absorb_into_others(states, rows, received, t, x, y, p, first, last):
    """Add events, as `absorb` does, to each volume that has not received them yet.

    The first volume is left out, because it has absorbed the events already.

    Parameters
    ----------
    states : float64, (volumes, numbers). Each row is a volume's `state`. Updated in place.
    rows : int64. The rows of the volumes.
    received : int64. How many events each volume had received before these events.
    t, x, y, p, first, last : see `absorb`.
    """
    for k in range(1, rows.size):
        buffer = states[rows[k]]
        if buffer.view(np.int64)[S.RECEIVED] == received[k]:
            absorb(buffer, t, x, y, p, first, last)


@entry_point(S.STATE, int64, int64, int64, int64)
def absorb_one(buffer, t, x, y, p):
    """Check one event, and add it to the open window.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    t, x, y, p : int. Microseconds, pixel, and polarity: -1, 0 or 1.

    Returns
    -------
    int : ABSORBED, LATE, AT_LIMIT or REFUSED.
    """
    ints = buffer.view(np.int64)
    if (t < 0) | (t >= MAX_TIME_US) | (p < -1) | (p > 1):
        return REFUSED
    if (x < 0) | (x >= ints[S.SENSOR_W]) | (y < 0) | (y >= ints[S.SENSOR_H]):
        return REFUSED
    if t >= ints[S.LIMIT_US]:
        return AT_LIMIT
    return ABSORBED if _absorb_event(buffer, ints, t, x, y, p) else LATE


@entry_point(S.STATE, *COLUMNS, int64, int64, *COLUMNS, int64)
def store_events(buffer, t, x, y, p, first, last, stored_t, stored_x, stored_y, stored_p, n_most):
    """Count, sum and store events, for a volume that can be computed only when it is read.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place, except for its cells.
    t, x, y, p, first, last : see `absorb`.
    stored_t, stored_x, stored_y, stored_p : columns with room for these events behind those that
        the window has. Updated in place.
    n_most : int. The largest number of events that the window may hold.

    Returns
    -------
    int : the first event not absorbed (at or after LIMIT_US, or the window is full).
    """
    ints = buffer.view(np.int64)
    while first < last and ints[S.N] < n_most:
        time = t[first]
        if time >= ints[S.LIMIT_US]:
            break
        ints[S.RECEIVED] += 1
        if time < ints[S.START_US]:
            _count_late(ints, time)
        else:
            n = ints[S.N]
            stored_t[n] = time
            stored_x[n] = x[first]
            stored_y[n] = y[first]
            stored_p[n] = p[first]
            _count_event(ints, time, x[first], y[first])
        first += 1
    return first


@compiled
def _absorb_event(buffer, ints, t, x, y, p):
    """Add one event, whose time must be before LIMIT_US. Returns whether it was added.

    A late event is counted, but not added.
    """
    if ints[S.RING] != 0:
        return slide_one(buffer, ints, t, x, y, p)
    ints[S.RECEIVED] += 1
    dt = t - ints[S.START_US]
    if dt < 0:
        _count_late(ints, t)
        return False
    _count_event(ints, t, x, y)

    mode = ints[S.MODE]
    if mode == S.MODE_RUNNING:
        num_x, num_y, den = displace_running(x, y, dt, ints[S.N], ints[S.SUM_X], ints[S.SUM_Y])
    elif mode == S.MODE_FIXED:
        num_x, num_y, den = displace_fixed(x, y, dt, buffer[S.FIXED_X], buffer[S.FIXED_Y])
    elif mode == S.MODE_RAW:
        num_x, num_y, den = displace_raw(x, y)
    else:
        ints[S.SUM_T] += dt
        remove_flow = mode == S.MODE_LINE_FLOW_REMOVED
        num_x, num_y, den = displace_line(
            buffer, x, y, dt, ints[S.N], ints[S.SUM_X], ints[S.SUM_Y], ints[S.SUM_T], remove_flow
        )

    grid = grid_of(buffer, ints)
    corner, y_frac, x_frac, lower, upper, is_kept = place_event(
        grid, np.float64(dt), p > 0, num_x, num_y, den
    )
    ints[S.KEPT] += is_kept
    ints[S.TAU_ZERO] += den == 0.0
    _note_changed_bins(ints, grid, dt, dt)
    # LOG_SIZE is a power of two, so `&` gives the remainder of a division by it.
    place_in_log = ints[S.N_LOG] & (ints[S.LOG_SIZE] - 1)
    ints[ints[S.LOG] + place_in_log] = corner
    ints[S.N_LOG] += 1

    # An event that is not kept goes on without a branch: its weights are 0, see `place_event`.
    row = np.uint64(ints[S.ROW])
    second = np.uint64(ints[S.SECOND])
    if ints[S.COMBINE] == S.COMBINE_SUM:
        add_event(buffer, np.uint64(corner), row, second, y_frac, x_frac, lower, upper)
    else:
        f = np.float64(dt) / buffer[S.WINDOW_US]
        combine_time(buffer, np.uint64(corner), row, second, y_frac, x_frac, f, ints[S.COMBINE])
    return True


@inlined
def _count_event(ints, t, x, y):
    """Count and sum one event of the open window."""
    ints[S.N] += 1
    ints[S.SUM_X] += x
    ints[S.SUM_Y] += y
    ints[S.NEWEST_US] = max(ints[S.NEWEST_US], t)


@inlined
def _count_late(ints, t):
    """Count an event before the open window.

    It counts as DECIDED if its window and all windows after it were closed early, otherwise as
    LATE.
    """
    ints[S.DECIDED if t >= ints[S.DECIDED_FROM_US] else S.LATE] += 1


@compiled
def _load_times(buffer, t, start_us, m):
    """Write the times of a block, since the window's start, into DT.

    Returns
    -------
    oldest_us, newest_us : int. The least and the largest of the times `t`.
    """
    dts = block_of(buffer, S.DT)
    oldest_us = t[0]
    newest_us = oldest_us
    for i in range(m):
        time = t[i]
        oldest_us = min(oldest_us, time)
        newest_us = max(newest_us, time)
        dts[i] = np.float64(time - start_us)
    return oldest_us, newest_us


@compiled
def _count_block(buffer, ints, t, m, oldest_us, newest_us):
    """Count the events of a block that lies in the open window."""
    start_us = ints[S.START_US]
    ints[S.RECEIVED] += m
    ints[S.N] += m
    ints[S.NEWEST_US] = max(ints[S.NEWEST_US], newest_us)
    _note_changed_bins(ints, grid_of(buffer, ints), oldest_us - start_us, newest_us - start_us)
    # tau is 0 at the window's start. Without the transform there is no tau.
    if (oldest_us == start_us) & (ints[S.MODE] != S.MODE_RAW):
        for i in range(m):
            ints[S.TAU_ZERO] += t[i] == start_us


@compiled
def _place(buffer, ints, p, m):
    """Write each event's place and weights (see `splat`) into CORNER, Y_FRAC, X_FRAC, LOWER, UPPER.

    The corners go to the log, too.
    """
    num_x = block_of(buffer, S.NUM_X)
    num_y = block_of(buffer, S.NUM_Y)
    den = block_of(buffer, S.DEN)
    y_fracs = block_of(buffer, S.Y_FRAC)
    x_fracs = block_of(buffer, S.X_FRAC)
    lowers = block_of(buffer, S.LOWER)
    uppers = block_of(buffer, S.UPPER)
    corners = block_of(ints, S.CORNER)
    grid = grid_of(buffer, ints)
    n_kept = 0
    for i in range(m):
        # The row LOWER still holds DT. A second slice of that row would prevent vectorization.
        dt = lowers[i]
        corners[i], y_fracs[i], x_fracs[i], lowers[i], uppers[i], is_kept = place_event(
            grid, dt, p[i] > 0, num_x[i], num_y[i], den[i]
        )
        n_kept += is_kept
    ints[S.KEPT] += n_kept

    # The log is a ring, at least as long as a block: write up to its end, then from its beginning.
    # LOG_SIZE is a power of two, so `&` gives the remainder of a division by it.
    place_in_log = ints[S.N_LOG] & (ints[S.LOG_SIZE] - 1)
    m_to_end = min(m, ints[S.LOG_SIZE] - place_in_log)
    for i in range(m_to_end):
        ints[ints[S.LOG] + place_in_log + i] = corners[i]
    for i in range(m_to_end, m):
        ints[ints[S.LOG] + i - m_to_end] = corners[i]
    ints[S.N_LOG] += m


@compiled
def _splat(buffer, ints, m):
    """Add the placed events to the cells, in the order of their arrival."""
    corners = block_of(ints, S.CORNER)
    y_fracs = block_of(buffer, S.Y_FRAC)
    x_fracs = block_of(buffer, S.X_FRAC)
    lowers = block_of(buffer, S.LOWER)
    uppers = block_of(buffer, S.UPPER)
    row = np.uint64(ints[S.ROW])
    second = np.uint64(ints[S.SECOND])
    for i in range(m):
        corner = np.uint64(corners[i])
        add_event(buffer, corner, row, second, y_fracs[i], x_fracs[i], lowers[i], uppers[i])


@compiled
def _combine_times(buffer, ints, t, m):
    """Combine the placed events with the cells of an image of times, in the order of arrival."""
    corners = block_of(ints, S.CORNER)
    y_fracs = block_of(buffer, S.Y_FRAC)
    x_fracs = block_of(buffer, S.X_FRAC)
    row = np.uint64(ints[S.ROW])
    second = np.uint64(ints[S.SECOND])
    combine = ints[S.COMBINE]
    start_us = ints[S.START_US]
    window_us = buffer[S.WINDOW_US]
    for i in range(m):
        f = np.float64(t[i] - start_us) / window_us
        corner = np.uint64(corners[i])
        combine_time(buffer, corner, row, second, y_fracs[i], x_fracs[i], f, combine)


@inlined
def _note_changed_bins(ints, grid, oldest_dt, newest_dt):
    """Note, for the next read, which intervals may change by events between two times."""
    ints[S.INTERVAL_LO] = min(ints[S.INTERVAL_LO], np.int64(np.float64(oldest_dt) * grid.bin_scale))
    ints[S.INTERVAL_HI] = max(ints[S.INTERVAL_HI], np.int64(np.float64(newest_dt) * grid.bin_scale))
