"""The logits of a spiking network, and the class that it decides for."""

import numpy as np
from numba import float32, float64, int64

from async_tnt.kernels.decisions.classify import softmax
from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.fire import membrane_at, params_of
from async_tnt.kernels.volume import state as S


@inlined
def _membrane_now(program, stage, params, state, neuron, now_us):
    """The membrane of a neuron at a time.

    The membrane stays as it is if it has been computed up to that time, or beyond it.
    """
    membrane = state[program[stage + L.MEMBRANES] + neuron]
    neurons = program[stage + L.NEURONS]
    if neurons != L.LEAKY and neurons != L.CURRENT_BASED:
        return membrane
    place = neuron // program[stage + L.WIDTH]
    passed_us = now_us - state[program[stage + L.TIMES] + place]
    if passed_us <= 0.0:
        return membrane
    size = program[stage + L.PARAMS_SIZE]
    param = params_of(program, stage, place) + neuron - place * program[stage + L.WIDTH]
    if neurons == L.CURRENT_BASED:
        current = state[program[stage + L.CURRENTS] + neuron]
        return membrane_at(params, param, size, membrane, current, passed_us)
    rest = params[param + L.LEAK * size]
    return rest + (membrane - rest) * np.exp(-passed_us * params[param + L.RATE * size])


@entry_point(
    S.STATE,
    int64[::1],
    float64[::1],
    float64[::1],
    int64,
    float32[::1],
    float64[::1],
    calls=(softmax,),
)
def answer_spikes(buffer, program, params, state, stage, logits, probabilities):
    """Logits and probabilities of a window: of the output's neurons, which lie at one place.

    A logit is the number of a neuron's spikes in the window, or the membrane of an integrator. The
    class is that of the largest logit. Of equal logits, the neuron with the largest membrane
    decides; of equal membranes, the first neuron.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    program, params, state : see `layout`. Only read.
    stage : int. Where the output's record begins in the program.
    logits, probabilities : float32 and float64, one number for each neuron. Overwritten.

    Returns
    -------
    int : the class; -1 if a logit is not finite.
    """
    ints = buffer.view(np.int64)
    now_us = np.float64(ints[S.NEWEST_US] if ints[S.N] > 0 else ints[S.START_US])
    fires = program[stage + L.FIRES] != 0
    for k in range(logits.size):
        if fires:
            logits[k] = state[program[stage + L.COUNTS] + k]
        else:
            logits[k] = _membrane_now(program, stage, params, state, k, now_us)
    best = softmax(logits, probabilities)
    if best < 0:
        return best
    largest = logits[best]
    highest = _membrane_now(program, stage, params, state, best, now_us)
    for k in range(best + 1, logits.size):
        if logits[k] == largest:
            membrane = _membrane_now(program, stage, params, state, k, now_us)
            if membrane > highest:
                highest = membrane
                best = k
    return best
