"""Events into a volume, and through the layers of a spiking network."""

import numpy as np
from numba import int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled
from async_tnt.kernels.lock import release_gil, take_gil
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.fire import fire
from async_tnt.kernels.spiking.spread import spread
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.absorb import ABSORBED, absorb, absorb_one
from async_tnt.kernels.volume.records import COLUMNS

LARGE = 32
"""Events from which on Python's lock is released: each takes microseconds."""


@compiled
def _step(program, weights, params, state, now_us, x, y, p):
    """Let one event go through all layers.

    Parameters
    ----------
    program, weights, params, state : see `layout`. The state is updated in place.
    now_us : int. The window's newest time.
    x, y, p : int. The event's pixel, and its polarity: 0 or 1.
    """
    ints = state.view(np.int64)
    event = L.FIRST_STAGE
    channel = program[L.CHANNEL_OF_ON] if p == 1 else program[L.CHANNEL_OF_OFF]
    place = y * program[event + L.COLUMNS] + x
    ints[program[event + L.LIST]] = place * program[event + L.WIDTH] + channel
    state[program[event + L.VALUES]] = 1.0
    ints[program[event + L.N_ACTIVE]] = 1
    for k in range(1, program[L.N_STAGES]):
        stage = L.FIRST_STAGE + k * L.STAGE_SIZE
        box = program[stage + L.BOX]
        ints[box] = program[stage + L.ROWS]
        ints[box + 1] = 0
        ints[box + 2] = program[stage + L.COLUMNS]
        ints[box + 3] = 0
        link = program[stage + L.LINKS]
        for _ in range(program[stage + L.N_LINKS]):
            spread(program, stage, link, weights, params, state)
            link += L.LINK_SIZE
        fire(program, stage, params, state, np.float64(now_us))


@entry_point(S.STATE, *COLUMNS, int64, int64, *L.NETWORK, calls=(absorb,))
def absorb_spikes(buffer, t, x, y, p, first, last, program, weights, params, state):
    """Add events to the open window, and let each one go through the network.

    Parameters
    ----------
    buffer, t, x, y, p, first, last : see `volume.absorb.absorb`.
    program, weights, params, state : see `layout`. The state is updated in place.

    Returns
    -------
    int : the first event not absorbed.
    """
    ints = buffer.view(np.int64)
    is_held = ints[S.WITHOUT_GIL] != 0
    lock = release_gil((last - first >= LARGE) & (not is_held))
    ints[S.WITHOUT_GIL] = 1
    while first < last:
        n_before = ints[S.N]
        # copies: another thread may change the columns between two looks
        event_x = np.int64(x[first])
        event_y = np.int64(y[first])
        event_p = np.int64(p[first])
        if absorb(buffer, t, x, y, p, first, first + 1) == first:
            break
        if ints[S.N] > n_before:  # not late
            now_us = ints[S.NEWEST_US]
            _step(program, weights, params, state, now_us, event_x, event_y, event_p)
        first += 1
    ints[S.WITHOUT_GIL] = 1 if is_held else 0
    take_gil(lock)
    return first


@entry_point(S.STATE, int64, int64, int64, int64, *L.NETWORK, calls=(absorb_one,))
def absorb_one_spike(buffer, t, x, y, p, program, weights, params, state):
    """Check one event, add it to the open window, and let it go through the network.

    Parameters
    ----------
    buffer, t, x, y, p : see `volume.absorb.absorb_one`.
    program, weights, params, state : see `layout`. The state is updated in place.

    Returns
    -------
    int : ABSORBED, LATE, AT_LIMIT or REFUSED.
    """
    outcome = absorb_one(buffer, t, x, y, p)
    if outcome == ABSORBED:
        now_us = buffer.view(np.int64)[S.NEWEST_US]
        _step(program, weights, params, state, now_us, x, y, max(p, 0))
    return outcome
