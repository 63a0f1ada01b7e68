"""When to decide: the triggers, and where their numbers lie.

Like a volume's `state`, one flat float64 buffer seen twice: as `trigger`, and as `ints`, the same
memory as int64.
"""

import numpy as np

from async_tnt.kernels.jit import compiled
from async_tnt.kernels.volume import state as S

# trigger
CONFIDENCE = 0  # confidence: a class probability that closes the window; inf: none
# ints
EVERY_EVENTS = 1  # 0: not by number
# 1: classify at every event, as no other trigger determines when to test the confidence
EACH_EVENT = 2
EVERY_US = 3  # 0: not by time
DUE_US = 4  # next moment of EVERY_US in the oldest window; NEVER_US: none
N_AT_DECISION = 5  # events of the oldest window at its last triggered decision
SIZE = 6

NOT_DUE, ONLY_IF_SURE, BY_EVENTS, BY_CONFIDENCE, BY_TIME = range(5)


@compiled
def until_due(trigger, n, first, last):
    """Up to which of the events `first <= i < last` none before makes a decision due in a window of
    `n` events.

    Returns
    -------
    stop : int. Absorb the events before it, and then test whether a decision is due.
    """
    ints = trigger.view(np.int64)
    if ints[EACH_EVENT] != 0:
        return min(last, first + 1)
    if ints[EVERY_EVENTS] > 0:
        return min(last, first + ints[EVERY_EVENTS] - n % ints[EVERY_EVENTS])
    return last


@compiled
def why_due(trigger, n_before, n):
    """Why a decision is due now that a window holds `n` events and held `n_before` before: the one
    rule for it.

    Parameters
    ----------
    trigger : float64, see above.

    Returns
    -------
    int : NOT_DUE, ONLY_IF_SURE or BY_EVENTS.
    """
    ints = trigger.view(np.int64)
    if n == n_before:  # nothing came, or late events only
        return NOT_DUE
    if ints[EVERY_EVENTS] > 0 and n % ints[EVERY_EVENTS] == 0:
        return BY_EVENTS
    return ONLY_IF_SURE if ints[EACH_EVENT] != 0 else NOT_DUE


@compiled
def schedule(trigger, now_us, start_us):
    """Set the next moment of `every_us`: the first after `now_us` in a window that starts at
    `start_us`."""
    ints = trigger.view(np.int64)
    every_us = ints[EVERY_US]
    ints[DUE_US] = S.NEVER_US
    if every_us > 0:
        ints[DUE_US] = min(start_us + ((now_us - start_us) // every_us + 1) * every_us, S.NEVER_US)
