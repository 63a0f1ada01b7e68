"""Prophesee's EVT words to columns of events.

Each kernel reads words from place `start` on for as long as there is room for all events of one
more word, and returns (events written, words read). What later words depend on is in `state`;
`INITIAL` is a file's start. Events before the first word with a time (in EVT3 also with their row),
as at the start of a part cut from a longer file, have no known time or place: they are counted and
skipped. A damaged vector of events may reach beyond the 2,048 columns that the formats can say, and
so beyond every sensor.

References
----------
Prophesee, Metavision documentation: data encoding formats EVT 2.0, EVT 2.1 and EVT 3.0.
"""

import numpy as np

from async_tnt.kernels.jit import compiled

HIGH, LOW, ROW, BASE, POLARITY, UNPLACED = range(6)
INITIAL = (-1, 0, -1, -1, 0, 0)
LAST_COLUMN = (1 << 16) - 1  # what a column of uint16 holds


@compiled
def next_time(time, raw, period):
    """The unwrapped time of a clock with this period that shows `raw`: the one nearest to the time
    before.

    A step of up to half a period back is disorder or a flipped bit, and does not shift later times.
    A larger one is a wrap. No time is negative: there was a long gap instead.

    Parameters
    ----------
    time : the unwrapped time before, or -1 at the start.
    raw : what the clock shows, in [0, period).
    """
    if time < 0:
        return raw
    step = (raw - time) % period
    if step >= period // 2 and time + step >= period:
        step -= period
    return time + step


@compiled
def unwrap_times(t, time, period):
    """`next_time` for each of t: int64, updated in place. Returns the last one."""
    for i in range(t.size):
        time = next_time(time, t[i], period)
        t[i] = time
    return time


@compiled
def decode_evt2(words, start, state, t, x, y, p):
    """32-bit words, one event each: type (4 bits), low time (6), x (11), y (11)."""
    n = 0
    i = start
    while i < words.size and n < t.size:
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= 1:
            if state[HIGH] < 0:
                state[UNPLACED] += 1
            else:
                t[n] = state[HIGH] << 6 | word >> 22 & 63
                x[n], y[n], p[n] = word >> 11 & 2047, word & 2047, kind
                n += 1
        elif kind == 8:
            state[HIGH] = next_time(state[HIGH], word & 0xFFFFFFF, np.int64(1) << 28)
        i += 1
    return n, i


@compiled
def decode_evt21(words, start, state, t, x, y, p):
    """Pairs of 32-bit words, upper half first: as EVT2's word, x in steps of 32; then a mask of 32
    pixels."""
    n = 0
    i = start
    while i + 1 < words.size and n + 32 <= t.size:
        word, mask = np.int64(words[i]), np.int64(words[i + 1])
        kind = word >> 28
        if kind <= 1:
            if state[HIGH] < 0:
                state[UNPLACED] += 1
                mask = 0
            time = state[HIGH] << 6 | word >> 22 & 63
            base = word >> 11 & 2047
            for bit in range(32):
                if mask >> bit & 1:
                    t[n], x[n], y[n], p[n] = time, base + bit, word & 2047, kind
                    n += 1
        elif kind == 8:
            state[HIGH] = next_time(state[HIGH], word & 0xFFFFFFF, np.int64(1) << 28)
        i += 2
    return n, i


@compiled
def decode_evt3(words, start, state, t, x, y, p):  # noqa: C901 (one loop: a call for each element would cost more than its work)
    """16-bit words: type (4 bits) and what changed (12): the row, half of the time, one pixel, or a
    vector."""
    n = 0
    i = start
    while i < words.size and n + 12 <= t.size:
        word = np.int64(words[i])
        kind, value = word >> 12, word & 4095
        if kind == 0:
            state[ROW] = value & 2047
        elif kind == 3:
            state[BASE], state[POLARITY] = value & 2047, value >> 11
        elif kind == 2:
            if state[HIGH] < 0 or state[ROW] < 0:
                state[UNPLACED] += 1
            else:
                t[n], x[n] = state[HIGH] << 12 | state[LOW], value & 2047
                y[n], p[n] = state[ROW], value >> 11
                n += 1
        elif kind == 4 or kind == 5:
            length = 12 if kind == 4 else 8
            if state[HIGH] < 0 or state[ROW] < 0 or state[BASE] < 0:
                state[UNPLACED] += 1
            else:
                for bit in range(length):
                    if value >> bit & 1:
                        t[n] = state[HIGH] << 12 | state[LOW]
                        x[n] = min(state[BASE] + bit, LAST_COLUMN)
                        y[n], p[n] = state[ROW], state[POLARITY]
                        n += 1
            if state[BASE] >= 0:
                state[BASE] += length
        elif kind == 6:
            state[LOW] = value
        elif kind == 8:
            high = next_time(state[HIGH], value, np.int64(4096))
            if high != state[HIGH]:
                state[LOW] = 0  # the new low half comes next; the old one would be up to 4 ms ahead
            state[HIGH] = high
        i += 1
    return n, i
