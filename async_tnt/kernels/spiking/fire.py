"""What goes on from a stage: the spikes of its neurons, or its sums.

The membrane v of a neuron, with the sum s of what has arrived at this event, the gain g, the
threshold h and, if the neuron leaks, the potential at rest l and the time constant tau:

    v <- l + (v - l) exp(-dt / tau)        of leaky neurons, dt since the last time
    v <- v + g s
    n  = 0 if v <= h, else max(1, ceil(v / h) - 1), and one more if v - n h > h
    v <- v - n h                           reset by subtraction

With a reset to a value r, a neuron with v > h has one spike, and v <- r.
"""

import numpy as np

from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.spiking import layout as L


@compiled
def fire(program, stage, params, state, now_us):
    """Make the list of what goes on from a stage, and empty its sums.

    Parameters
    ----------
    program, params, state : see `layout`. The state is updated in place.
    stage : int. Where its record begins in the program.
    now_us : float. Time of the event.
    """
    ints = state.view(np.int64)
    neurons = program[stage + L.NEURONS]
    box = program[stage + L.BOX]
    columns = program[stage + L.COLUMNS]
    n_channels = program[stage + L.CHANNELS]
    n = 0
    for y in range(ints[box], ints[box + 1]):
        for x in range(ints[box + 2], ints[box + 3]):
            place = y * columns + x
            if neurons == L.NONE:
                n = _pass_on(program, stage, state, place * n_channels, n)
                continue
            if neurons == L.LEAKY:
                _leak(program, stage, params, state, place, now_us)
            if _charge(program, stage, params, state, place):
                n = _spike(program, stage, params, state, place, n)
    ints[program[stage + L.N_ACTIVE]] = n
    if program[stage + L.COUNTS] >= 0:
        _count(program, stage, state, now_us)


@inlined
def _pass_on(program, stage, state, first, n):
    """Put the sums of a place that are not 0 onto the list. Returns the list's new length."""
    ints = state.view(np.int64)
    sums = program[stage + L.SUMS]
    indices = program[stage + L.LIST]
    values = program[stage + L.VALUES]
    for index in range(first, first + program[stage + L.CHANNELS]):
        value = state[sums + index]
        if value != 0.0:
            ints[indices + n] = index
            state[values + n] = value
            state[sums + index] = 0.0
            n += 1
    return n


@inlined
def params_of(program, stage, place):
    """Where the first parameter of a place's neurons lies."""
    params = program[stage + L.PARAMS]
    n_channels = program[stage + L.CHANNELS]
    if program[stage + L.PARAMS_SIZE] > n_channels:
        params += place * n_channels
    return params


@inlined
def _leak(program, stage, params, state, place, now_us):
    """Let the membranes of a place leak up to now."""
    times = program[stage + L.TIMES]
    passed_us = now_us - state[times + place]
    if passed_us <= 0.0:
        return
    state[times + place] = now_us
    n_channels = program[stage + L.CHANNELS]
    size = program[stage + L.PARAMS_SIZE]
    first_param = params_of(program, stage, place)
    first = program[stage + L.MEMBRANES] + place * n_channels
    for c in range(n_channels):
        rest = params[first_param + L.LEAK * size + c]
        rate = params[first_param + L.RATE * size + c]
        state[first + c] = rest + (state[first + c] - rest) * np.exp(-passed_us * rate)


@inlined
def _charge(program, stage, params, state, place):
    """Add the sums of a place to its membranes. Returns whether a neuron is above its threshold."""
    n_channels = program[stage + L.CHANNELS]
    size = program[stage + L.PARAMS_SIZE]
    gain = params_of(program, stage, place)
    threshold = gain + L.THRESHOLD * size
    first = place * n_channels
    sums = program[stage + L.SUMS] + first
    membranes = program[stage + L.MEMBRANES] + first
    n_above = 0
    for c in range(n_channels):
        membrane = state[membranes + c] + params[gain + c] * state[sums + c]
        state[membranes + c] = membrane
        state[sums + c] = 0.0
        n_above += membrane > params[threshold + c]
    return n_above > 0


@inlined
def _spike(program, stage, params, state, place, n):
    """Put the spikes of a place onto the list, and reset its membranes.

    Returns the list's new length.
    """
    ints = state.view(np.int64)
    n_channels = program[stage + L.CHANNELS]
    size = program[stage + L.PARAMS_SIZE]
    first_param = params_of(program, stage, place)
    first = place * n_channels
    membranes = program[stage + L.MEMBRANES] + first
    indices = program[stage + L.LIST]
    values = program[stage + L.VALUES]
    for c in range(n_channels):
        membrane = state[membranes + c]
        threshold = params[first_param + L.THRESHOLD * size + c]
        if not membrane > threshold:
            continue
        spikes = 1.0
        if program[stage + L.RESET] == L.SUBTRACT:
            spikes = max(1.0, np.ceil(membrane / threshold) - 1.0)
            membrane -= spikes * threshold
            if membrane > threshold:
                spikes += 1.0
                membrane -= threshold
            if spikes >= L.MOST_SPIKES:
                membrane = 0.0
        else:
            membrane = params[first_param + L.RESET_TO * size + c]
        state[membranes + c] = membrane
        ints[indices + n] = first + c
        state[values + n] = spikes
        ints[program[stage + L.N_SPIKES]] += np.int64(min(spikes, L.MOST_SPIKES))
        n += 1
    return n


@inlined
def _count(program, stage, state, now_us):
    """Count the spikes of an output."""
    ints = state.view(np.int64)
    counts = program[stage + L.COUNTS]
    first_us = program[stage + L.FIRST_US]
    for k in range(ints[program[stage + L.N_ACTIVE]]):
        index = ints[program[stage + L.LIST] + k]
        if state[counts + index] == 0.0:
            state[first_us + index] = now_us
        state[counts + index] += state[program[stage + L.VALUES] + k]
