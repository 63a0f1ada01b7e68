"""Absorb events into a volume, one by one or in packets, with bit-identical results.

A packet is processed in blocks, each in four passes over arrays that stay in the first-level cache:

    count  ->  displacement from the landmark  ->  place in the volume  ->  splat

The second and third run in vector registers. One event takes the same steps in scalars. Both call
the same formulas of `landmark` and `splat`, and floating point is strict (no fastmath, no
contraction), so how a stream is cut cannot matter.

Where the landmark or the duration is known only when the volume is read, events are stored, and
replayed at that time.
"""

import numpy as np

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
from async_tnt.kernels.volume.records import MAX_TIME_US
from async_tnt.kernels.volume.splat import add_event, combine_time, grid_of, place_event

# what absorb_one returns; up to LATE, the event has been counted
ABSORBED, LATE, AT_LIMIT, REFUSED = range(4)


@compiled
def absorb(buffer, t, x, y, p, first, last):
    """Add the events `first <= i < last` to the open window, up to the first at or after LIMIT_US.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    t, x, y, p : int64, uint16, uint16, uint8, contiguous; x, y on the sensor, p in {0, 1}. Not
        checked here. Another thread may change them meanwhile: no number that was tested is read a
        second time to find a cell.

    Returns
    -------
    int : the first event not absorbed.
    """
    ints = buffer.view(np.int64)
    lock = release_gil((last - first >= LARGE) & (ints[S.WITHOUT_GIL] == 0))
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
        else:  # late events, or the limit: one by one
            end = first + m
            while first < end:
                time = t[first]
                if time >= ints[S.LIMIT_US]:
                    last = first
                    break
                _absorb_event(
                    buffer, ints, time, np.int64(x[first]), np.int64(y[first]), np.int64(p[first])
                )
                first += 1
    take_gil(lock)
    return first


@compiled
def absorb_one(buffer, t, x, y, p):
    """Check and add one event: ABSORBED; LATE, counted alone; AT_LIMIT or REFUSED (it breaks a
    rule), with nothing changed."""
    ints = buffer.view(np.int64)
    if (t < 0) | (t >= MAX_TIME_US) | (p < -1) | (p > 1):
        return REFUSED
    if (x < 0) | (x >= ints[S.SENSOR_W]) | (y < 0) | (y >= ints[S.SENSOR_H]):
        return REFUSED
    if t >= ints[S.LIMIT_US]:
        return AT_LIMIT
    return ABSORBED if _absorb_event(buffer, ints, t, x, y, p) else LATE


@compiled
def store_events(buffer, t, x, y, p, first, last, stored_t, stored_x, stored_y, stored_p, n_most):
    """`absorb` for a volume that can be made only when it is read: count, sum, and store the
    events.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place, except for its cells.
    t, x, y, p, first, last : as for `absorb`.
    stored_t, stored_x, stored_y, stored_p : columns, with room for them. Updated in place, behind
        the window's events.
    n_most : int. Events that the window holds at most.

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
    """Add one event before LIMIT_US; False if it is late, and only counted."""
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
    corner, y_frac, x_frac, lower, upper, keep = place_event(
        grid, np.float64(dt), p > 0, num_x, num_y, den
    )
    ints[S.KEPT] += keep
    ints[S.TAU_ZERO] += den == 0.0
    _note_changed_bins(ints, grid, dt, dt)
    ints[ints[S.LOG] + (ints[S.N_LOG] & (ints[S.LOG_SIZE] - 1))] = corner
    ints[S.N_LOG] += 1
    row, second = np.uint64(ints[S.ROW]), np.uint64(ints[S.SECOND])
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
    """Count an event before the open window: as DECIDED if all windows from its own on were closed
    early."""
    ints[S.DECIDED if t >= ints[S.DECIDED_FROM_US] else S.LATE] += 1


@compiled
def _load_times(buffer, t, start_us, m):
    """The times of a block since the window's start into DT. Returns the oldest and the newest of
    them."""
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
    if (oldest_us == start_us) & (ints[S.MODE] != S.MODE_RAW):
        for i in range(m):
            ints[S.TAU_ZERO] += t[i] == start_us


@compiled
def _place(buffer, ints, p, m):
    """Each event's place and weights (see `splat`) into CORNER, Y_FRAC, X_FRAC, LOWER, UPPER."""
    num_x, num_y, den = (
        block_of(buffer, S.NUM_X),
        block_of(buffer, S.NUM_Y),
        block_of(buffer, S.DEN),
    )
    y_fracs, x_fracs = block_of(buffer, S.Y_FRAC), block_of(buffer, S.X_FRAC)
    lowers, uppers = block_of(buffer, S.LOWER), block_of(buffer, S.UPPER)
    corners = block_of(ints, S.CORNER)
    grid = grid_of(buffer, ints)
    n_kept = 0
    for i in range(m):
        # DT, by the name under which it is overwritten: a second slice would prevent vectorization
        dt = lowers[i]
        corners[i], y_fracs[i], x_fracs[i], lowers[i], uppers[i], keep = place_event(
            grid, dt, p[i] > 0, num_x[i], num_y[i], den[i]
        )
        n_kept += keep
    ints[S.KEPT] += n_kept
    # the log is a ring, longer than a block: first up to its end, then from its beginning
    at = ints[S.N_LOG] & (ints[S.LOG_SIZE] - 1)
    m_to_end = min(m, ints[S.LOG_SIZE] - at)
    for i in range(m_to_end):
        ints[ints[S.LOG] + at + i] = corners[i]
    for i in range(m_to_end, m):
        ints[ints[S.LOG] + i - m_to_end] = corners[i]
    ints[S.N_LOG] += m


@compiled
def _splat(buffer, ints, m):
    """Add the placed events to the cells, in the order of their arrival."""
    corners = block_of(ints, S.CORNER)
    y_fracs, x_fracs = block_of(buffer, S.Y_FRAC), block_of(buffer, S.X_FRAC)
    lowers, uppers = block_of(buffer, S.LOWER), block_of(buffer, S.UPPER)
    row, second = np.uint64(ints[S.ROW]), np.uint64(ints[S.SECOND])
    for i in range(m):
        add_event(
            buffer, np.uint64(corners[i]), row, second, y_fracs[i], x_fracs[i], lowers[i], uppers[i]
        )


@compiled
def _combine_times(buffer, ints, t, m):
    """`_splat` for images of times."""
    corners = block_of(ints, S.CORNER)
    y_fracs, x_fracs = block_of(buffer, S.Y_FRAC), block_of(buffer, S.X_FRAC)
    row, second, combine = np.uint64(ints[S.ROW]), np.uint64(ints[S.SECOND]), ints[S.COMBINE]
    start_us, window_us = ints[S.START_US], buffer[S.WINDOW_US]
    for i in range(m):
        f = np.float64(t[i] - start_us) / window_us
        combine_time(buffer, np.uint64(corners[i]), row, second, y_fracs[i], x_fracs[i], f, combine)


@inlined
def _note_changed_bins(ints, grid, oldest_dt, newest_dt):
    """Note which intervals events between two times may change, for the next read."""
    ints[S.INTERVAL_LO] = min(ints[S.INTERVAL_LO], np.int64(np.float64(oldest_dt) * grid.bin_scale))
    ints[S.INTERVAL_HI] = max(ints[S.INTERVAL_HI], np.int64(np.float64(newest_dt) * grid.bin_scale))
