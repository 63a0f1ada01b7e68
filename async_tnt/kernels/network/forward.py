"""Compute a network, step by step, where it is out of date.

Each step lists the places that a change reaches, computes them, and notes, for the steps that read
them, the places whose bits differ. With everything out of date this is the plain forward pass.
There is no second implementation of it, so an update and a whole pass cannot differ in a bit.
"""

import numpy as np
from numba import int64, uint64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import (
    EVERY_BIT,
    FIRST_ROW,
    LAST_ROW,
    MAX_ROW,
    WORDS,
    Taps,
    add_changes,
    forget_changes,
    list_places,
    note_changes,
    note_rows,
    seen_from,
    words_of,
)
from async_tnt.kernels.network.tiles import (
    MOST_PLACES,
    REGISTERS,
    channel_tile,
    list_inputs,
    mix_tile,
)
from async_tnt.kernels.simd import trailing_zeros
from async_tnt.kernels.target import LANES

LONGEST_PAUSE = 31
"""The most tiles in a row that are computed from all inputs, if looking for zeros did not pay."""


@entry_point(int64[::1], int64, int64, *P.NETWORK[1:], uint64[::1])
def mix(program, at, n, weights, maps, places, bits):
    """Compute a convolution at the n places of the list, tile by tile."""
    first_group = program[at + P.WEIGHTS]
    n_groups = program[at + P.GROUPS]
    channels = program[at + P.OUT_CHANNELS]
    columns = program[at + P.COLUMNS]
    n_registers = (channels + LANES - 1) // LANES  # rounded up
    most_places = MOST_PLACES[min(n_registers, REGISTERS) - 1]
    n_products = program[at + P.N_RUNS] * program[at + P.RUN_LENGTH]
    # The last tile may have one place too many: it computes the last one twice.
    places[np.uint64(program[P.LIST] + n)] = places[np.uint64(program[P.LIST] + n - 1)]
    k = 0
    while k < n:
        listed = program[P.LIST] + k
        n_places = 1
        block = first_group
        if program[at + P.PLACE_WEIGHTS] == 0:
            n_places = _tile_size(n - k, most_places)
        else:
            place = np.int64(places[listed])
            block += ((place >> 16) * columns + (place & 0xFFFF)) * program[at + P.PLACE_WEIGHTS]

        looks_for_zeros = program[at + P.TILES_UNLISTED] == 0
        if not looks_for_zeros:
            program[at + P.TILES_UNLISTED] -= 1
        changed = np.int64(0)
        for group in range(n_groups):
            inputs = program[at + P.IN] + group * program[at + P.GROUP_CHANNELS]
            first_input = program[at + P.RUNS]
            n_inputs = n_products
            if looks_for_zeros:
                first_input = program[P.LISTED]
                n_inputs = list_inputs(program, at, places, listed, n_places, maps, inputs)
                _note_density(program, at, n_inputs, n_products)
            for f in range(0, channels, REGISTERS * LANES):
                output = program[at + P.OUT] + group * channels + f
                n_filters = min(channels - f, REGISTERS * LANES)
                changed |= mix_tile(
                    program,
                    at,
                    places,
                    listed,
                    n_places,
                    maps,
                    inputs,
                    first_input,
                    n_inputs,
                    output,
                    weights,
                    block,
                    n_filters,
                )
                # The block holds the products, a bias and a slope of each filter, and the limits.
                # The filters are rounded up to whole registers.
                padded = (n_filters + LANES - 1) // LANES * LANES
                block += (n_products + 2) * padded + LANES

        _note_tile(program, at, places, bits, listed, min(n_places, n - k), changed)
        k += n_places


@entry_point(*P.NETWORK, calls=(mix,), nogil=True)
def forward(program, weights, maps, places):
    """Bring the output up to date with the input.

    Parameters
    ----------
    program, weights, maps, places : the network's, see `program`. All but the weights are updated
        in place.
    """
    bits = places.view(np.uint64)
    for step in range(program[P.N_STEPS]):
        at = P.FIRST_STEP + step * P.STEP_SIZE
        forget_changes(program, at + P.CHANGED, bits)
        n = _list_dirty(program, at, places, bits)
        program[at + P.N_COMPUTED] = n
        if n == 0:
            continue
        first_row = np.int64(places[program[P.LIST]]) >> 16
        last_row = np.int64(places[program[P.LIST] + n - 1]) >> 16
        note_rows(program, at + P.CHANGED, first_row, last_row)
        if program[at + P.KIND] == P.MIX:
            mix(program, at, n, weights, maps, places, bits)
        elif program[at + P.KIND] == P.PICK:
            _pick(program, at, n, maps.view(np.uint32), places, bits)
        elif program[at + P.KIND] >= P.PRODUCT:
            _of_two(program, at, n, maps, places, bits)
        else:
            _by_channel(program, at, n, weights, maps, places, bits)
        add_changes(program, at + P.TOUCHED, at + P.CHANGED, bits)
    program[P.STALE] = 0


@inlined
def _tile_size(n, most):
    """How many of n places the next tile computes: one of `SIZES`, at most one more than n."""
    if n >= most - 1:
        return most
    return 4 if n >= 3 else n


@inlined
def _note_density(program, at, n_inputs, n_products):
    """Decide how many tiles come before the next one whose zeros are looked for.

    Looking for zeros takes about an eighth of the time that computing the tile takes. A tile is
    dense if more than 7 of 8 of its inputs (`n_inputs` of `n_products`) are not 0 at one place or
    more. Dense tiles often lie side by side. So each dense tile that was looked at about doubles
    the pause: 1, 3, 7 and so on. A tile that is not dense ends the pause.
    """
    pause = np.int64(0)
    if 8 * n_inputs > 7 * n_products:
        pause = min(2 * program[at + P.PAUSE] + 1, LONGEST_PAUSE)
    program[at + P.PAUSE] = pause
    program[at + P.TILES_UNLISTED] = pause


@inlined
def _by_channel(program, at, n, weights, maps, places, bits):
    """Compute a sum, maximum or function of each channel at the n places of the list."""
    noted = program[at + P.CHANGED]
    words = program[at + P.CHANGED + WORDS]
    for listed in range(program[P.LIST], program[P.LIST] + n):
        place = np.int64(places[np.uint64(listed)])
        changed = channel_tile(program, at, places, listed, maps, weights)
        note_changes(bits, noted + (place >> 16) * words, place & 0xFFFF, np.uint64(changed))


@compiled
def _pick(program, at, n, words_of_maps, places, bits):
    """Copy some channels of one place, or spread them over a block, at the n places of the list."""
    block = program[at + P.BLOCK]
    channels = program[at + P.OUT_CHANNELS]
    first_tap = program[program[at + P.RUNS]]
    all_picked = program[at + P.RUNS] + 1
    for listed in range(program[P.LIST], program[P.LIST] + n):
        place = np.int64(places[np.uint64(listed)])
        row = place >> 16
        column = place & 0xFFFF
        y = _quotient(row, block)
        x = _quotient(column, block)
        source = first_tap + y * program[at + P.IN_DY] + x * program[at + P.IN_DX]
        in_block = (row - y * block) * block + column - x * block
        picked = all_picked + in_block * channels
        target = program[at + P.OUT]
        target += row * program[at + P.OUT_DY] + column * program[at + P.OUT_DX]

        changed = np.uint32(0)
        for c in range(channels):
            number = words_of_maps[np.uint64(source + program[np.uint64(picked + c)])]
            changed |= number ^ words_of_maps[np.uint64(target + c)]
            words_of_maps[np.uint64(target + c)] = number

        row_of_bits = program[at + P.CHANGED] + row * program[at + P.CHANGED + WORDS]
        note_changes(bits, row_of_bits, column, np.uint64(changed != 0))


@compiled
def _of_two(program, at, n, maps, places, bits):
    """Compute products or sums of two inputs at the n places of the list."""
    words_of_maps = maps.view(np.uint32)
    is_product = program[at + P.KIND] == P.PRODUCT
    channels = program[at + P.OUT_CHANNELS]
    one = program[at + P.RUNS]
    two = one + P.OF_TWO_SIZE
    for listed in range(program[P.LIST], program[P.LIST] + n):
        place = np.int64(places[np.uint64(listed)])
        row = place >> 16
        column = place & 0xFFFF
        first = program[one] + row * program[one + P.DY] + column * program[one + P.DX]
        second = program[two] + row * program[two + P.DY] + column * program[two + P.DX]
        target = program[at + P.OUT]
        target += row * program[at + P.OUT_DY] + column * program[at + P.OUT_DX]

        changed = np.uint32(0)
        for c in range(channels):
            number = maps[np.uint64(first + c * program[one + P.DK])]
            other = maps[np.uint64(second + c * program[two + P.DK])]
            before = words_of_maps[np.uint64(target + c)]
            maps[np.uint64(target + c)] = number * other if is_product else number + other
            changed |= before ^ words_of_maps[np.uint64(target + c)]

        row_of_bits = program[at + P.CHANGED] + row * program[at + P.CHANGED + WORDS]
        note_changes(bits, row_of_bits, column, np.uint64(changed != 0))


@inlined
def _note_tile(program, at, places, bits, listed, n_places, changed):
    """Note which places of a tile have changed, a bit of `changed` each."""
    changed = np.uint64(changed)
    first = np.int64(places[np.uint64(listed)])
    last = np.int64(places[np.uint64(listed + n_places - 1)])
    base = program[at + P.CHANGED]
    words = program[at + P.CHANGED + WORDS]
    if last - first == n_places - 1:  # The places lie side by side.
        changed &= EVERY_BIT >> np.uint64(64 - n_places)
        note_changes(bits, base + (first >> 16) * words, first & 0xFFFF, changed)
    else:
        for p in range(n_places):
            place = np.int64(places[np.uint64(listed + p)])
            is_changed = changed >> np.uint64(p) & np.uint64(1)
            note_changes(bits, base + (place >> 16) * words, place & 0xFFFF, is_changed)


@compiled
def _list_dirty(program, at, places, bits):
    """List the places of a step that see a change of its sources, row by row.

    Returns
    -------
    int : how many places the list has.
    """
    if program[P.STALE] != 0:
        return _list_all(program, at, places)
    if program[at + P.BLOCK] > 1:
        return _list_blocks(program, at, places, bits)

    first_source = program[at + P.SOURCES]
    n_sources = program[at + P.N_SOURCES]
    n_whole = program[at + P.N_WHOLE]
    for s in range(first_source, first_source + n_whole):
        if bits[np.uint64(program[program[s]])] != 0:
            return _list_all(program, at, places)
    first_source += n_whole
    n_sources -= n_whole
    top = np.int64(MAX_ROW)
    bottom = np.int64(-1)
    n_words = np.int64(0)
    for s in range(first_source, first_source + n_sources):
        top = min(top, program[program[s] + FIRST_ROW])
        bottom = max(bottom, program[program[s] + LAST_ROW])
        n_words = max(n_words, program[program[s] + WORDS])
    if bottom < 0:
        return 0

    vertical = Taps(
        program[at + P.KERNEL_Y],
        program[at + P.STRIDE_Y],
        program[at + P.PAD_Y],
        program[at + P.DILATION_Y],
    )
    across = Taps(
        program[at + P.KERNEL_X],
        program[at + P.STRIDE_X],
        program[at + P.PAD_X],
        program[at + P.DILATION_X],
    )
    highest = top + vertical.padding - (vertical.n - 1) * vertical.dilation
    first_row = _quotient(max(0, highest + vertical.stride - 1), vertical.stride)
    last_row = min(program[at + P.ROWS] - 1, _quotient(bottom + vertical.padding, vertical.stride))

    columns = program[at + P.COLUMNS]
    scratch = program[P.SCRATCH]
    end = program[P.LIST]
    for word in range(n_words, program[P.SCRATCH_WORDS]):
        bits[np.uint64(scratch + word)] = 0
    for row in range(first_row, last_row + 1):
        some = np.uint64(0)
        for word in range(n_words):
            changed = _seen_in_word(program, bits, first_source, n_sources, vertical, row, word)
            bits[np.uint64(scratch + word)] = changed
            some |= changed
        if some != 0:
            for word in range(words_of(columns)):
                seen = seen_from(bits, scratch, word, across)
                end = list_places(seen, columns - 64 * word, row, word, places, end)
    return end - program[P.LIST]


@inlined
def _seen_in_word(program, bits, first_source, n_sources, vertical, row, word):
    """A bit for each column of a word where a source has changed in a row that `row` sees."""
    changed = np.uint64(0)
    for s in range(first_source, first_source + n_sources):
        record = program[s]
        first = program[record + FIRST_ROW]
        last = program[record + LAST_ROW]
        words = program[record + WORDS]
        if word < words:
            for tap in range(vertical.n):
                y = row * vertical.stride - vertical.padding + tap * vertical.dilation
                if first <= y <= last:
                    changed |= bits[np.uint64(program[record] + y * words + word)]
    return changed


@compiled
def _list_blocks(program, at, places, bits):
    """List the places of a PICK with blocks that lie in the blocks of changed source places.

    Returns the list's length, as `_list_dirty` does.
    """
    first_source = program[at + P.SOURCES]
    n_sources = program[at + P.N_SOURCES]
    block = program[at + P.BLOCK]
    end = program[P.LIST]
    top = np.int64(MAX_ROW)
    bottom = np.int64(-1)
    for s in range(first_source, first_source + n_sources):
        top = min(top, program[program[s] + FIRST_ROW])
        bottom = max(bottom, program[program[s] + LAST_ROW])
    for row in range(top * block, min((bottom + 1) * block, program[at + P.ROWS])):
        y = _quotient(row, block)
        for word in range(program[program[first_source] + WORDS]):
            left = np.uint64(0)
            for s in range(first_source, first_source + n_sources):
                record = program[s]
                if program[record + FIRST_ROW] <= y <= program[record + LAST_ROW]:
                    left |= bits[np.uint64(program[record] + y * program[record + WORDS] + word)]
            while left != 0:
                column = (64 * word + trailing_zeros(left)) * block
                for x in range(column, min(column + block, program[at + P.COLUMNS])):
                    places[np.uint64(end)] = row << 16 | x
                    end += 1
                left &= left - np.uint64(1)
    return end - program[P.LIST]


@inlined
def _list_all(program, at, places):
    """List all places of a step, because nothing has been computed. Returns the list's length."""
    end = program[P.LIST]
    for y in range(program[at + P.ROWS]):
        for x in range(program[at + P.COLUMNS]):
            places[np.uint64(end)] = y << 16 | x
            end += 1
    return end - program[P.LIST]


@inlined
def _quotient(n, stride):
    """The quotient n // stride, without a slow division for the usual strides 1 and 2."""
    if stride == 1:
        return n
    if stride == 2:
        return n >> 1
    return n // stride
