"""Places of a map, marked in any order and then listed row by row, each once.

A mark is a bit. A row of the map is a row of whole words, so that neighbours are marked together and empty stretches
are skipped together.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .jit import inlined

EVERY_BIT = np.uint64(0xFFFF_FFFF_FFFF_FFFF)


@inlined
def words_of(columns):
    """Words in a row of so many places."""
    return (columns + 63) >> 6


@inlined
def mark(marks, words, row, first, last):
    """Mark the columns `first` to `last` of a row.

    Parameters
    ----------
    marks : uint64. Updated in place.
    words : `words_of` the map's columns.
    """
    first_word, last_word = row * words + (first >> 6), row * words + (last >> 6)
    lower = EVERY_BIT << np.uint64(first & 63)
    upper = EVERY_BIT >> np.uint64(63 - (last & 63))
    if first_word == last_word:
        marks[np.uint64(first_word)] |= lower & upper
        return
    marks[np.uint64(first_word)] |= lower
    for word in range(first_word + 1, last_word):
        marks[np.uint64(word)] = EVERY_BIT
    marks[np.uint64(last_word)] |= upper


@inlined
def list_marked(marks, words, first_row, last_row, places, end):
    """Append the marked places of these rows to a list, row << 16 | column, and take their marks away.

    Returns
    -------
    int : the list's new end in `places`.
    """
    for row in range(first_row, last_row + 1):
        for word in range(words):
            left = marks[np.uint64(row * words + word)]
            marks[np.uint64(row * words + word)] = 0
            while left != 0:
                places[np.uint64(end)] = (row << 16 | word << 6) + trailing_zeros(left)
                left &= left - np.uint64(1)
                end += 1
    return end


@intrinsic
def trailing_zeros(typingctx, word):
    """The number of the lowest bit set in a uint64; there must be one."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return (types.int64(word), codegen) if word == types.uint64 else None
