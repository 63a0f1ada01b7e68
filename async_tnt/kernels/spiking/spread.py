"""What a link adds to the sums of a stage.

The order of additions is part of a network's meaning: links in their order, and in a link what goes
on from its stage in the order of indices (row, column, channel).

A `width` is the number of numbers at one place, as WIDTH in `layout`; it counts no columns. The
coordinates y and x of a place of the link's stage include the padding of the link.
"""

import numpy as np

from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.vectors import BLOCK, add_product


@compiled
def spread(program, stage, link, weights, params, state):
    """Add what goes on from the link's stage to the sums of `stage`.

    Parameters
    ----------
    program, weights, params, state : see `layout`. The state is updated in place.
    stage, link : int. Where their records begin in the program.
    """
    kind = program[link + L.KIND]
    if kind == L.CONVOLUTION:
        _spread_convolution(program, stage, link, weights, state)
    elif kind == L.DENSE:
        _spread_dense(program, stage, link, weights, state)
    elif kind == L.POOLING:
        _spread_pooling(program, stage, link, params, state)
    else:
        _spread_scaled(program, stage, link, weights, state)


@inlined
def source_of(program, link):
    """Where the record of the link's stage begins."""
    return L.FIRST_STAGE + L.STAGE_SIZE * program[link + L.FROM]


@inlined
def widen(ints, box, first_y, last_y, first_x, last_x):
    """Make a box hold some rows and columns."""
    ints[box] = min(ints[box], first_y)
    ints[box + 1] = max(ints[box + 1], last_y + 1)
    ints[box + 2] = min(ints[box + 2], first_x)
    ints[box + 3] = max(ints[box + 3], last_x + 1)


@inlined
def first_place(padded, reach, stride):
    """The first place whose window of `reach` places holds a place; padding is counted."""
    return max(0, -((reach - 1 - padded) // stride))


@compiled
def _spread_convolution(program, stage, link, weights, state):
    """Add each number that goes on, times a weight of each filter, to the places it reaches."""
    ints = state.view(np.int64)
    source = source_of(program, link)
    n_channels = program[source + L.CHANNELS]
    source_width = program[source + L.WIDTH]
    n_columns = program[source + L.COLUMNS]
    indices = program[source + L.LIST]
    values = program[source + L.VALUES]

    kernel_y = program[link + L.KERNEL_Y]
    kernel_x = program[link + L.KERNEL_X]
    stride_y = program[link + L.STRIDE_Y]
    stride_x = program[link + L.STRIDE_X]
    dilation_y = program[link + L.DILATION_Y]
    dilation_x = program[link + L.DILATION_X]
    groups = program[link + L.GROUPS]
    sums = program[stage + L.SUMS]
    rows = program[stage + L.ROWS]
    columns = program[stage + L.COLUMNS]
    width = program[stage + L.WIDTH]
    box = program[stage + L.BOX]
    filters_each = program[stage + L.CHANNELS] // groups
    channels_each = n_channels // groups
    weights_each = width if groups == 1 else filters_each
    n_added = 0
    reach_y = (kernel_y - 1) * dilation_y + 1
    reach_x = (kernel_x - 1) * dilation_x + 1

    for k in range(ints[program[source + L.N_ACTIVE]]):
        index = ints[indices + k]
        value = state[values + k]
        place = index // source_width
        channel = index - place * source_width
        y = place // n_columns + program[link + L.PADDING_Y]
        x = place % n_columns + program[link + L.PADDING_X]
        first_y = first_place(y, reach_y, stride_y)
        first_x = first_place(x, reach_x, stride_x)
        last_y = min(rows - 1, y // stride_y)
        last_x = min(columns - 1, x // stride_x)
        if first_y > last_y or first_x > last_x:
            continue
        widen(ints, box, first_y, last_y, first_x, last_x)
        first_filter = channel // channels_each * filters_each
        of_channel = program[link + L.WEIGHTS] + channel * kernel_y * kernel_x * weights_each
        for target_y in range(first_y, last_y + 1):
            from_y = y - target_y * stride_y
            ky = from_y // dilation_y
            if ky * dilation_y != from_y:
                continue
            for target_x in range(first_x, last_x + 1):
                from_x = x - target_x * stride_x
                kx = from_x // dilation_x
                if kx * dilation_x != from_x:
                    continue
                target = sums + (target_y * columns + target_x) * width
                first_weight = of_channel + (ky * kernel_x + kx) * weights_each
                if groups == 1:
                    add_product(state, target, value, weights, first_weight, width // BLOCK)
                else:
                    _add_few(
                        state, target + first_filter, value, weights, first_weight, filters_each
                    )
                n_added += filters_each
    ints[program[stage + L.N_ADDED]] += n_added


@inlined
def _add_few(state, first, value, weights, first_weight, n):
    """Add a number times n weights to n numbers of the state."""
    for k in range(n):
        state[first + k] += value * np.float64(weights[first_weight + k])


@compiled
def _spread_dense(program, stage, link, weights, state):
    """Add each number that goes on, times its weight for each channel, to a stage of one place."""
    ints = state.view(np.int64)
    source = source_of(program, link)
    indices = program[source + L.LIST]
    values = program[source + L.VALUES]
    sums = program[stage + L.SUMS]
    width = program[stage + L.WIDTH]
    n_active = ints[program[source + L.N_ACTIVE]]
    if n_active > 0:
        widen(ints, program[stage + L.BOX], 0, 0, 0, 0)
    for k in range(n_active):
        first_weight = program[link + L.WEIGHTS] + ints[indices + k] * width
        add_product(state, sums, state[values + k], weights, first_weight, width // BLOCK)
    ints[program[stage + L.N_ADDED]] += n_active * program[stage + L.CHANNELS]


@compiled
def _spread_pooling(program, stage, link, params, state):
    """Add each number that goes on, times one weight, to its channel of all windows it lies in."""
    ints = state.view(np.int64)
    source = source_of(program, link)
    width = program[source + L.WIDTH]
    n_columns = program[source + L.COLUMNS]
    indices = program[source + L.LIST]
    values = program[source + L.VALUES]
    stride_y = program[link + L.STRIDE_Y]
    stride_x = program[link + L.STRIDE_X]
    sums = program[stage + L.SUMS]
    rows = program[stage + L.ROWS]
    columns = program[stage + L.COLUMNS]
    box = program[stage + L.BOX]
    weight = params[program[link + L.WEIGHTS]]

    for k in range(ints[program[source + L.N_ACTIVE]]):
        index = ints[indices + k]
        value = state[values + k]
        place = index // width
        channel = index - place * width
        y = place // n_columns + program[link + L.PADDING_Y]
        x = place % n_columns + program[link + L.PADDING_X]
        first_y = first_place(y, program[link + L.KERNEL_Y], stride_y)
        first_x = first_place(x, program[link + L.KERNEL_X], stride_x)
        last_y = min(rows - 1, y // stride_y)
        last_x = min(columns - 1, x // stride_x)
        if first_y > last_y or first_x > last_x:
            continue
        widen(ints, box, first_y, last_y, first_x, last_x)
        for target_y in range(first_y, last_y + 1):
            for target_x in range(first_x, last_x + 1):
                target = sums + (target_y * columns + target_x) * width + channel
                state[target] += value * weight


@compiled
def _spread_scaled(program, stage, link, weights, state):
    """Add each number that goes on at its own index; a SCALED link has a weight for each."""
    ints = state.view(np.int64)
    source = source_of(program, link)
    width = program[source + L.WIDTH]
    n_columns = program[source + L.COLUMNS]
    indices = program[source + L.LIST]
    values = program[source + L.VALUES]
    sums = program[stage + L.SUMS]
    box = program[stage + L.BOX]
    for k in range(ints[program[source + L.N_ACTIVE]]):
        index = ints[indices + k]
        place = index // width
        y = place // n_columns
        x = place % n_columns
        widen(ints, box, y, y, x, x)
        value = state[values + k]
        if program[link + L.KIND] == L.SCALED:
            value *= np.float64(weights[program[link + L.WEIGHTS] + index])
        state[sums + index] += value
