"""What goes on from a stage: the spikes of its neurons, or its sums.

The membrane v of a neuron, with the sum s of what has arrived at this event, the gain g, the
threshold h and, if the neuron leaks, the potential at rest l and the time constant tau:

    v <- l + (v - l) exp(-dt / tau)        of leaky neurons, dt since the last time
    v <- v + g s
    n  = 0 if v <= h, else max(1, ceil(v / h) - 1), and one more if v - n h > h
    v <- v - n h                           reset by subtraction

With a reset to a value r, a neuron with v > h has one spike, and v <- r.

A neuron with a current I, its rate q, and the membrane's rate p, computes in dt since the last time

    v <- l + (v - l) exp(-p dt) + R I p dt exp(-min(p, q) dt) f(|p - q| dt)
    I <- I exp(-q dt) + g s

with f(x) = (1 - exp(-x)) / x, which solves dv/dt = p (l - v + R I) and dI/dt = -q I. It may fire
without an arrival, so it is watched while its current could raise it above its threshold.
"""

import numpy as np

from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.spread import widen
from async_tnt.kernels.spiking.vectors import BLOCK, charge


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
    width = program[stage + L.WIDTH]
    if neurons == L.CURRENT_BASED:
        _look_at_watched(program, stage, params, state, now_us)
    n = 0
    for y in range(ints[box], ints[box + 1]):
        for x in range(ints[box + 2], ints[box + 3]):
            place = y * columns + x
            if neurons == L.NONE:
                n = _pass_on(program, stage, state, place * width, n)
                continue
            if neurons == L.CURRENT_BASED:
                n = _fire_currents(program, stage, params, state, place, now_us, n)
                continue
            if neurons == L.LEAKY:
                _leak(program, stage, params, state, place, now_us)
            n = _fire_place(program, stage, params, state, place, n)
            if neurons == L.STATELESS:
                first = program[stage + L.MEMBRANES] + place * width
                state[first : first + width] = 0.0
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
    width = program[stage + L.WIDTH]
    if program[stage + L.PARAMS_SIZE] > width:
        params += place * width
    return params


@inlined
def _leak(program, stage, params, state, place, now_us):
    """Let the membranes of a place leak up to now."""
    times = program[stage + L.TIMES]
    passed_us = now_us - state[times + place]
    if passed_us <= 0.0:
        return
    state[times + place] = now_us
    size = program[stage + L.PARAMS_SIZE]
    first_param = params_of(program, stage, place)
    first = program[stage + L.MEMBRANES] + place * program[stage + L.WIDTH]
    for c in range(program[stage + L.CHANNELS]):
        rest = params[first_param + L.LEAK * size + c]
        rate = params[first_param + L.RATE * size + c]
        state[first + c] = rest + (state[first + c] - rest) * np.exp(-passed_us * rate)


@inlined
def _fire_place(program, stage, params, state, place, n):
    """Add the sums of a place to its membranes, and put its spikes onto the list.

    Returns the list's new length.
    """
    width = program[stage + L.WIDTH]
    gains = params_of(program, stage, place)
    thresholds = gains + L.THRESHOLD * program[stage + L.PARAMS_SIZE]
    first = place * width
    sums = program[stage + L.SUMS] + first
    membranes = program[stage + L.MEMBRANES] + first
    for block in range(0, width, BLOCK):
        above = charge(
            state, params, membranes + block, sums + block, gains + block, thresholds + block
        )
        c = block
        while above != 0:
            if above & 1:
                _spike(program, stage, params, state, first + c, gains + c, n)
                n += 1
            above >>= 1
            c += 1
    return n


@inlined
def added_by_current(passed_us, rate, current_rate):
    """How much a current of 1 adds to a membrane of the resistance 1 while this time passes."""
    x = passed_us * abs(rate - current_rate)
    share = 1.0
    if x > 0.0:
        share = -np.expm1(-x) / x
    return passed_us * rate * np.exp(-passed_us * min(rate, current_rate)) * share


@inlined
def membrane_at(params, param, size, membrane, current, passed_us):
    """A membrane with a current, after some time.

    param : int. Where the neuron's first parameter lies.
    """
    rest = params[param + L.LEAK * size]
    rate = params[param + L.RATE * size]
    resistance = params[param + L.RESISTANCE * size]
    added = added_by_current(passed_us, rate, params[param + L.CURRENT_RATE * size])
    leaked = rest + (membrane - rest) * np.exp(-passed_us * rate)
    return leaked + resistance * current * added


@inlined
def may_rise_above(params, param, size, membrane, current):
    """Whether a current may raise its membrane above the threshold without an arrival."""
    rest = params[param + L.LEAK * size]
    highest = max(membrane, rest) + max(0.0, params[param + L.RESISTANCE * size] * current)
    # a little more, because later membranes are rounded
    return highest * (1.0 + 1e-12) > params[param + L.THRESHOLD * size]


@inlined
def _look_at_watched(program, stage, params, state, now_us):
    """Widen the stage's box to watched neurons that are above their thresholds by now.

    Neurons that their current cannot raise so far any more are no longer watched.
    """
    ints = state.view(np.int64)
    size = program[stage + L.PARAMS_SIZE]
    width = program[stage + L.WIDTH]
    watched = program[stage + L.WATCHED]
    columns = program[stage + L.COLUMNS]
    n = ints[program[stage + L.N_WATCHED]]
    k = 0
    while k < n:
        neuron = ints[watched + k]
        place = neuron // width
        param = params_of(program, stage, place) + neuron - place * width
        passed_us = max(0.0, now_us - state[program[stage + L.TIMES] + place])
        current = state[program[stage + L.CURRENTS] + neuron]
        membrane = state[program[stage + L.MEMBRANES] + neuron]
        if passed_us > 0.0:
            membrane = membrane_at(params, param, size, membrane, current, passed_us)
            current *= np.exp(-passed_us * params[param + L.CURRENT_RATE * size])
        if membrane > params[param + L.THRESHOLD * size]:
            y = place // columns
            x = place % columns
            widen(ints, program[stage + L.BOX], y, y, x, x)
            k += 1
        elif may_rise_above(params, param, size, membrane, current):
            k += 1
        else:
            n -= 1
            ints[watched + k] = ints[watched + n]
            ints[program[stage + L.IS_WATCHED] + neuron] = 0
    ints[program[stage + L.N_WATCHED]] = n


@inlined
def _fire_currents(program, stage, params, state, place, now_us, n):
    """Let the neurons of a place, which have currents, leak up to now, then add their sums.

    Otherwise it does what `_fire_place` does, and returns the list's new length, too.
    """
    ints = state.view(np.int64)
    size = program[stage + L.PARAMS_SIZE]
    first_param = params_of(program, stage, place)
    first = place * program[stage + L.WIDTH]
    time = program[stage + L.TIMES] + place
    passed_us = max(0.0, now_us - state[time])
    state[time] += passed_us
    for c in range(program[stage + L.CHANNELS]):
        neuron = first + c
        param = first_param + c
        at_membrane = program[stage + L.MEMBRANES] + neuron
        at_current = program[stage + L.CURRENTS] + neuron
        at_sum = program[stage + L.SUMS] + neuron
        membrane = state[at_membrane]
        current = state[at_current]
        if passed_us > 0.0:
            membrane = membrane_at(params, param, size, membrane, current, passed_us)
            current *= np.exp(-passed_us * params[param + L.CURRENT_RATE * size])
        current += params[param + L.GAIN * size] * state[at_sum]
        state[at_sum] = 0.0
        state[at_current] = current
        state[at_membrane] = membrane
        if membrane > params[param + L.THRESHOLD * size]:
            _spike(program, stage, params, state, neuron, param, n)
            n += 1
        is_watched = program[stage + L.IS_WATCHED] + neuron
        may_rise = may_rise_above(params, param, size, state[at_membrane], current)
        if may_rise and ints[is_watched] == 0:
            ints[is_watched] = 1
            n_watched = program[stage + L.N_WATCHED]
            ints[program[stage + L.WATCHED] + ints[n_watched]] = neuron
            ints[n_watched] += 1
    return n


@inlined
def _spike(program, stage, params, state, neuron, param, n):
    """Put the spikes of a neuron that is above its threshold onto the list, and reset it.

    Parameters
    ----------
    neuron : int. Its number in the stage.
    param : int. Where its first parameter lies.
    n : int. The list's length before.
    """
    ints = state.view(np.int64)
    size = program[stage + L.PARAMS_SIZE]
    membrane = state[program[stage + L.MEMBRANES] + neuron]
    spikes = 1.0
    if program[stage + L.RESET] == L.SUBTRACT:
        threshold = params[param + L.THRESHOLD * size]
        spikes = max(1.0, np.ceil(membrane / threshold) - 1.0)
        membrane -= spikes * threshold
        if membrane > threshold:
            spikes += 1.0
            membrane -= threshold
        if spikes >= L.MOST_SPIKES:
            membrane = 0.0
    else:
        membrane = params[param + L.RESET_TO * size]
    state[program[stage + L.MEMBRANES] + neuron] = membrane
    ints[program[stage + L.LIST] + n] = neuron
    state[program[stage + L.VALUES] + n] = spikes
    ints[program[stage + L.N_SPIKES]] += np.int64(min(spikes, L.MOST_SPIKES))


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
