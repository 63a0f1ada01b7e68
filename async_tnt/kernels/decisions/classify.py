"""The class of a window in one call, and all decisions of a packet in one call.

Each array of the network, of the columns and of the answers is an argument of its own, so the
kernels here have more than eight: to unpack a tuple of arrays takes Numba longer than to take them.
"""

import numpy as np
from numba import float32, float64, int64

from async_tnt.kernels.decisions import trigger as T
from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.lock import LARGE, release_gil, take_gil
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.empty_window import begin_window
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.network.sync_input import sync_input
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.absorb import absorb
from async_tnt.kernels.volume.records import COLUMNS
from async_tnt.kernels.volume.sliding import advance, oldest_us

# why `absorb_and_decide` returned
DONE = 0  # all events up to `last`, or to the window's end, have been absorbed
FULL = 1  # there is no room for more decisions
CLOSE = 2  # the last decision reached the confidence
NOT_FINITE = 3  # the logits in row n are not all finite

# what `notes` says of a decision
NOTED_EVENTS = 0  # events of the window
NOTED_NEWEST_US = 1  # time of the newest event of the window
NOTED_TRIGGER = 2  # why it was due, see `trigger`
NOTED_CLASS = 3
NOTED_START_US = 4  # start of the window; of one that slides, the time of its oldest event
DECISION_FIELDS = 5  # numbers in a row

DECISIONS = (float32[:, ::1], float64[:, ::1], int64[:, ::1])
"""Numba's types of the arrays of several decisions: logits, probabilities, notes."""


@inlined
def window_end_us(buffer, ints):
    """The end of the open window; a window that slides has none."""
    if ints[S.RING] != 0:
        return np.int64(S.NEVER_US)
    return ints[S.START_US] + np.int64(buffer[S.WINDOW_US])


@inlined
def note_decision(notes, n, ints, why, best):
    """Note what is known of a decision in a row of `notes`.

    Parameters
    ----------
    notes : int64, (m, DECISION_FIELDS). Row n is overwritten.
    ints : int64, the volume's `state`.
    why, best : int. Why the decision was due, and its class.
    """
    is_sliding = ints[S.RING] != 0
    notes[n, NOTED_EVENTS] = ints[S.RING_N] if is_sliding else ints[S.N]
    notes[n, NOTED_NEWEST_US] = ints[S.NEWEST_US]
    notes[n, NOTED_TRIGGER] = why
    notes[n, NOTED_CLASS] = best
    notes[n, NOTED_START_US] = oldest_us(ints) if is_sliding else ints[S.START_US]


@entry_point(float32[::1], float64[::1])
def softmax(logits, probabilities):
    """probabilities[k] = exp(logits[k] - max) / sum, in float64.

    Returns
    -------
    int : the first class of the largest logit. -1, and nothing written, if a logit is not finite.
    """
    largest = 0
    for k in range(logits.size):
        if not np.isfinite(logits[k]):
            return -1
        if logits[k] > logits[largest]:
            largest = k
    total = 0.0
    for k in range(logits.size):
        probabilities[k] = np.exp(np.float64(logits[k]) - np.float64(logits[largest]))
        total += probabilities[k]
    for k in range(logits.size):
        probabilities[k] /= total
    return largest


@entry_point(S.STATE, *P.NETWORK, float32[::1], float64[::1], calls=(sync_input, forward, softmax))
def classify_cells(buffer, program, weights, maps, places, logits, probabilities):
    """Logits and probabilities of a volume. Only what has changed since the last call is computed.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    program, weights, maps, places : the classifier's, see `program`. Updated in place.
    logits, probabilities : float32 and float64, shape (n_classes,). Overwritten.

    Returns
    -------
    int : the class, as `softmax` returns it.
    """
    ints = buffer.view(np.int64)
    n_seen = program[P.N_SEEN] if program[P.EPOCH] == ints[S.EPOCH] else 0
    lock = release_gil((ints[S.N_LOG] - n_seen >= LARGE) & (ints[S.WITHOUT_GIL] == 0))
    begin_window(ints[S.EPOCH], program, weights, maps, places)
    sync_input(buffer, program, maps, places)
    forward(program, weights, maps, places)
    first_logit = np.uint64(program[P.OUTPUT])
    for k in range(logits.size):
        logits[k] = maps[first_logit + np.uint64(k)]
    best = softmax(logits, probabilities)
    take_gil(lock)
    return best


@entry_point(
    S.STATE,
    *COLUMNS,
    int64,
    int64,
    T.TRIGGER,
    *P.NETWORK,
    *DECISIONS,
    calls=(absorb, advance, classify_cells, T.until_due, T.why_due, T.schedule),
    nogil=True,
)
def absorb_and_decide(
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
    maps,
    places,
    logits,
    probabilities,
    notes,
):
    """Absorb events of the only open window, and decide where a trigger makes a decision due.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    t, x, y, p, first, last : see `absorb`.
    trigger : float64, see `trigger`. Updated in place.
    program, weights, maps, places : the classifier's, see `program`. Updated in place.
    logits, probabilities, notes : float32 (m, n_classes), float64 (m, n_classes), and int64
        (m, DECISION_FIELDS). Overwritten, one row per decision.

    Returns
    -------
    first : int. The first event not absorbed.
    n : int. Decisions.
    outcome : int. DONE, FULL, CLOSE or NOT_FINITE.
    """
    n = 0
    outcome = DONE
    ints = buffer.view(np.int64)
    trigger_ints = trigger.view(np.int64)
    is_sliding = ints[S.RING] != 0
    end_us = window_end_us(buffer, ints)
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
            first = absorb(buffer, t, x, y, p, first, stop)
            why = T.why_due(trigger, n_before, ints[S.N])

        if why != T.NOT_DUE:
            if why == T.BY_TIME and is_sliding:
                advance(buffer, trigger_ints[T.DUE_US])
            best = classify_cells(
                buffer, program, weights, maps, places, logits[n], probabilities[n]
            )
            if best < 0:
                outcome = NOT_FINITE
                break
            if T.is_sure(trigger, is_sliding, best, probabilities[n, best]):
                why = T.BY_CONFIDENCE
            if why != T.ONLY_IF_SURE:
                trigger_ints[T.N_AT_DECISION] = ints[S.N]
                note_decision(notes, n, ints, why, best)
                n += 1
                if why == T.BY_CONFIDENCE and not is_sliding:
                    outcome = CLOSE
                    break

        if is_at_limit:
            # No event lies between this moment and the next event, so the moments between them need
            # no decision.
            T.schedule(trigger, min(t[first], end_us), ints[S.START_US])
            ints[S.LIMIT_US] = min(trigger_ints[T.DUE_US], end_us)
    ints[S.WITHOUT_GIL] = 0
    return first, n, outcome
