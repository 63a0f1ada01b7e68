"""Repair the times of a stream of packets. The rule, with an example, is in
`async_tnt.sources.live.clock`."""

import numpy as np
from numba import int64, uint8

from async_tnt.kernels.jit import compiled
from async_tnt.kernels.volume.records import MAX_TIME_US, load, store

NEWEST, NEWEST_ARRIVAL, OFFSET, CANDIDATE, CANDIDATE_ARRIVAL, VOTES, JUMPED, LATE, RESTARTS = range(
    9
)
INITIAL = (-1, 0, 0, 0, 0, 0, 0, 0, 0)
AGREEING_PACKETS = 8
BACK_US = 1_000_000  # further back, a time is a jump rather than out of order
# the same after a pause, to tell a restarted sender from a network that reorders
REORDERED_US = 20_000
# the year 2100 on a clock that counts from 1970: a stream starts before that
LATEST_START_US = 4_102_444_800_000_000
NO_LIMIT = -1
ARGUMENTS = (uint8[::1], int64, int64, int64, int64, int64, int64, int64[::1])


@compiled
def repair_times(records, start, n, size, time_at, arrival, max_jump, clock):  # noqa: C901 (one loop: a call for each element would cost more than its work)
    """Drop the events of one packet whose time jumps, and shift the others' times by the clock's
    offset.

    Parameters
    ----------
    records : uint8. Packed records; those kept move together, in place.
    start, n, size : int. First byte of the packet, its events, and bytes of one event.
    time_at : int. Offset of the time, int64 or uint64, within a record.
    arrival : int. Microseconds on the receiver's clock.
    max_jump : int. Microseconds, or NO_LIMIT: every time is accepted.
    clock : int64, shape (9,). The state between packets; updated in place. Its times are the
        sender's, without the offset.

    Returns
    -------
    int : events kept.
    """
    newest, offset = clock[NEWEST], clock[OFFSET]
    end = MAX_TIME_US - offset
    if max_jump == NO_LIMIT:
        low, high = 0, end
    elif newest < 0:
        low, high = 0, LATEST_START_US
    else:
        passed = max(arrival - clock[NEWEST_ARRIVAL], 0)
        low, high = newest - max(BACK_US - passed, REORDERED_US), newest + passed + max_jump
    if newest >= 0:  # usually no time jumps: one pass finds out
        smallest, largest, n_late = newest, newest, 0
        for i in range(n):
            t = load(records, start + i * size + time_at, np.int64)
            n_late += t < largest
            smallest, largest = min(smallest, t), max(largest, t)
        if n > 0 and max(low, 0) <= smallest and largest <= min(high, end - 1):
            for i in range(n if offset != 0 else 0):
                at = start + i * size + time_at
                store(records, at, load(records, at, np.int64) + offset, np.int64)
            clock[NEWEST], clock[VOTES] = largest, 0
            clock[LATE] += n_late
            if n_late < n:
                clock[NEWEST_ARRIVAL] = arrival
            return n

    oldest = end
    n_valid = n_plausible = 0
    for i in range(n):
        t = load(records, start + i * size + time_at, np.int64)  # a uint64 beyond int64 is negative
        if 0 <= t < end:
            n_valid += 1
            n_plausible += low <= t <= high
            oldest = min(oldest, t)

    has_moved = False
    if n_plausible > 0:
        clock[VOTES] = 0
    elif n_valid > 0:
        later = oldest - clock[CANDIDATE]
        agrees = -max_jump <= later <= max_jump + max(arrival - clock[CANDIDATE_ARRIVAL], 0)
        clock[VOTES] = clock[VOTES] + 1 if agrees else 1
        clock[CANDIDATE], clock[CANDIDATE_ARRIVAL] = oldest, arrival
        has_moved = clock[VOTES] >= AGREEING_PACKETS
    if has_moved or (newest < 0 and n_plausible > 0 and max_jump != NO_LIMIT):
        low, high = oldest, oldest + max_jump
        clock[VOTES] = 0
        if oldest < newest:
            offset += newest - oldest
            clock[RESTARTS] += 1
        newest = oldest

    low, high = max(low, 0), min(high, MAX_TIME_US - offset - 1)
    kept = n_late = 0
    for i in range(n):
        record = start + i * size
        t = load(records, record + time_at, np.int64)
        if t < low or t > high:
            continue
        n_late += t < newest
        newest = max(newest, t)
        place = start + kept * size
        if place != record:
            for b in range(size):
                records[place + b] = records[record + b]
        if offset != 0:
            store(records, place + time_at, t + offset, np.int64)
        kept += 1
    if kept > n_late:
        clock[NEWEST_ARRIVAL] = arrival
    clock[JUMPED] += n_valid - kept
    clock[LATE] += n_late
    clock[NEWEST], clock[OFFSET] = newest, offset
    return kept
