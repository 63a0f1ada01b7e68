"""Columns of events from the words of Prophesee's EVT formats.

Each kernel reads words from place `start` on for as long as there is room for all events of one
more word, and returns (events written, words read). What later words depend on is in `state`.
Events before the first word with a time (in EVT3 also with their row), as at the start of a part
cut from a longer file, have no known time or place: they are counted and skipped. A damaged vector
of events may reach beyond the 2,048 columns that the formats can say, and so beyond every sensor.

References
----------
Prophesee, Metavision documentation: data encoding formats EVT 2.0, EVT 2.1 and EVT 3.0.
"""

import numpy as np
from numba import int64, types, uint16, uint32

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled
from async_tnt.kernels.volume.records import COLUMNS

# `state`, int64
HIGH = 0  # the unwrapped high part of the time; -1: not known yet
LOW = 1  # EVT3: the low part of the time
ROW = 2  # EVT3: the row of the events that follow; -1: not known yet
BASE = 3  # EVT3: the first column of the vector that follows; -1: not known yet
POLARITY = 4  # EVT3: the polarity of vectors
UNPLACED = 5  # number of events, or of vectors of events, that were skipped
INITIAL = (-1, 0, -1, -1, 0, 0)
"""The state at a file's start."""
LAST_COLUMN = (1 << 16) - 1
"""The largest column that uint16 holds."""

# the types of words of EVT 2.0 and 2.1; an event's type is its polarity
CD_ON = 1
EVT_TIME_HIGH = 8
# the types of words of EVT 3.0
EVT_ADDR_Y = 0
EVT_ADDR_X = 2
VECT_BASE_X = 3
VECT_12 = 4
VECT_8 = 5
EVT_TIME_LOW = 6
EVT3_TIME_HIGH = 8

WORDS_32 = (types.Array(uint32, 1, "C", readonly=True), int64, int64[::1])
"""Numba's types of words of 32 bits, where to begin, and the state."""
WORDS_16 = (types.Array(uint16, 1, "C", readonly=True), *WORDS_32[1:])
"""The same for words of 16 bits."""


@compiled
def next_time(previous, raw, period):
    """The time nearest to `previous` at which a clock with this `period` shows `raw`.

    A step back of at most half a period means that events are out of order, or that a bit is wrong.
    The clock has not wrapped then, and later times are not shifted. A larger step back means that
    the clock has wrapped. A step back to a negative time counts as a long gap, because no time is
    negative.

    Parameters
    ----------
    previous : int. The unwrapped time before this one, or -1 at the start.
    raw : int. What the clock shows, in [0, period).
    period : int. The clock shows 0 again after this time.
    """
    if previous < 0:
        return raw
    step = (raw - previous) % period
    if step >= period // 2 and previous + step >= period:
        step -= period
    return previous + step


@entry_point(int64[::1], int64, int64)
def unwrap_times(t, previous, period):
    """Replace each time by its `next_time` after the one before it. Returns the last time.

    Parameters
    ----------
    t : int64. Updated in place.
    previous, period : see `next_time`.
    """
    for i in range(t.size):
        previous = next_time(previous, t[i], period)
        t[i] = previous
    return previous


@entry_point(*WORDS_32, *COLUMNS)
def decode_evt2(words, start, state, t, x, y, p):
    """32-bit words, one event each: type (4 bits), low time (6), x (11), y (11)."""
    n = 0
    i = start
    while i < words.size and n < t.size:
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= CD_ON:
            if state[HIGH] < 0:
                state[UNPLACED] += 1
            else:
                t[n] = state[HIGH] << 6 | word >> 22 & 63
                x[n] = word >> 11 & 2047
                y[n] = word & 2047
                p[n] = kind
                n += 1
        elif kind == EVT_TIME_HIGH:
            state[HIGH] = next_time(state[HIGH], word & 0xFFFFFFF, np.int64(1) << 28)
        i += 1
    return n, i


@entry_point(*WORDS_32, *COLUMNS)
def decode_evt21(words, start, state, t, x, y, p):
    """Pairs of 32-bit words, upper half first.

    The first word is as in EVT 2.0, with x in steps of 32. The second is a mask of 32 pixels.
    """
    n = 0
    i = start
    while i + 1 < words.size and n + 32 <= t.size:
        word = np.int64(words[i])
        mask = np.int64(words[i + 1])
        kind = word >> 28
        if kind <= CD_ON:
            if state[HIGH] < 0:
                state[UNPLACED] += 1
                mask = 0  # so that no event is written
            time = state[HIGH] << 6 | word >> 22 & 63
            base = word >> 11 & 2047
            for bit in range(32):
                if mask >> bit & 1:
                    t[n] = time
                    x[n] = base + bit
                    y[n] = word & 2047
                    p[n] = kind
                    n += 1
        elif kind == EVT_TIME_HIGH:
            state[HIGH] = next_time(state[HIGH], word & 0xFFFFFFF, np.int64(1) << 28)
        i += 2
    return n, i


# One function: a part of its own for vectors, even if inlined, made it 10% slower.
@entry_point(*WORDS_16, *COLUMNS)
def decode_evt3(words, start, state, t, x, y, p):  # noqa: C901
    """16-bit words: the type (4 bits), and what changed (12 bits).

    That is the row, half of the time, one pixel, or a vector of pixels.
    """
    n = 0
    i = start
    while i < words.size and n + 12 <= t.size:
        word = np.int64(words[i])
        kind = word >> 12
        value = word & 4095
        if kind == EVT_ADDR_Y:
            state[ROW] = value & 2047
        elif kind == VECT_BASE_X:
            state[BASE] = value & 2047
            state[POLARITY] = value >> 11
        elif kind == EVT_ADDR_X:
            if state[HIGH] < 0 or state[ROW] < 0:
                state[UNPLACED] += 1
            else:
                t[n] = state[HIGH] << 12 | state[LOW]
                x[n] = value & 2047
                y[n] = state[ROW]
                p[n] = value >> 11
                n += 1
        elif kind in (VECT_12, VECT_8):
            length = 12 if kind == VECT_12 else 8
            if state[HIGH] < 0 or state[ROW] < 0 or state[BASE] < 0:
                state[UNPLACED] += 1
            else:
                for bit in range(length):
                    if value >> bit & 1:
                        t[n] = state[HIGH] << 12 | state[LOW]
                        x[n] = min(state[BASE] + bit, LAST_COLUMN)
                        y[n] = state[ROW]
                        p[n] = state[POLARITY]
                        n += 1
            if state[BASE] >= 0:
                state[BASE] += length
        elif kind == EVT_TIME_LOW:
            state[LOW] = value
        elif kind == EVT3_TIME_HIGH:
            high = next_time(state[HIGH], value, np.int64(4096))
            # The new low half comes next. The old one would be up to 4 ms ahead.
            if high != state[HIGH]:
                state[LOW] = 0
            state[HIGH] = high
        i += 1
    return n, i
