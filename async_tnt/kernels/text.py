"""Rows of numbers in text to columns of events, in integers throughout: no float rounds a time."""

import numpy as np

from .jit import compiled
from .records import MAX_TIME_US

DONE, FULL, ODD = 0, 1, 2
T, X, Y, P, SKIPPED = 0, 1, 2, 3, -1
BLANKS = 0  # as `separator`: one or more spaces or tabs
MAX_DIGITS = 18  # always fits in int64


@compiled
def _whole_number(data, pos, decimals):  # noqa: C901 (one loop: a call for each element would cost more than its work)
    """Read a decimal number times 10**decimals, as an integer; `1.5`, `-3`, `2e-3`.

    With decimals, the nearest integer (a half: upwards); without, only an integer is a valid number.

    Returns
    -------
    (value, position after the number, whether it is valid)
    """
    negative = data[pos] == 45  # -
    if negative or data[pos] == 43:  # +
        pos += 1
    digits = np.int64(0)
    n_digits = 0
    shift = decimals  # the value is digits * 10**shift
    n_seen = 0
    lost = False  # there are digits beyond the first 18
    after_point = False
    while True:
        c = data[pos]
        if 48 <= c <= 57:
            n_seen += 1
            if n_digits < MAX_DIGITS:
                digits = digits * 10 + (c - 48)
                if digits > 0:
                    n_digits += 1
                if after_point:
                    shift -= 1
            else:
                lost = lost or c != 48
                if not after_point:
                    shift += 1
        elif c == 46 and not after_point:  # .
            after_point = True
        else:
            break
        pos += 1
    if n_seen == 0:
        return np.int64(0), pos, False
    if data[pos] == 101 or data[pos] == 69:  # e E
        pos += 1
        small = data[pos] == 45
        if small or data[pos] == 43:
            pos += 1
        exponent = 0
        n_seen = 0
        while 48 <= data[pos] <= 57:
            exponent = min(exponent * 10 + (data[pos] - 48), 10_000)
            n_seen += 1
            pos += 1
        if n_seen == 0:
            return np.int64(0), pos, False
        shift += -exponent if small else exponent
    if lost and shift >= 0:  # beyond 30,000 years: not exact, so not valid
        return np.int64(0), pos, False
    while shift > 0 and digits > 0:
        if digits > MAX_TIME_US // 10:
            return np.int64(0), pos, False
        digits *= 10
        shift -= 1
    if shift < 0:
        power = np.int64(1)
        for _ in range(min(-shift, MAX_DIGITS)):
            power *= 10
        rest = digits % power if -shift <= MAX_DIGITS else digits
        digits = digits // power if -shift <= MAX_DIGITS else np.int64(0)
        if decimals == 0 and (rest > 0 or lost):
            return np.int64(0), pos, False
        if -shift <= MAX_DIGITS and rest >= power - rest:
            digits += 1
    return -digits if negative else digits, pos, True


@compiled
def _truth(data, pos):
    """Polarity as `True` or `False`: (1 or 0, position after it, whether it is valid)."""
    start = pos
    while 65 <= data[pos] <= 90 or 97 <= data[pos] <= 122:
        pos += 1
    lower = data[start:pos] | 32
    if lower.size == 4 and lower[0] == 116 and lower[1] == 114 and lower[2] == 117 and lower[3] == 101:
        return np.int64(1), pos, True
    if lower.size == 5 and lower[0] == 102 and lower[1] == 97 and lower[2] == 108 and lower[3] == 115:
        return np.int64(0), pos, lower[4] == 101
    return np.int64(0), pos, False


@compiled
def parse_rows(data, start, end, roles, separator, decimals, seen, t, x, y, p):  # noqa: C901 (one loop: a call for each element would cost more than its work)
    """Parse rows of text into columns.

    Parameters
    ----------
    data : uint8, the text. data[end - 1] must be a line end: it stops every loop.
    start, end : the part to parse, whole rows.
    roles : int64, T, X, Y, P or SKIPPED for each column of a row.
    separator : the character between columns, or BLANKS.
    decimals : of t: 6 for seconds into microseconds.
    seen : int64 of length 2, whether a polarity 0, and one of -1, has been seen. Updated in place.
    t, x, y, p : columns. Written from place 0 on.

    Returns
    -------
    (rows written, position of the first row not written, DONE | FULL: no more room | ODD: that row is not an event)
    """
    n = 0
    pos = start
    while pos < end:
        row = pos
        while data[pos] == 32 or data[pos] == 13 or (data[pos] == 9 and separator != 9):
            pos += 1
        if data[pos] == 10:
            pos += 1
            continue
        if data[pos] == 35 or data[pos] == 37:  # a comment: # or %
            while data[pos] != 10:
                pos += 1
            pos += 1
            continue
        if n == t.size:
            return n, row, FULL
        time, column_x, column_y, polarity = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
        for i in range(roles.size):
            while data[pos] == 32 or (data[pos] == 9 and separator != 9):
                pos += 1
            role = roles[i]
            if role == SKIPPED:
                while data[pos] != 10 and data[pos] != separator:
                    pos += 1
            else:
                if role == P and data[pos] >= 65:
                    value, pos, is_number = _truth(data, pos)
                else:
                    value, pos, is_number = _whole_number(data, pos, decimals if role == T else 0)
                if not is_number:
                    return n, row, ODD
                if role == T:
                    time = value
                elif role == X:
                    column_x = value
                elif role == Y:
                    column_y = value
                else:
                    polarity = value
            ends_with = data[pos]
            while data[pos] == 32 or data[pos] == 13 or (data[pos] == 9 and separator != 9):
                pos += 1
            if i == roles.size - 1:
                if data[pos] != 10:
                    return n, row, ODD
                pos += 1
            elif separator == BLANKS:
                if ends_with != 32 and ends_with != 9:
                    return n, row, ODD
            else:
                if data[pos] != separator:
                    return n, row, ODD
                pos += 1
        fits = 0 <= time < MAX_TIME_US and 0 <= column_x < 65536 and 0 <= column_y < 65536 and -1 <= polarity <= 1
        if polarity < 1 and fits:
            seen[-polarity] = 1
            fits = seen[0] + seen[1] < 2  # 0/1 or -1/+1, not both
        if not fits:
            return n, row, ODD
        t[n], x[n], y[n], p[n] = time, column_x, column_y, polarity > 0
        n += 1
    return n, pos, DONE
