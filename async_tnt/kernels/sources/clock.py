"""Repair the times of a stream of packets.

The rule, with an example, is in `async_tnt.sources.live.clock`.
"""

import numpy as np
from numba import int64, uint8

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.volume.records import MAX_TIME_US, load, store

# The clock, int64: the state between packets. Its times are the sender's, without the offset.
NEWEST = 0  # the newest time so far; -1 before the first packet
NEWEST_ARRIVAL = 1  # when the packet with this time came, on the receiver's clock
OFFSET = 2  # added to every time
CANDIDATE = 3  # the oldest time of the packet that voted last
CANDIDATE_ARRIVAL = 4  # when that packet came
VOTES = 5  # packets in a row that agree that the clock has moved
JUMPED = 6  # events dropped because their time jumps
LATE = 7  # events older than an event before them
RESTARTS = 8  # how often the clock has moved back
INITIAL = (-1, 0, 0, 0, 0, 0, 0, 0, 0)
"""The clock before the first packet."""

AGREEING_PACKETS = 8
"""Votes in a row after which the clock counts as moved."""
BACK_US = 1_000_000
"""Microseconds. A time further back than this is a jump, and not an event out of order."""
REORDERED_US = 20_000
"""The same limit after a pause. It tells a restarted sender from a network that reorders."""
LATEST_START_US = 4_102_444_800_000_000
"""The year 2100 on a clock that counts from 1970: a stream starts before that."""
NO_LIMIT = -1
"""This number instead of a largest jump means that every time is accepted."""


@entry_point(uint8[::1], int64, int64, int64, int64, int64, int64, int64[::1])
def repair_times(records, start, n, size, time_at, arrival, max_jump, clock):
    """Drop a packet's events whose times jump, and shift the times of the kept events.

    Parameters
    ----------
    records : uint8. Packed records. The kept records are moved together, in place.
    start, n, size : int. First byte of the packet, its events, and bytes of one event.
    time_at : int. Offset of the time, int64 or uint64, within a record.
    arrival : int. Microseconds on the receiver's clock.
    max_jump : int. Microseconds, or NO_LIMIT.
    clock : int64, shape (9,), see above. Updated in place.

    Returns
    -------
    int : events kept.
    """
    newest = clock[NEWEST]
    offset = clock[OFFSET]
    end = MAX_TIME_US - offset
    low, high = _plausible_times(clock, arrival, max_jump)

    # Usually no time jumps. One pass finds out.
    if newest >= 0:
        smallest, largest, n_late = _range_of_times(records, start + time_at, n, size, newest)
        if n > 0 and max(low, 0) <= smallest and largest <= min(high, end - 1):
            if offset != 0:
                _shift_times(records, start + time_at, n, size, offset)
            clock[NEWEST] = largest
            clock[VOTES] = 0
            clock[LATE] += n_late
            if n_late < n:
                clock[NEWEST_ARRIVAL] = arrival
            return n

    n_valid, n_plausible, oldest = _count_plausible(
        records, start + time_at, n, size, low, high, end
    )
    has_moved = False
    if n_plausible > 0:
        clock[VOTES] = 0
    elif n_valid > 0:
        has_moved = _vote(clock, oldest, arrival, max_jump)
    # The clock begins again at the oldest time of this packet. Where that would take the stream's
    # times back, the offset grows instead.
    is_first = newest < 0 and n_plausible > 0 and max_jump != NO_LIMIT
    if has_moved or is_first:
        low = oldest
        high = oldest + max_jump
        clock[VOTES] = 0
        if oldest < newest:
            offset += newest - oldest
            clock[RESTARTS] += 1
        newest = oldest

    low = max(low, 0)
    high = min(high, MAX_TIME_US - offset - 1)
    n_kept, n_late, newest = _keep_between(records, start, n, size, time_at, low, high, newest)
    if offset != 0:
        _shift_times(records, start + time_at, n_kept, size, offset)
    if n_kept > n_late:
        clock[NEWEST_ARRIVAL] = arrival
    clock[JUMPED] += n_valid - n_kept
    clock[LATE] += n_late
    clock[NEWEST] = newest
    clock[OFFSET] = offset
    return n_kept


@inlined
def _plausible_times(clock, arrival, max_jump):
    """The smallest and the largest time that does not jump."""
    newest = clock[NEWEST]
    if max_jump == NO_LIMIT:
        low = 0
        high = MAX_TIME_US - clock[OFFSET]
    elif newest < 0:
        low = 0
        high = LATEST_START_US
    else:
        pause = max(arrival - clock[NEWEST_ARRIVAL], 0)
        low = newest - max(BACK_US - pause, REORDERED_US)
        high = newest + pause + max_jump
    return low, high


@inlined
def _range_of_times(records, first, n, size, newest):
    """The smallest and the largest time, `newest` included, and how many times are late.

    `first` is the first byte of the first time.
    """
    smallest = newest
    largest = newest
    n_late = 0
    for i in range(n):
        t = load(records, first + i * size, np.int64)
        n_late += t < largest
        smallest = min(smallest, t)
        largest = max(largest, t)
    return smallest, largest, n_late


@inlined
def _shift_times(records, first, n, size, offset):
    """Add the offset to all times of a packet."""
    for i in range(n):
        at = first + i * size
        store(records, at, load(records, at, np.int64) + offset, np.int64)


@inlined
def _count_plausible(records, first, n, size, low, high, end):
    """Count the times in [0, end) and the times in [low, high], and find the oldest in [0, end).

    `first` is the first byte of the first time.
    """
    n_valid = 0
    n_plausible = 0
    oldest = end
    for i in range(n):
        t = load(records, first + i * size, np.int64)
        if 0 <= t < end:  # A uint64 beyond int64 is negative.
            n_valid += 1
            n_plausible += low <= t <= high
            oldest = min(oldest, t)
    return n_valid, n_plausible, oldest


@inlined
def _keep_between(records, start, n, size, time_at, low, high, newest):
    """Move the events whose time is in [low, high] together.

    Returns
    -------
    n_kept, n_late, newest : int. Events kept, how many of them are late, and the newest time.
    """
    n_kept = 0
    n_late = 0
    for i in range(n):
        record = start + i * size
        t = load(records, record + time_at, np.int64)
        if t < low or t > high:
            continue
        n_late += t < newest
        newest = max(newest, t)
        place = start + n_kept * size
        if place != record:
            for b in range(size):
                records[place + b] = records[record + b]
        n_kept += 1
    return n_kept, n_late, newest


@inlined
def _vote(clock, oldest, arrival, max_jump):
    """Let a packet whose times all jump vote for its oldest time.

    Returns whether the clock has moved.
    """
    step = oldest - clock[CANDIDATE]
    pause = max(arrival - clock[CANDIDATE_ARRIVAL], 0)
    agrees = -max_jump <= step <= max_jump + pause
    clock[VOTES] = clock[VOTES] + 1 if agrees else 1
    clock[CANDIDATE] = oldest
    clock[CANDIDATE_ARRIVAL] = arrival
    return clock[VOTES] >= AGREEING_PACKETS
