"""From a volume to logits and probabilities, in one call; from a packet to all its decisions, in one call."""

import numpy as np

from . import layout as P
from . import state as S
from . import trigger as T
from .absorb import absorb
from .forward import renew
from .jit import compiled, compiled_without_gil
from .sync_input import watch_array, watch_cells

WENT_ON, FULL, CLOSE, NOT_FINITE = 0, 1, 2, 3  # how a stretch ended
DECISION_FIELDS = 4  # what a decision notes: events, newest time, trigger, class


@compiled
def classify_array(volume, plan, weights, maps, dirty, logits):
    """The whole network: volume (C, H, W) -> logits (n_classes,)."""
    watch_array(volume, plan, maps, dirty)
    renew(plan, weights, maps, dirty)
    _copy_logits(plan, maps, logits)


@compiled
def classify_cells(buffer, plan, weights, maps, dirty, logits, probabilities):
    """The same for a volume's `state`, where only what has changed since the last call is computed.

    Returns
    -------
    int : the class, as `softmax` says it.
    """
    watch_cells(buffer, plan, maps, dirty)
    renew(plan, weights, maps, dirty)
    _copy_logits(plan, maps, logits)
    return softmax(logits, probabilities)


@compiled_without_gil
def absorb_and_decide(
    buffer, t, x, y, p, first, last, trigger, plan, weights, maps, dirty, logits, probabilities, notes
):
    """Take events, and decide at each that a trigger makes due.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    t, x, y, p, first, last : as for `absorb`.
    trigger : float64, see `trigger`. Updated in place.
    plan, weights, maps, dirty : the classifier's, see `plan`. Updated in place.
    logits, probabilities, notes : float32 and float64 (n, n_classes), int64 (n, DECISION_FIELDS). Overwritten, one
        row per decision.

    Returns
    -------
    first : int. The first event not taken.
    n : int. Decisions.
    end : WENT_ON to `last` or to the volume's limit; FULL: no room for more decisions; CLOSE: the last decision
        passed the level of confidence; NOT_FINITE: the logits in row n are no numbers.
    """
    n = 0
    ints = buffer.view(np.int64)
    level = trigger[T.CONFIDENCE]
    while first < last:
        if n == len(notes):
            return first, n, FULL
        n_before = ints[S.N]
        stop, fires = T.advance_triggers(trigger, buffer, t, first, last)
        taken = absorb(buffer, t, x, y, p, first, stop)
        at_limit = taken < stop or taken == first
        first = taken
        why = T.why_due(trigger, n_before, ints[S.N], fires)
        if why != T.NOT_DUE:
            best = classify_cells(buffer, plan, weights, maps, dirty, logits[n], probabilities[n])
            if best < 0:
                return first, n, NOT_FINITE
            if probabilities[n, best] >= level:
                why = T.BY_CONFIDENCE
            if why != T.LOOK:
                notes[n, 0] = ints[S.N]
                notes[n, 1] = ints[S.NEWEST_US]
                notes[n, 2] = why
                notes[n, 3] = best
                n += 1
                if why == T.BY_CONFIDENCE:
                    return first, n, CLOSE
        if at_limit:
            break
    return first, n, WENT_ON


@compiled
def _copy_logits(plan, maps, logits):
    at = np.uint64(plan[P.LOGITS])
    for k in range(logits.size):
        logits[k] = maps[at + np.uint64(k)]


@compiled
def softmax(logits, probabilities):
    """probabilities[k] = exp(logits[k] - max) / sum, in float64.

    Returns
    -------
    int : the first class of the largest logit; -1, and nothing written, if a logit is not finite.
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
