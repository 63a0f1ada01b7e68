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

# What `slide` returns.
IS_IN = 1
IS_LATE = 0


@inlined
def _place_in_ring(ints, k):
    """Where the k-th oldest event of the ring lies: its time, and its cell behind it."""
    place = ints[S.RING_FIRST] + k
    if place >= ints[S.RING_SIZE]:
        place -= ints[S.RING_SIZE]
    return ints[S.RING] + 2 * place


@inlined
def _log_cell(ints, cell):
    """Note that a cell has changed."""
    ints[ints[S.LOG] + (ints[S.N_LOG] & (ints[S.LOG_SIZE] - 1))] = cell
    ints[S.N_LOG] += 1


@inlined
def _let_oldest_leave(buffer, ints):
    """Take the oldest event of the ring from its cell."""
    code = ints[_place_in_ring(ints, 0) + 1]
    cell = code >> 1
    buffer[cell] -= buffer[S.SIGN_ON] if code & 1 else buffer[S.SIGN_OFF]
    _log_cell(ints, cell)
    ints[S.RING_N] -= 1
    ints[S.RING_FIRST] += 1
    if ints[S.RING_FIRST] == ints[S.RING_SIZE]:
        ints[S.RING_FIRST] = 0


@compiled
def slide(buffer, ints, t, x, y, p):
    """Let one event into the window, and the events out that leave for it.

    Parameters
    ----------
    buffer, ints : the volume's `state`. Updated in place.
    t, x, y, p : int. Microseconds before LIMIT_US, pixel, polarity: positive for ON.

    Returns
    -------
    int : IS_IN, or IS_LATE if the event is before the stream's first window, or would have left
        already. Then it is only counted.
    """
    ints[S.RECEIVED] += 1
    span_us = ints[S.SPAN_US]
    newest_us = max(ints[S.NEWEST_US], t)
    if t < ints[S.START_US] or (span_us > 0 and t <= newest_us - span_us):
        ints[S.LATE] += 1
        return IS_LATE
    ints[S.N] += 1
    ints[S.KEPT] += 1
    ints[S.NEWEST_US] = newest_us
    if span_us > 0:
        _let_old_leave(buffer, ints, newest_us - span_us)
    if ints[S.RING_N] == ints[S.RING_SIZE]:
        ints[S.LEFT_EARLY] += span_us > 0
        _let_oldest_leave(buffer, ints)

    cell = S.CELLS + y * ints[S.ROW] + x
    sign = buffer[S.SIGN_ON]
    code = 1
    if p <= 0:
        cell += ints[S.OFF_SHIFT]
        sign = buffer[S.SIGN_OFF]
        code = 0
    buffer[cell] += sign
    _log_cell(ints, cell)
    ints[S.INTERVAL_LO] = 0
    ints[S.INTERVAL_HI] = S.NO_INTERVAL

    k = ints[S.RING_N]
    if span_us > 0:
        # events that are newer than one that comes late move on by a place
        while k > 0 and ints[_place_in_ring(ints, k - 1)] > t:
            before = _place_in_ring(ints, k - 1)
            at = _place_in_ring(ints, k)
            ints[at] = ints[before]
            ints[at + 1] = ints[before + 1]
            k -= 1
    at = _place_in_ring(ints, k)
    ints[at] = t
    ints[at + 1] = 2 * cell + code
    ints[S.RING_N] += 1
    return IS_IN


@inlined
def _let_old_leave(buffer, ints, until_us):
    """Let the events at or before a time leave."""
    while ints[S.RING_N] > 0 and ints[_place_in_ring(ints, 0)] <= until_us:
        _let_oldest_leave(buffer, ints)


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
        ints[S.INTERVAL_LO] = 0
        ints[S.INTERVAL_HI] = S.NO_INTERVAL
        _let_old_leave(buffer, ints, now_us - ints[S.SPAN_US])
