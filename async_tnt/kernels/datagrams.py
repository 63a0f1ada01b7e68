"""Bytes of datagrams to events: one pass that takes apart, checks, unwraps times, counts.

A time far ahead of the stream is no event, unless the stream itself has moved there. With `newest` the newest event
handed on, which arrived at a, and an event t that arrives at b:

    t is far ahead    iff   t > newest + (b - a) + max_jump
    t is far behind   iff   t < newest + (b - a) - FALL_US   and   t < newest

The term b - a lets a camera be still for an hour: its clock goes on. The stream has moved when `FOLLOW_AFTER` datagrams
in a row hold events that are far away and close to one another (each within max_jump of the one before), and none that
is not: from the last of them on they are the stream. One forged datagram is thus never followed, whatever it holds,
and neither are random ones. Those far behind are handed on meanwhile: being late, they close no window.

Windows only go forward. So a stream that has moved ahead keeps its times, and one that has moved back, as a sender's
does that starts anew, gets times that go on: the first event that is followed takes the time of `newest`, those after
it keep their distance to it:

    t' = t + offset,    offset += newest - t at each move back

`newest`, `elsewhere` and the bounds are in the sender's time, without the offset.
"""

# mypy: disallow-untyped-defs=False
# (Numba functions: their types are in the docstrings)

import numpy as np
from numba import int64, uint8

from .jit import compiled, inlined
from .records import MAX_TIME_US, RAW_TYPE, load

T64, T32, SPIF, SPIF_T32 = range(4)
EVENT_BYTES_OUT = 13  # of EVENT_DTYPE
NEWEST, NEWEST_ARRIVAL, OFFSET, ELSEWHERE, VOTES, LATE, MALFORMED, AHEAD, OFF_SENSOR, RESTARTS = range(10)
INITIAL = (-1, 0, 0, 0, 0, 0, 0, 0, 0, 0)
FOLLOW_AFTER = 8
FALL_US = 1_000_000  # networks change the order of datagrams by milliseconds
LATEST_START_US = 4_102_444_800_000_000  # the year 2100 on a clock that counts from 1970: a first event is before that
NO_LIMIT = -1
ARGUMENTS = (RAW_TYPE, int64, int64[::1], int64[::1], int64, int64, int64, int64, int64[::1], uint8[::1])


@inlined
def _latest_plausible(newest, newest_arrival, arrival, max_jump):
    if max_jump == NO_LIMIT:
        return MAX_TIME_US - 1
    if newest < 0:
        return LATEST_START_US
    return min(newest + max_jump + max(arrival - newest_arrival, 0), MAX_TIME_US - 1)


@inlined
def _earliest_plausible(newest, newest_arrival, arrival, max_jump):
    if max_jump == NO_LIMIT or newest < 0:
        return 0
    return min(newest + max(arrival - newest_arrival, 0) - FALL_US, newest)


@compiled
def decode_events(raw, format, ends, arrivals, n_datagrams, width, height, max_jump, state, out):
    """The good events of some datagrams, in order.

    Times of 32 bits: t = newest + the signed 32-bit difference of `time` and the low half of newest; the first one as
    it is.

    Parameters
    ----------
    raw : uint8. Datagrams of whole events, end to end.
    format : T64, T32, SPIF or SPIF_T32.
    ends : int64, shape (at least n_datagrams,). Where each ends, in events.
    arrivals : int64, as `ends`. When each came, microseconds on any clock.
    width, height : events at x >= width or y >= height are malformed.
    max_jump : int64. Microseconds, or NO_LIMIT, as for SPIF, whose times are the arrivals.
    state : int64, shape (10,). What the stream leaves for the next call; updated in place.
    out : uint8, shape (at least 13 * ends[n_datagrams - 1],). Records of `EVENT_DTYPE`; updated in place.

    Returns
    -------
    int : events written.
    """
    newest, newest_arrival, offset = state[NEWEST], state[NEWEST_ARRIVAL], state[OFFSET]
    n_out = first = n_late = n_ahead = n_off = 0
    size = 13 if format == T64 else 4 if format == SPIF else 8
    for k in range(n_datagrams):
        arrival = arrivals[k]
        earliest = _earliest_plausible(newest, newest_arrival, arrival, max_jump)
        latest = _latest_plausible(newest, newest_arrival, arrival, max_jump)
        is_here = is_elsewhere = False
        elsewhere, votes = state[ELSEWHERE], state[VOTES] + 1
        for i in range(first, ends[k]):
            at = i * size
            good = True
            if format == T64:
                t = load(raw, at, np.int64)  # beyond int64: negative
                x, y = np.int64(load(raw, at + 8, np.uint16)), np.int64(load(raw, at + 10, np.uint16))
                p = np.int64(load(raw, at + 12, np.uint8))
                good = p <= 1
            else:
                word = np.int64(load(raw, at, np.uint32))
                low = word
                if format == T32:
                    second = np.int64(load(raw, at + 4, np.uint32))
                    x, y, p = second & 0xFFFF, second >> 17, second >> 16 & 1
                else:
                    x, y, p = word >> 16 & 0x7FFF, word & 0x7FFF, word >> 15 & 1
                    good = (word >> 31 == 1) == (format == SPIF)
                    if format == SPIF_T32:
                        low = np.int64(load(raw, at + 4, np.uint32))
                if format == SPIF:
                    t = arrival
                elif newest < 0:
                    t = low
                else:
                    t = newest + ((low - newest + 0x80000000) & 0xFFFFFFFF) - 0x80000000
            if not good or t < 0 or t >= MAX_TIME_US - offset:
                continue
            if x >= width or y >= height:
                n_off += 1
                continue
            if t > latest or t < earliest:
                if abs(t - elsewhere) > max_jump:
                    votes = 1
                elsewhere, is_elsewhere = t, True
                if votes >= FOLLOW_AFTER and not is_here:  # the stream has moved there
                    is_here = True
                    if t < earliest:
                        offset += newest - t
                        newest = t
                        state[RESTARTS] += 1
                elif t > latest:
                    n_ahead += 1
                    continue
            else:
                is_here = True
            if t < newest:
                n_late += 1
            else:
                newest, newest_arrival = t, arrival
                earliest = _earliest_plausible(newest, newest_arrival, arrival, max_jump)
                latest = _latest_plausible(newest, newest_arrival, arrival, max_jump)
            t += offset
            for b in range(8):
                out[13 * n_out + b] = t >> 8 * b & 0xFF
            out[13 * n_out + 8], out[13 * n_out + 9] = x & 0xFF, x >> 8
            out[13 * n_out + 10], out[13 * n_out + 11] = y & 0xFF, y >> 8
            out[13 * n_out + 12] = p
            n_out += 1
        if is_here:
            state[VOTES] = 0
        elif is_elsewhere:
            state[ELSEWHERE], state[VOTES] = elsewhere, votes
        first = ends[k]
    state[NEWEST], state[NEWEST_ARRIVAL], state[OFFSET] = newest, newest_arrival, offset
    state[LATE] += n_late
    state[AHEAD] += n_ahead
    state[OFF_SENSOR] += n_off
    state[MALFORMED] += first - n_out
    return n_out
