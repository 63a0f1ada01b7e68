"""All decisions of a packet about a spiking network, in one call."""

import numpy as np
from numba import int64

from async_tnt.kernels.decisions import trigger as T
from async_tnt.kernels.decisions.classify import (
    CLOSE,
    DECISIONS,
    DONE,
    FULL,
    NOT_FINITE,
    note_decision,
)
from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.absorb import absorb_spikes
from async_tnt.kernels.spiking.answer import answer_spikes
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.records import COLUMNS


@entry_point(
    S.STATE,
    *COLUMNS,
    int64,
    int64,
    T.TRIGGER,
    *L.NETWORK,
    int64,
    *DECISIONS,
    calls=(absorb_spikes, answer_spikes, T.until_due, T.why_due, T.schedule),
    nogil=True,
)
def absorb_spikes_and_decide(
    buffer,
    t,
    x,
    y,
    p,
    first,
    last,
    trigger,
    program,
    weights,
    params,
    state,
    stage,
    logits,
    probabilities,
    notes,
):
    """Add events to a spiking network, and make the decisions that are due in between.

    This is `classify.absorb_and_decide` for spiking networks.

    Parameters
    ----------
    buffer, t, x, y, p, first, last, trigger, logits, probabilities, notes : see there.
    program, weights, params, state : see `layout`. The state is updated in place.
    stage : int. Where the output's record begins in the program.

    Returns
    -------
    first, n, outcome : see `classify.absorb_and_decide`.
    """
    n = 0
    outcome = DONE
    ints = buffer.view(np.int64)
    trigger_ints = trigger.view(np.int64)
    end_us = ints[S.START_US] + np.int64(buffer[S.WINDOW_US])
    ints[S.WITHOUT_GIL] = 1
    while first < last:
        if n == len(notes):
            outcome = FULL
            break

        # Absorb up to the next test of a decision, or find that a moment of EVERY_US or the
        # window's end has come.
        n_before = ints[S.N]
        is_at_limit = t[first] >= ints[S.LIMIT_US]
        if is_at_limit:
            if trigger_ints[T.DUE_US] >= end_us:
                break
            why = T.BY_TIME if n_before > trigger_ints[T.N_AT_DECISION] else T.NOT_DUE
        else:
            stop = T.until_due(trigger, n_before, first, last)
            first = absorb_spikes(buffer, t, x, y, p, first, stop, program, weights, params, state)
            why = T.why_due(trigger, n_before, ints[S.N])

        if why != T.NOT_DUE:
            best = answer_spikes(buffer, program, params, state, stage, logits[n], probabilities[n])
            if best < 0:
                outcome = NOT_FINITE
                break
            if T.is_sure(trigger, False, best, probabilities[n, best]):
                why = T.BY_CONFIDENCE
            if why != T.ONLY_IF_SURE:
                trigger_ints[T.N_AT_DECISION] = ints[S.N]
                note_decision(notes, n, ints, why, best)
                n += 1
                if why == T.BY_CONFIDENCE:
                    outcome = CLOSE
                    break

        if is_at_limit:
            # No event lies between this moment and the next event, so the moments between them need
            # no decision.
            T.schedule(trigger, min(t[first], end_us), ints[S.START_US])
            ints[S.LIMIT_US] = min(trigger_ints[T.DUE_US], end_us)
    ints[S.WITHOUT_GIL] = 0
    return first, n, outcome
