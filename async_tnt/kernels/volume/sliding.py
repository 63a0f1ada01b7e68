"""Windows that slide: the last events, or those of the last microseconds.

An event that comes in is added to its cell, and stored in a ring; an event that leaves is taken
from its cell. Cells hold numbers of events, which are exact, so they are those of a window that
holds the same events alone. Both changes go to the volume's log, like any other change.

    last events         an event leaves when so many have come after it
    last microseconds   an event at t leaves when the newest time reaches t + SPAN_US

In a window of a time, the ring is in the order of times: an event that comes late is put to its
place, and is dropped if it would have left already. If the ring is full, its oldest event leaves
early, and is counted.
"""

import numpy as np
from numba import int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.volume import state as S


@inlined
def _cell_of(buffer, ints, x, y, p):
    """An event's cell, what it adds there, and both as one number for the ring."""
    cell = S.CELLS + y * ints[S.ROW] + x
    if p > 0:
        return cell, buffer[S.SIGN_ON], 2 * cell + 1
    cell += ints[S.OFF_SHIFT]
    return cell, buffer[S.SIGN_OFF], 2 * cell


@inlined
def _take(buffer, ints, code, n_log):
    """Take an event from its cell, and log the cell. Returns the log's new length."""
    cell = code >> 1
    buffer[cell] -= buffer[S.SIGN_ON] if code & 1 else buffer[S.SIGN_OFF]
    ints[ints[S.LOG] + (n_log & (ints[S.LOG_SIZE] - 1))] = cell
    return n_log + 1


@inlined
def _insert(ints, place, n, t, code):
    """Store an event that comes late among the others, in the order of times.

    place : int. Where the next event would be stored.
    n : int. Events in the ring.
    """
    ring = ints[S.RING]
    size = ints[S.RING_SIZE]
    while n > 0:
        before = place - 1 if place > 0 else size - 1
        if ints[ring + 2 * before] <= t:
            break
        ints[ring + 2 * place] = ints[ring + 2 * before]
        ints[ring + 2 * place + 1] = ints[ring + 2 * before + 1]
        place = before
        n -= 1
    ints[ring + 2 * place] = t
    ints[ring + 2 * place + 1] = code


@compiled
def slide(buffer, ints, t, x, y, p, first, last):
    """Let the events `first <= i < last` into the window, and those out that leave for them.

    An event before the stream's first window, or that would have left already, is late, and only
    counted.

    Parameters
    ----------
    buffer, ints : the volume's `state`. Updated in place.
    t, x, y, p, first, last : see `absorb.absorb`.

    Returns
    -------
    int : the first event not absorbed, at or after LIMIT_US.
    """
    # The numbers that each event changes are kept in registers, and written at the end.
    span_us = ints[S.SPAN_US]
    start_us = ints[S.START_US]
    limit_us = ints[S.LIMIT_US]
    newest_us = ints[S.NEWEST_US]
    ring = ints[S.RING]
    size = ints[S.RING_SIZE]
    oldest = ints[S.RING_FIRST]
    n = ints[S.RING_N]
    log = ints[S.LOG]
    log_mask = ints[S.LOG_SIZE] - 1
    n_log = ints[S.N_LOG]
    begin = first
    n_late = 0
    while first < last:
        time = t[first]
        if time >= limit_us:
            break
        next_newest_us = max(newest_us, time)
        # in a window of a number of events, SPAN_US is 0: none leaves for its age
        left_us = next_newest_us - span_us if span_us > 0 else np.int64(-1)
        if time < start_us or time <= left_us:
            n_late += 1
            first += 1
            continue
        if n == size:
            # Too old ones leave first. If there are none, the oldest one leaves for this event.
            while n > 0 and ints[ring + 2 * oldest] <= left_us:
                n_log = _take(buffer, ints, ints[ring + 2 * oldest + 1], n_log)
                n -= 1
                oldest = oldest + 1 if oldest + 1 < size else 0
            if n == size:
                ints[S.LEFT_EARLY] += span_us > 0
                n_log = _take(buffer, ints, ints[ring + 2 * oldest + 1], n_log)
                n -= 1
                oldest = oldest + 1 if oldest + 1 < size else 0

        cell, sign, code = _cell_of(buffer, ints, np.int64(x[first]), np.int64(y[first]), p[first])
        buffer[cell] += sign
        ints[log + (n_log & log_mask)] = cell
        n_log += 1
        place = oldest + n
        if place >= size:
            place -= size
        if span_us > 0 and time < newest_us:
            _insert(ints, place, n, time, code)
        else:
            ints[ring + 2 * place] = time
            ints[ring + 2 * place + 1] = code
        n += 1
        newest_us = next_newest_us
        first += 1

    # Nobody has read the cells meanwhile, so too old events leave now, all together. A loop at each
    # event, whose length nobody can foresee, would take as long as all the rest.
    if span_us > 0:
        while n > 0 and ints[ring + 2 * oldest] <= newest_us - span_us:
            n_log = _take(buffer, ints, ints[ring + 2 * oldest + 1], n_log)
            n -= 1
            oldest = oldest + 1 if oldest + 1 < size else 0

    n_in = first - begin - n_late
    ints[S.RECEIVED] += first - begin
    ints[S.LATE] += n_late
    ints[S.N] += n_in
    ints[S.KEPT] += n_in
    ints[S.NEWEST_US] = newest_us
    ints[S.RING_FIRST] = oldest
    ints[S.RING_N] = n
    if n_in > 0:
        _note_changed(ints)
    ints[S.N_LOG] = n_log
    return first


@inlined
def _note_changed(ints):
    """Note that cells of the one bin have changed."""
    ints[S.INTERVAL_LO] = 0
    ints[S.INTERVAL_HI] = S.NO_INTERVAL


@compiled
def slide_one(buffer, ints, t, x, y, p):
    """`slide` for one event before LIMIT_US. Returns whether it came in: it is not late.

    t, x, y, p : int. Microseconds, pixel, polarity: positive for ON.
    """
    ints[S.RECEIVED] += 1
    span_us = ints[S.SPAN_US]
    newest_us = ints[S.NEWEST_US]
    next_newest_us = max(newest_us, t)
    left_us = next_newest_us - span_us if span_us > 0 else np.int64(-1)
    if t < ints[S.START_US] or t <= left_us:
        ints[S.LATE] += 1
        return False
    ints[S.N] += 1
    ints[S.KEPT] += 1
    ints[S.NEWEST_US] = next_newest_us
    _let_leave(buffer, ints, left_us)
    if ints[S.RING_N] == ints[S.RING_SIZE]:
        ints[S.LEFT_EARLY] += span_us > 0
        _let_oldest_leave(buffer, ints)

    cell, sign, code = _cell_of(buffer, ints, x, y, p)
    buffer[cell] += sign
    _log_cell(ints, cell)
    _note_changed(ints)
    n = ints[S.RING_N]
    place = (ints[S.RING_FIRST] + n) % ints[S.RING_SIZE]
    if span_us > 0 and t < newest_us:
        _insert(ints, place, n, t, code)
    else:
        at = ints[S.RING] + 2 * place
        ints[at] = t
        ints[at + 1] = code
    ints[S.RING_N] = n + 1
    return True


@inlined
def _log_cell(ints, cell):
    """Note that a cell has changed."""
    ints[ints[S.LOG] + (ints[S.N_LOG] & (ints[S.LOG_SIZE] - 1))] = cell
    ints[S.N_LOG] += 1


@inlined
def _let_oldest_leave(buffer, ints):
    """Take the oldest event of the ring from its cell."""
    code = ints[ints[S.RING] + 2 * ints[S.RING_FIRST] + 1]
    ints[S.N_LOG] = _take(buffer, ints, code, ints[S.N_LOG])
    ints[S.RING_N] -= 1
    ints[S.RING_FIRST] += 1
    if ints[S.RING_FIRST] == ints[S.RING_SIZE]:
        ints[S.RING_FIRST] = 0


@inlined
def _let_leave(buffer, ints, left_us):
    """Let the events at or before a time leave."""
    while ints[S.RING_N] > 0 and ints[ints[S.RING] + 2 * ints[S.RING_FIRST]] <= left_us:
        _let_oldest_leave(buffer, ints)


@inlined
def oldest_us(ints):
    """The time of the oldest event of the window; the newest time if the window is empty."""
    if ints[S.RING_N] == 0:
        return max(ints[S.START_US], ints[S.NEWEST_US])
    return ints[ints[S.RING] + 2 * ints[S.RING_FIRST]]


@entry_point(S.STATE, int64)
def advance(buffer, now_us):
    """Let time pass in a window of a time: events that are too old by then leave.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    now_us : int. A time; before the newest event nothing happens.
    """
    ints = buffer.view(np.int64)
    if ints[S.SPAN_US] > 0 and ints[S.RING_N] > 0 and now_us > ints[S.NEWEST_US]:
        _note_changed(ints)
        _let_leave(buffer, ints, now_us - ints[S.SPAN_US])
