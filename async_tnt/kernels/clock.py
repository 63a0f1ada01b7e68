"""Repair the times of a stream of packets. `async_tnt.sources.clock` states the rule, with an example."""

import numpy as np
from numba import int64, uint8

from .jit import compiled
from .records import MAX_TIME_US, load, store

NEWEST, NEWEST_ARRIVAL, OFFSET, CANDIDATE, VOTES, JUMPED, LATE, RESTARTS = range(8)
INITIAL = (-1, 0, 0, 0, 0, 0, 0, 0)
AGREEING_PACKETS = 8
BACK_US = 1_000_000  # further back, a time is a jump rather than out of order
REORDERED_US = 20_000  # the same after a pause, which tells a sender that starts again from a network that reorders
LATEST_START_US = 4_102_444_800_000_000  # the year 2100 on a clock that counts from 1970: a stream starts before that
NO_LIMIT = -1
ARGUMENTS = (uint8[::1], int64, int64, int64, int64, int64, int64, int64[::1])


@compiled
def repair_times(records, start, n, size, time_at, arrival, max_jump, clock):
    """Drop the events of one packet whose time jumps, and shift the others' times by the clock's offset.

    Parameters
    ----------
    records : uint8. Packed records; those kept move together, in place.
    start, n, size : int. First byte of the packet, its events, and bytes of one event.
    time_at : int. Offset of the time, int64 or uint64, within a record.
    arrival : int. Microseconds on the receiver's clock.
    max_jump : int. Microseconds, or NO_LIMIT: every time is believed.
    clock : int64, shape (8,). What the stream leaves for the next packet; updated in place. Its times are the sender's,
        without the offset.

    Returns
    -------
    int : events kept.
    """
    newest, offset = clock[NEWEST], clock[OFFSET]
    if max_jump == NO_LIMIT:
        low, high = 0, MAX_TIME_US
    elif newest < 0:
        low, high = 0, LATEST_START_US
    else:
        passed = max(arrival - clock[NEWEST_ARRIVAL], 0)
        low, high = newest - max(BACK_US - passed, REORDERED_US), newest + passed + max_jump
    oldest = MAX_TIME_US
    plausible = 0
    for i in range(n):
        t = load(records, start + i * size + time_at, np.int64)  # a uint64 beyond int64 is negative
        if 0 <= t < MAX_TIME_US - offset:
            oldest = min(oldest, t)
            plausible += low <= t <= high

    has_moved = False
    if plausible > 0:
        clock[VOTES] = 0
    elif oldest < MAX_TIME_US:
        clock[VOTES] = clock[VOTES] + 1 if abs(oldest - clock[CANDIDATE]) <= max_jump else 1
        clock[CANDIDATE] = oldest
        has_moved = clock[VOTES] >= AGREEING_PACKETS
    if has_moved or (newest < 0 and plausible > 0 and max_jump != NO_LIMIT):
        low, high = oldest, oldest + max_jump
        clock[VOTES] = 0
        if oldest < newest:
            offset += newest - oldest
            clock[RESTARTS] += 1
        newest = oldest

    kept = 0
    for i in range(n):
        record = start + i * size
        t = load(records, record + time_at, np.int64)
        if t < 0 or t >= MAX_TIME_US - offset:
            continue
        if t < low or t > high:
            clock[JUMPED] += 1
            continue
        if t < newest:
            clock[LATE] += 1
        else:
            newest = t
            clock[NEWEST_ARRIVAL] = arrival
        place = start + kept * size
        if place != record:
            for b in range(size):
                records[place + b] = records[record + b]
        if offset != 0:
            store(records, place + time_at, t + offset, np.int64)
        kept += 1
    clock[NEWEST], clock[OFFSET] = newest, offset
    return kept
