"""A network, step by step, where it is out of date.

Each step lists the places that a change reaches, computes them, keeps those whose bits differ, and hands their list to
the steps that read them. With everything out of date this is the plain forward pass. There is no second implementation
of it, so an update and a whole pass cannot differ in a bit.
"""

import numpy as np

from . import program as P
from .jit import compiled, compiled_without_gil, inlined
from .marks import list_marked, mark, words_of
from .simd import LANES
from .tiles import PLACES, max_tile, mix_tile_1, mix_tile_2, sum_tile


@compiled_without_gil
def forward(program, weights, maps, places):
    """Bring the output up to date with the input.

    Parameters
    ----------
    program, weights, maps, places : the network's, see `program`. All but the weights are updated in place.
    """
    for step in range(program[P.N_STEPS]):
        at = P.FIRST_STEP + step * P.STEP_SIZE
        n = _list_dirty(program, at, places)
        program[at + P.N_COMPUTED] = n
        if n == 0:
            program[at + P.CHANGED + 1] = 0
        elif program[at + P.KIND] == P.MIX:
            _mix(program, at, n, weights, maps, places)
        else:
            _by_channel(program, at, n, weights, maps, places)
    program[P.STALE] = 0


@compiled
def _mix(program, at, n, weights, maps, places):
    """A convolution at the n places of the list."""
    first_group, n_groups = program[at + P.WEIGHTS], program[at + P.GROUPS]
    channels, columns = program[at + P.OUT_CHANNELS], program[at + P.COLUMNS]
    n_products = program[at + P.N_RUNS] * program[at + P.RUN_LENGTH]
    places[np.uint64(program[P.LIST] + n)] = places[np.uint64(program[P.LIST] + n - 1)]  # a tile may have one too many
    n_changed = 0
    k = 0
    while k < n:
        listed = program[P.LIST] + k
        n_places = 1
        block = first_group
        if program[at + P.PLACE_WEIGHTS] == 0:
            n_places = _tile_size(n - k)
        else:
            place = np.int64(places[listed])
            block += ((place >> 16) * columns + (place & 0xFFFF)) * program[at + P.PLACE_WEIGHTS]
        changed = np.int64(0)
        for group in range(n_groups):
            inputs = program[at + P.IN] + group * program[at + P.GROUP_CHANNELS]
            for f in range(0, channels, 2 * LANES):
                left = channels - f
                output = program[at + P.OUT] + group * channels + f
                if left > LANES:
                    size = min(left, 2 * LANES)
                    changed |= mix_tile_2(
                        program, at, places, listed, n_places, maps, inputs, output, weights, block, size
                    )
                    block += (n_products + 2) * 2 * LANES + LANES
                else:
                    changed |= mix_tile_1(
                        program, at, places, listed, n_places, maps, inputs, output, weights, block, left
                    )
                    block += (n_products + 2) * LANES + LANES
        n_changed = _keep_changed(program, at, places, listed, min(n_places, n - k), changed, n_changed)
        k += n_places
    program[at + P.CHANGED + 1] = n_changed


@inlined
def _tile_size(n):
    """How many of n places the next tile computes: one of `SIZES`, at most one more than n."""
    if PLACES == 12 and n >= 11:
        return 12
    if PLACES == 12 and n >= 7:
        return 8
    if n >= 5:
        return 6
    return 4 if n >= 3 else n


@compiled
def _by_channel(program, at, n, weights, maps, places):
    """A sum or maximum of each channel, at the n places of the list."""
    n_changed = 0
    is_sum = program[at + P.KIND] == P.SUM
    for listed in range(program[P.LIST], program[P.LIST] + n):
        if is_sum:
            changed = sum_tile(program, at, places, listed, maps, weights)
        else:
            changed = max_tile(program, at, places, listed, maps, weights)
        n_changed = _keep_changed(program, at, places, listed, 1, changed, n_changed)
    program[at + P.CHANGED + 1] = n_changed


@inlined
def _keep_changed(program, at, places, listed, n_places, changed, n_changed):
    """Append to the list of changed places those whose bit is set; returns its new length."""
    end = np.uint64(program[at + P.CHANGED] + n_changed)
    for p in range(n_places):
        places[end] = places[np.uint64(listed + p)]
        end += np.uint64((changed >> p) & 1)
    return np.int64(end) - program[at + P.CHANGED]


@compiled
def _list_dirty(program, at, places):
    """List the places of a step that a change of its sources reaches, each once; returns how many."""
    sources = program[at + P.SOURCES]
    total = 0
    everything = program[P.STALE] != 0
    sees_all = (
        program[at + P.KERNEL_Y] >= program[at + P.STRIDE_Y] and program[at + P.KERNEL_X] >= program[at + P.STRIDE_X]
    )
    for s in range(sources, sources + program[at + P.N_SOURCES]):
        n_changed = program[program[s] + 1]
        total += n_changed
        # Three quarters have changed: a list would cost more than it spares.
        everything |= sees_all and 4 * n_changed >= 3 * program[at + P.SOURCE_PLACES]
    if everything:
        return _list_all(program, at, places)
    if total == 0:
        return 0
    marks = places.view(np.uint64)
    first_row, last_row = program[at + P.ROWS], np.int64(-1)
    for s in range(sources, sources + program[at + P.N_SOURCES]):
        first = program[program[s]]
        top, bottom = _mark_reached(program, at, places, marks, first, first + program[program[s] + 1])
        first_row, last_row = min(first_row, top), max(last_row, bottom)
    end = list_marked(marks, words_of(program[at + P.COLUMNS]), first_row, last_row, places, program[P.LIST])
    return end - program[P.LIST]


@inlined
def _list_all(program, at, places):
    end = program[P.LIST]
    for y in range(program[at + P.ROWS]):
        for x in range(program[at + P.COLUMNS]):
            places[np.uint64(end)] = y << 16 | x
            end += 1
    return end - program[P.LIST]


@inlined
def _mark_reached(program, at, places, marks, first, last):
    """Mark the places that see one of these changed places, y stride - pad + i dilation = changed for a tap i.

    Parameters
    ----------
    first, last : where in `places` the changed places lie.
    marks : see `marks`.

    Returns
    -------
    first_row, last_row : that may be marked.
    """
    rows, columns = program[at + P.ROWS], program[at + P.COLUMNS]
    stride_y, stride_x = program[at + P.STRIDE_Y], program[at + P.STRIDE_X]
    dilation_y, dilation_x = program[at + P.DILATION_Y], program[at + P.DILATION_X]
    reach_y, reach_x = (program[at + P.KERNEL_Y] - 1) * dilation_y, (program[at + P.KERNEL_X] - 1) * dilation_x
    words = words_of(columns)
    first_row, last_row = rows, np.int64(-1)
    k = first
    while k < last:
        place = np.int64(places[np.uint64(k)])
        n_neighbours = 1  # side by side: most changes are, and what they reach overlaps
        if dilation_x == 1:
            while k + n_neighbours < last and np.int64(places[np.uint64(k + n_neighbours)]) == place + n_neighbours:
                n_neighbours += 1
        k += n_neighbours
        y, x = (place >> 16) + program[at + P.PAD_Y], (place & 0xFFFF) + program[at + P.PAD_X]
        x_first = _quotient(max(x - reach_x + stride_x - 1, 0), stride_x)
        x_last = min(_quotient(x + n_neighbours - 1, stride_x), columns - 1)
        y_first = _quotient(max(y - reach_y + stride_y - 1, 0), stride_y)
        y_last = min(_quotient(y, stride_y), rows - 1)
        if x_first > x_last:
            continue
        first_row, last_row = min(first_row, y_first), max(last_row, y_last)
        for row in range(y_first, y_last + 1):
            if dilation_y > 1 and (y - row * stride_y) % dilation_y:
                continue
            if dilation_x == 1:
                mark(marks, words, row, x_first, x_last)
            else:
                for column in range(x_first, x_last + 1):
                    if (x - column * stride_x) % dilation_x == 0:
                        mark(marks, words, row, column, column)
    return first_row, last_row


@inlined
def _quotient(n, stride):
    """n // stride; a division takes longer than all else there."""
    if stride == 1:
        return n
    if stride == 2:
        return n >> 1
    return n // stride
