"""Which places of a map have changed, a bit each, and which places of another map depend on them.

For places, maps and programs see `program`. A row of places is a row of whole uint64 words, so that
64 places are looked at together. A program's record of a map's changes has four slots: where in
`bits` they lie, the first and the last row that may have any, the words in a row.
"""

from typing import NamedTuple

import numpy as np

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.simd import trailing_zeros

# A record of a map's changes. Its first number says where in `bits` they lie.
FIRST_ROW = 1
LAST_ROW = 2
WORDS = 3  # words of 64 places in a row

MAX_ROW = 0xFFFF
"""The largest number that a row can have: FIRST_ROW where nothing has changed."""
EVERY_BIT = np.uint64(0xFFFF_FFFF_FFFF_FFFF)


class Taps(NamedTuple):
    """What a place of a map sees along one axis of another map.

    Place i sees the places i stride - padding + j dilation, for the taps j < n.
    """

    n: int
    stride: int
    padding: int
    dilation: int


@inlined
def words_of(columns):
    """Words in a row of so many places."""
    return (columns + 63) >> 6


@inlined
def forget_changes(program, record, bits):
    """Note in a record that no place of its map has changed."""
    begin = program[record] + program[record + FIRST_ROW] * program[record + WORDS]
    end = program[record] + (program[record + LAST_ROW] + 1) * program[record + WORDS]
    for word in range(begin, end):
        bits[np.uint64(word)] = 0
    program[record + FIRST_ROW] = MAX_ROW
    program[record + LAST_ROW] = -1


@inlined
def note_rows(program, record, first, last):
    """Note that the rows from `first` to `last`, both included, may have changes."""
    program[record + FIRST_ROW] = min(program[record + FIRST_ROW], first)
    program[record + LAST_ROW] = max(program[record + LAST_ROW], last)


@inlined
def mark_all(program, record, rows, columns, bits):
    """Mark every place of a map."""
    words = program[record + WORDS]
    for row in range(rows):
        for word in range(words):
            n = min(columns - 64 * word, 64)
            bits[np.uint64(program[record] + row * words + word)] = EVERY_BIT >> np.uint64(64 - n)
    note_rows(program, record, 0, rows - 1)


@inlined
def add_changes(program, record, more, bits):
    """Mark in one record what is marked in another one of the same map."""
    first = program[more + FIRST_ROW]
    last = program[more + LAST_ROW]
    words = program[more + WORDS]
    for word in range(first * words, (last + 1) * words):
        bits[np.uint64(program[record] + word)] |= bits[np.uint64(program[more] + word)]
    note_rows(program, record, first, last)


@inlined
def note_changes(bits, row, column, changed):
    """Mark places of a row, from `column` on: one for each bit of `changed` (uint64).

    `row` is where in `bits` the row lies. All of these places must lie in it.
    """
    word = np.uint64(row + (column >> 6))
    shift = np.uint64(column & 63)
    bits[word] |= changed << shift
    beyond = (changed >> np.uint64(1)) >> (np.uint64(63) - shift)
    if beyond != 0:
        bits[word + np.uint64(1)] |= beyond


@inlined
def seen_from(bits, row, word, taps):
    """Find the columns of a word that see a changed column of a row.

    Parameters
    ----------
    bits, row : where in `bits` the row that is seen lies, in a frame of zeros. The frame is as wide
        as a tap can see, and a word more.
    word : int. Which 64 columns: those from 64 word on.
    taps : Taps. What a column sees.

    Returns
    -------
    uint64 : a bit for each of the 64 columns.
    """
    n_taps, stride, padding, dilation = taps
    seen = np.uint64(0)
    # 64 columns see 64 * stride others, and the width of the kernel.
    for part in range(stride):
        start = (word * stride + part) * 64 - padding
        if dilation == 1:
            changed = np.uint64(0)
            for tap in range(0, n_taps, 64):
                changed |= _any_of_next(bits, row, start + tap, min(n_taps - tap, 64))
        else:
            changed = np.uint64(0)
            for tap in range(n_taps):
                changed |= _sixty_four(bits, row, start + tap * dilation)
        if stride == 1:
            seen = changed
        elif stride == 2:
            seen |= _even_bits(changed) << np.uint64(32 * part)
        else:
            for bit in range(-64 * part % stride, 64, stride):
                is_changed = changed >> np.uint64(bit) & np.uint64(1)
                seen |= is_changed << np.uint64((64 * part + bit) // stride)
    return seen


@inlined
def _sixty_four(bits, row, start):
    """The bits of the 64 columns from `start` on."""
    at = np.uint64(row + (start >> 6))
    shift = np.uint64(start & 63)
    return _shifted(bits[at], bits[at + np.uint64(1)], shift)


@inlined
def _any_of_next(bits, row, start, n):
    """64 bits. Bit k: whether one of the n columns from start + k on has changed, 1 <= n <= 64."""
    at = np.uint64(row + (start >> 6))
    shift = np.uint64(start & 63)
    low = _shifted(bits[at], bits[at + np.uint64(1)], shift)
    high = _shifted(bits[at + np.uint64(1)], bits[at + np.uint64(2)], shift)
    known = 1  # Bit k now says it of so many columns.
    while known < n:
        more = np.uint64(min(known, n - known))
        low |= _shifted(low, high, more)
        high |= high >> more
        known += np.int64(more)
    return low


@inlined
def _shifted(low, high, n):
    """The 64 bits from bit n < 64 on."""
    return low >> n | high << np.uint64(1) << (np.uint64(63) - n)


@inlined
def _even_bits(word):
    """A word with the bits 0, 2, 4, ... of another word side by side."""
    word &= np.uint64(0x5555_5555_5555_5555)
    word = (word | word >> np.uint64(1)) & np.uint64(0x3333_3333_3333_3333)
    word = (word | word >> np.uint64(2)) & np.uint64(0x0F0F_0F0F_0F0F_0F0F)
    word = (word | word >> np.uint64(4)) & np.uint64(0x00FF_00FF_00FF_00FF)
    word = (word | word >> np.uint64(8)) & np.uint64(0x0000_FFFF_0000_FFFF)
    return (word | word >> np.uint64(16)) & np.uint64(0x0000_0000_FFFF_FFFF)


@inlined
def list_places(seen, n_columns, row, word, places, end):
    """Append to a list the places of a word of a row whose bits are set in `seen`.

    Parameters
    ----------
    seen : uint64. A bit for each of 64 columns.
    n_columns : int. How many columns, from the word's first on, the map has.
    row, word : int. The row of the map, and which 64 columns: those from 64 word on.
    places : uint32. Places, row << 16 | column. Updated in place from `end` on.
    end : int. The list's end in `places`.

    Returns
    -------
    int : the list's new end in `places`.
    """
    first = row << 16 | word << 6
    n = min(n_columns, 64)
    every = EVERY_BIT >> np.uint64(64 - n)
    seen &= every
    if seen == every:
        for k in range(n):
            places[np.uint64(end + k)] = first + k
        return end + n
    while seen != 0:
        places[np.uint64(end)] = first + trailing_zeros(seen)
        seen &= seen - np.uint64(1)
        end += 1
    return end
