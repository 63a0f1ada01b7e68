"""When to decide: the triggers, and where their numbers lie.

Like a volume's `state`, one flat float64 buffer seen twice: as `trigger`, and as `ints`, the same memory as int64.
"""

import numpy as np

from . import state as S
from .jit import compiled

# trigger
CONFIDENCE = 0  # confidence: a class probability that closes the window; inf: none
THRESHOLD = 1  # activity: fires at this potential; inf: never
LEAK_US = 2  # the potential's time constant
CHARGE = 3  # what each event adds
POTENTIAL = 4
# ints
EVERY_EVENTS = 5  # 0: not by number
EACH_EVENT = 6  # 1: classify at every event, as no other trigger determines when to test the confidence
CHARGED_US = 7  # newest time up to which the potential has leaked
EVERY_US = 8  # 0: not by time
DUE_US = 9  # next moment of EVERY_US in the oldest window; NEVER_US: none
N_DECIDED = 10  # events of the oldest window at its last triggered decision
SIZE = 11

NOT_DUE, LOOK, BY_EVENTS, BY_ACTIVITY, BY_CONFIDENCE, BY_TIME = range(6)  # LOOK: decide only if confident enough


@compiled
def advance_triggers(trigger, buffer, t, first, last):
    """How far events may be absorbed until a decision may be due.

    The potential of the leaky integrate-and-fire trigger after event i, at time t_i, is

        v_i = v_{i-1} exp(-max(0, t_i - t') / leak_us) + charge        t': the newest time before

    It fires where v_i >= threshold, and then is 0.

    Parameters
    ----------
    trigger : float64, see above. The potential is updated for the events up to the stop.
    buffer : float64, the `state` of the volume that will absorb them; late events and those past its limit do not
        charge.
    t, first, last : the events `first <= i < last`.

    Returns
    -------
    stop : int. Absorb the events before it, and then test whether a decision is due.
    fires : bool. Whether activity makes it due there.
    """
    ints = trigger.view(np.int64)
    volume_ints = buffer.view(np.int64)
    stop = last
    if ints[EVERY_EVENTS] > 0:
        stop = min(stop, first + ints[EVERY_EVENTS] - volume_ints[S.N] % ints[EVERY_EVENTS])
    if ints[EACH_EVENT] != 0:
        stop = min(stop, first + 1)
    if trigger[THRESHOLD] < np.inf:
        for i in range(first, stop):
            if t[i] >= volume_ints[S.LIMIT_US]:
                return i, False
            if t[i] < volume_ints[S.START_US]:
                continue
            passed_us = t[i] - ints[CHARGED_US]
            if passed_us > 0:
                trigger[POTENTIAL] *= np.exp(-np.float64(passed_us) / trigger[LEAK_US])
                ints[CHARGED_US] = t[i]
            trigger[POTENTIAL] += trigger[CHARGE]
            if trigger[POTENTIAL] >= trigger[THRESHOLD]:
                trigger[POTENTIAL] = 0.0
                return i + 1, True
    return stop, False


@compiled
def why_due(trigger, n_before, n, fires):
    """Why a decision is due now that a window holds `n` events and held `n_before` before: the one rule for it.

    Parameters
    ----------
    trigger : float64, see above.
    fires : bool. As `advance_triggers` returned it.

    Returns
    -------
    int : NOT_DUE, LOOK, BY_EVENTS or BY_ACTIVITY.
    """
    ints = trigger.view(np.int64)
    if n == n_before:  # nothing came, or late events only
        return NOT_DUE
    if ints[EVERY_EVENTS] > 0 and n % ints[EVERY_EVENTS] == 0:
        return BY_EVENTS
    if fires:
        return BY_ACTIVITY
    return LOOK if ints[EACH_EVENT] != 0 else NOT_DUE


@compiled
def schedule(trigger, now_us, start_us):
    """Set the next moment of `every_us`: the first after `now_us` in a window that starts at `start_us`."""
    ints = trigger.view(np.int64)
    every_us = ints[EVERY_US]
    ints[DUE_US] = S.NEVER_US
    if every_us > 0:
        ints[DUE_US] = min(start_us + ((now_us - start_us) // every_us + 1) * every_us, S.NEVER_US)
