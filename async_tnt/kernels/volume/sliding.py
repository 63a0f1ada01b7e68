"""Windows that slide: the last events, or those of the last microseconds.

An event that comes in is added to its cell, and stored in a ring; an event that leaves is taken
from its cell. Cells hold numbers of events, which are exact, so they are those of a window that
holds the same events alone. Both changes go to the volume's log, like any other change.

    last events         an event leaves when so many have come after it
    last microseconds   an event at t leaves when the newest time reaches t + SPAN_US
    the same in slices  an event leaves with its slice, see `slices`

In a window of a time, the ring is in the order of times: an event that comes late is put to its
place, and is dropped if it would have left already. If the ring is full, its oldest event leaves
early, and is counted.
"""

import numpy as np
from numba import int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.slices import begin_slice_of, newest_slice, plane_of, slice_of


@inlined
def _cell_of(buffer, ints, plane, x, y, p):
    """An event's cell, what it adds there, and both as one number for the ring.

    plane : int. Where the plane of the event's slice begins; 0 without slices.
    """
    cell = S.CELLS + plane + y * ints[S.ROW] + x
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
    """Add the events `first <= i < last` to the window, and take out the events that leave it.

    Parameters and result are those of `_slide_in_slice`, but this goes on through all slices.
    """
    first = _slide_in_slice(buffer, ints, t, x, y, p, first, last)
    while first < last:
        time = t[first]
        if time >= ints[S.LIMIT_US]:
            break
        begin_slice_of(ints, time)
        first = _slide_in_slice(buffer, ints, t, x, y, p, first, last)
    return first


@compiled
def _slide_in_slice(buffer, ints, t, x, y, p, first, last):
    """Do what `slide` does, but only up to the first event of a later slice, if there are slices.

    An event is late if it is before the stream's first window, or would have left the window
    already. A late event is counted, but not added.

    Parameters
    ----------
    buffer, ints : the volume's `state`. Updated in place.
    t, x, y, p, first, last : see `absorb.absorb`.

    Returns
    -------
    int : the first event not absorbed, at or after LIMIT_US, or in a later slice.
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
    plane, slice_begin_us, left_us = newest_slice(ints)
    if ints[S.SLICE_US] != 0:
        limit_us = min(limit_us, slice_begin_us + ints[S.SLICE_US])
    # in a window of a number of events, SPAN_US is 0: none leaves for its age
    leaves_by_age = (span_us > 0) & (ints[S.SLICE_US] == 0)
    begin = first
    n_late = 0
    while first < last:
        time = t[first]
        if time >= limit_us:
            break
        next_newest_us = max(newest_us, time)
        if leaves_by_age:
            left_us = next_newest_us - span_us
        if time < start_us or time <= left_us:
            n_late += 1
            first += 1
            continue
        if n == size:
            # The oldest event leaves for this one: because it is too old anyway, or early.
            ints[S.LEFT_EARLY] += (span_us > 0) & (ints[ring + 2 * oldest] > left_us)
            n_log = _take(buffer, ints, ints[ring + 2 * oldest + 1], n_log)
            n -= 1
            oldest = oldest + 1 if oldest + 1 < size else 0

        own_plane = plane if time >= slice_begin_us else plane_of(ints, slice_of(ints, time))
        column = np.int64(x[first])
        row = np.int64(y[first])
        cell, sign, code = _cell_of(buffer, ints, own_plane, column, row, p[first])
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
    if leaves_by_age:
        left_us = newest_us - span_us
    oldest, n, n_log = _let_out(buffer, ints, ring, size, oldest, n, n_log, left_us)

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
def _let_one_out(buffer, ints, ring, size, oldest, n, n_log):
    """Take the oldest event of the ring from its cell.

    Parameters
    ----------
    ring, size, oldest, n, n_log : int. RING, RING_SIZE, RING_FIRST, RING_N and N_LOG, which are
        not read from `ints`.

    Returns
    -------
    oldest, n, n_log : int, as they are now.
    """
    n_log = _take(buffer, ints, ints[ring + 2 * oldest + 1], n_log)
    oldest = oldest + 1 if oldest + 1 < size else 0
    return oldest, n - 1, n_log


@inlined
def _let_out(buffer, ints, ring, size, oldest, n, n_log, left_us):
    """Take all events at or before `left_us` from their cells, see `_let_one_out`."""
    while n > 0 and ints[ring + 2 * oldest] <= left_us:
        oldest, n, n_log = _let_one_out(buffer, ints, ring, size, oldest, n, n_log)
    return oldest, n, n_log


@inlined
def _note_changed(ints):
    """Note that cells of any bin have changed."""
    ints[S.INTERVAL_LO] = 0
    ints[S.INTERVAL_HI] = S.NO_INTERVAL


@compiled
def slide_one(buffer, ints, t, x, y, p):
    """Add one event, whose time must be before LIMIT_US, to a window that slides, in any slice.

    Events that leave the window are taken out. Returns whether the event was added.

    t, x, y, p : int. Microseconds, pixel, polarity: positive for ON.
    """
    ints[S.RECEIVED] += 1
    span_us = ints[S.SPAN_US]
    newest_us = ints[S.NEWEST_US]
    next_newest_us = max(newest_us, t)
    begin_slice_of(ints, t)
    plane, slice_begin_us, left_us = newest_slice(ints)
    if span_us > 0 and ints[S.SLICE_US] == 0:
        left_us = next_newest_us - span_us
    if t < ints[S.START_US] or t <= left_us:
        ints[S.LATE] += 1
        return False
    ints[S.N] += 1
    ints[S.KEPT] += 1
    ints[S.NEWEST_US] = next_newest_us
    ring = ints[S.RING]
    size = ints[S.RING_SIZE]
    oldest, n, n_log = _let_out(
        buffer, ints, ring, size, ints[S.RING_FIRST], ints[S.RING_N], ints[S.N_LOG], left_us
    )
    if n == size:
        ints[S.LEFT_EARLY] += span_us > 0
        oldest, n, n_log = _let_one_out(buffer, ints, ring, size, oldest, n, n_log)

    if t < slice_begin_us:
        plane = plane_of(ints, slice_of(ints, t))
    cell, sign, code = _cell_of(buffer, ints, plane, x, y, p)
    buffer[cell] += sign
    ints[ints[S.LOG] + (n_log & (ints[S.LOG_SIZE] - 1))] = cell
    ints[S.N_LOG] = n_log + 1
    _note_changed(ints)
    place = (oldest + n) % size
    if span_us > 0 and t < newest_us:
        _insert(ints, place, n, t, code)
    else:
        at = ring + 2 * place
        ints[at] = t
        ints[at + 1] = code
    ints[S.RING_FIRST] = oldest
    ints[S.RING_N] = n + 1
    return True


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
    if ints[S.SPAN_US] == 0 or ints[S.RING_N] == 0 or now_us <= ints[S.NEWEST_US]:
        return
    begin_slice_of(ints, now_us)
    _, _, left_us = newest_slice(ints)
    if ints[S.SLICE_US] == 0:
        left_us = now_us - ints[S.SPAN_US]
    _note_changed(ints)
    ring = ints[S.RING]
    size = ints[S.RING_SIZE]
    oldest, n, n_log = _let_out(
        buffer, ints, ring, size, ints[S.RING_FIRST], ints[S.RING_N], ints[S.N_LOG], left_us
    )
    ints[S.RING_FIRST] = oldest
    ints[S.RING_N] = n
    ints[S.N_LOG] = n_log
