"""The maps of an empty window: kept, and restored where a window has changed them.

A new window begins with these maps. So beginning a window costs a copy of what the last window
changed, and the network is computed only where the new events reach. The kept maps lie EMPTY
numbers behind the maps, see `program`.
"""

import numpy as np

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import (
    FIRST_ROW,
    LAST_ROW,
    MAX_ROW,
    WORDS,
    forget_changes,
    mark_all,
    note_rows,
)
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.simd import count_bits, trailing_zeros


@inlined
def begin_window(epoch, program, weights, maps, places):
    """Let a network show an empty window, unless it shows the window of this number already.

    Restored places are noted as changed, as `forward` notes the places that it computes.

    Parameters
    ----------
    epoch : int. The number of the window that is to be shown, see `state`.
    program, weights, maps, places : the network's, see `program`. All but the weights are updated
        in place.
    """
    if program[P.EPOCH] == epoch:
        return
    bits = places.view(np.uint64)
    if program[P.EPOCH] == 0:  # It is not known what the input shows.
        mark_all(program, P.INPUT_TOUCHED, program[P.HEIGHT], program[P.WIDTH], bits)
        for at in _steps(program):
            mark_all(program, at + P.TOUCHED, program[at + P.ROWS], program[at + P.COLUMNS], bits)
    _empty_input(program, maps, bits)
    if program[P.EMPTY_IS_KNOWN] != 0:
        for at in _steps(program):
            _restore(program, at, maps, bits)
    else:
        program[P.STALE] = 1
        forward(program, weights, maps, places)
        for at in _steps(program):
            _keep(program, at, maps)
        program[P.EMPTY_IS_KNOWN] = 1
    program[P.EPOCH] = epoch
    program[P.N_SEEN] = 0


@inlined
def _steps(program):
    """Where each step's record begins."""
    return range(P.FIRST_STEP, P.FIRST_STEP + program[P.N_STEPS] * P.STEP_SIZE, P.STEP_SIZE)


@inlined
def _empty_input(program, maps, bits):
    """Write zero to all pixels of the input that may not be zero, in the planes, too."""
    n_channels = program[P.CHANNELS]
    height = program[P.HEIGHT]
    width = program[P.WIDTH]
    touched = program[P.INPUT_TOUCHED]
    words = program[P.INPUT_TOUCHED + WORDS]
    for y in range(program[P.INPUT_TOUCHED + FIRST_ROW], program[P.INPUT_TOUCHED + LAST_ROW] + 1):
        row = program[P.INPUT] + y * program[P.INPUT_DY]
        plane = program[P.PLANES] + y * width
        n = 0
        for word in range(touched + y * words, touched + (y + 1) * words):
            n += count_bits(bits[np.uint64(word)])

        # Where many pixels have changed, all of the row is faster than pixel by pixel.
        if 4 * n > width:
            maps[row : row + width * n_channels] = 0.0
            for c in range(n_channels):
                maps[plane + c * height * width : plane + c * height * width + width] = 0.0
            continue

        for word in range(words):
            left = bits[np.uint64(touched + y * words + word)]
            while left != 0:
                x = 64 * word + trailing_zeros(left)
                for c in range(n_channels):
                    maps[np.uint64(row + x * n_channels + c)] = 0.0
                    maps[np.uint64(plane + c * height * width + x)] = 0.0
                left &= left - np.uint64(1)
    forget_changes(program, P.INPUT_TOUCHED, bits)


@inlined
def _restore(program, at, maps, bits):
    """Write the empty window's numbers to all places of a step that may have others."""
    touched = at + P.TOUCHED
    changed = at + P.CHANGED
    forget_changes(program, changed, bits)
    first = program[touched + FIRST_ROW]
    last = program[touched + LAST_ROW]
    words = program[touched + WORDS]
    n_numbers = program[at + P.GROUPS] * program[at + P.OUT_CHANNELS]
    for y in range(first, last + 1):
        for word in range(words):
            left = bits[np.uint64(program[touched] + y * words + word)]
            bits[np.uint64(program[touched] + y * words + word)] = 0
            bits[np.uint64(program[changed] + y * words + word)] = left
            while left != 0:
                x = 64 * word + trailing_zeros(left)
                _copy(program, at, maps, y, x, n_numbers, program[P.EMPTY], 0)
                left &= left - np.uint64(1)
    if last >= first:
        note_rows(program, changed, first, last)
    program[touched + FIRST_ROW] = MAX_ROW
    program[touched + LAST_ROW] = -1


@inlined
def _keep(program, at, maps):
    """Keep a step's map, which is now that of an empty window."""
    n_numbers = program[at + P.GROUPS] * program[at + P.OUT_CHANNELS]
    for y in range(program[at + P.ROWS]):
        for x in range(program[at + P.COLUMNS]):
            _copy(program, at, maps, y, x, n_numbers, 0, program[P.EMPTY])


@inlined
def _copy(program, at, maps, y, x, n_numbers, source, target):
    """Copy the numbers of a place of a step's map, or of its map of an empty window.

    source, target : int. How far the map that is read, and the one that is written, lie behind the
        step's map: 0 or EMPTY.
    """
    first = program[at + P.OUT] + y * program[at + P.OUT_DY] + x * program[at + P.OUT_DX]
    for k in range(n_numbers):
        maps[np.uint64(first + target + k)] = maps[np.uint64(first + source + k)]
