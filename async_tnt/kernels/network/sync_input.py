"""Bring a network's input up to date, and note which places have changed.

Only places whose values differ are noted, so events that the transform dropped cost nothing
further.
"""

import numpy as np
from llvmlite import ir
from numba import float32, int64, types, uint32

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import (
    WORDS,
    add_changes,
    forget_changes,
    note_changes,
    note_rows,
)
from async_tnt.kernels.simd import count_bits, trailing_zeros, vectorized
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.readout import cell_at, row_at

VOLUME = types.Array(float32, 3, "C", readonly=True)
"""Numba's type of a volume that is given as an array."""


@entry_point(S.STATE, int64[::1], float32[::1], uint32[::1])
def sync_input(buffer, program, maps, places):
    """Copy a volume to the input, from its cells, and note which places differ.

        input[y, x, c] = cells[c, y, x], rounded to float32 as in `readout`, and never -0

    The planes (C, H, W) hold the same numbers: cells can be compared with these in vector
    registers.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    program, maps, places : the network's, see `program`, after `begin_window`. Updated in place.
    """
    ints = buffer.view(np.int64)
    bits = places.view(np.uint64)
    forget_changes(program, P.INPUT_CHANGED, bits)
    n_new = ints[S.N_LOG] - program[P.N_SEEN]
    n_numbers = program[P.CHANNELS] * program[P.HEIGHT] * program[P.WIDTH]
    if n_new * S.CELLS_PER_LOGGED <= n_numbers:
        _sync_corners(buffer, ints, program, maps, bits)
    else:
        _sync_all(buffer, ints, program, maps, bits)
    add_changes(program, P.INPUT_TOUCHED, P.INPUT_CHANGED, bits)
    program[P.N_SEEN] = ints[S.N_LOG]


@entry_point(VOLUME, int64[::1], float32[::1])
def set_input(volume, program, maps):
    """Copy an array to the input, and mark all of it as changed. The planes stay as they were.

    Parameters
    ----------
    volume : float32, shape (C, H, W).
    program, maps : the network's, see `program`. Updated in place.
    """
    n_channels, height, width = volume.shape
    step = np.uint64(n_channels)
    for y in range(height):
        for c in range(n_channels):
            source = volume[c, y]
            at = np.uint64(program[P.INPUT] + y * program[P.INPUT_DY] + c)
            for x in range(width):
                maps[at] = source[x] + np.float32(0)  # 0 where it is -0
                at += step
    program[P.EPOCH] = 0
    program[P.STALE] = 1


@inlined
def _copy_pixel(program, maps, y, x):
    """Copy a pixel's channels from the planes to the input."""
    width = program[P.WIDTH]
    n_channels = program[P.CHANNELS]
    at = np.uint64(program[P.INPUT] + y * program[P.INPUT_DY] + x * n_channels)
    plane = np.uint64(program[P.HEIGHT] * width)
    source = np.uint64(program[P.PLANES] + y * width + x)
    for c in range(n_channels):
        u = np.uint64(c)
        maps[at + u] = maps[source + u * plane]


@inlined
def _copy_row(program, maps, y):
    """Copy a row from the planes to the input.

    It is copied plane by plane, which is faster than pixel by pixel.
    """
    width = program[P.WIDTH]
    n_channels = program[P.CHANNELS]
    for c in range(n_channels):
        at = np.uint64(program[P.INPUT] + y * program[P.INPUT_DY] + c)
        source = np.uint64(program[P.PLANES] + (c * program[P.HEIGHT] + y) * width)
        for x in range(width):
            maps[at] = maps[source + np.uint64(x)]
            at += np.uint64(n_channels)


@inlined
def _sync_corners(buffer, ints, program, maps, bits):
    """Copy the cells that the events since the last call changed."""
    n_channels = program[P.CHANNELS]
    height = program[P.HEIGHT]
    width = program[P.WIDTH]
    changed = program[P.INPUT_CHANGED]
    words = program[P.INPUT_CHANGED + WORDS]
    has_slices = ints[S.SLICE_US] != 0
    for k in range(program[P.N_SEEN], ints[S.N_LOG]):
        corner = ints[ints[S.LOG] + (k & (ints[S.LOG_SIZE] - 1))]
        c0, y0, x0 = cell_at(ints, corner, has_slices)
        for c in range(c0, min(c0 + 2, n_channels)):
            for y in range(y0, min(y0 + 2, height)):
                source = np.uint64(row_at(ints, c, y, has_slices))
                plane = program[P.PLANES] + (c * height + y) * width
                for x in range(x0, min(x0 + 2, width)):
                    value = np.float32(buffer[source + np.uint64(x)]) + np.float32(0)
                    if maps[np.uint64(plane + x)] != value:
                        maps[np.uint64(plane + x)] = value
                        pixel = program[P.INPUT] + y * program[P.INPUT_DY] + x * n_channels
                        maps[np.uint64(pixel + c)] = value
                        note_changes(bits, changed + y * words, x, np.uint64(1))
                        note_rows(program, P.INPUT_CHANGED, y, y)


@compiled
def _sync_all(buffer, ints, program, maps, bits):
    """Copy all cells, row by row of the image."""
    n_channels = program[P.CHANNELS]
    height = program[P.HEIGHT]
    width = program[P.WIDTH]
    changed = program[P.INPUT_CHANGED]
    words = program[P.INPUT_CHANGED + WORDS]
    has_slices = ints[S.SLICE_US] != 0
    note_rows(program, P.INPUT_CHANGED, 0, height - 1)
    for y in range(height):
        row = changed + y * words
        for c in range(n_channels):
            at = program[P.PLANES] + (c * height + y) * width
            cells = row_at(ints, c, y, has_slices)
            if width < 8:
                note_changes(bits, row, 0, round_cells(buffer, cells, width, maps, at))
            else:
                for k in range(0, width, 8):
                    # The last eight may overlap those before. What is equal by now is not noted.
                    x = min(k, width - 8)
                    note_changes(bits, row, x, round_eight(buffer, cells + x, maps, at + x))

        n_changed = 0
        for word in range(words):
            n_changed += count_bits(bits[np.uint64(row + word)])
        if 2 * n_changed > width:
            _copy_row(program, maps, y)
        else:
            for word in range(words):
                left = bits[np.uint64(row + word)]
                while left != 0:
                    _copy_pixel(program, maps, y, 64 * word + trailing_zeros(left))
                    left &= left - np.uint64(1)


@inlined
def round_cells(buffer, cells, n, maps, at):
    """Round neighbouring cells of a row to float32, and write them to the input's planes.

    Parameters
    ----------
    buffer : float64, a volume's `state`.
    cells : int. Where in `buffer` the first cell lies.
    n : int. How many cells, at most 64.
    maps : float32. The n values from `at` on are updated in place.

    Returns
    -------
    uint64 : a bit for each value that differed.
    """
    changed = np.uint64(0)
    for x in range(n):
        value = np.float32(buffer[np.uint64(cells + x)]) + np.float32(0)  # 0 where it is -0
        changed |= np.uint64(maps[at + x] != value) << np.uint64(x)
        maps[at + x] = value
    return changed


@inlined
def round_eight_plain(buffer, cells, maps, at):
    """Round eight cells as `round_cells` does. Without vector instructions it is 3 times slower."""
    return round_cells(buffer, cells, 8, maps, at)


@vectorized(round_eight_plain, returns=types.uint64)
def round_eight(simd, buffer, cells, maps, at):
    builder = simd.builder
    singles = ir.VectorType(ir.FloatType(), 8)
    doubles = ir.VectorType(ir.DoubleType(), 8)
    value = builder.fptrunc(simd.load(buffer, cells, doubles), singles)
    value = builder.fadd(value, ir.Constant(singles, [0.0] * 8))
    differs = builder.fcmp_unordered("!=", simd.load(maps, at, singles), value)
    simd.store(value, maps, at)
    return builder.zext(builder.bitcast(differs, ir.IntType(8)), ir.IntType(64))
