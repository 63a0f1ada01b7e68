"""When to decide: the triggers, and where their numbers lie.

The numbers lie in one flat float64 buffer, as in a volume's `state`. Kernels access it in two ways:
as `trigger`, and as `ints`, a view of the same memory as int64.
"""

import numpy as np
from numba import float64, int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.volume import state as S

# trigger
CONFIDENCE = 0  # a class probability that makes a decision due, see `is_sure`; inf: none does
# ints
EVERY_EVENTS = 1  # a decision after each so many events of a window; 0: not by number
# 1: classify at every event, as no other trigger determines when to test the confidence
EACH_EVENT = 2
EVERY_US = 3  # a decision after each so many microseconds of a window; 0: not by time
DUE_US = 4  # the next moment of EVERY_US in the oldest window; NEVER_US: none
N_AT_DECISION = 5  # events of the oldest window at its last triggered decision
SURE_CLASS = 6  # of a window that slides: the class of the last decision by CONFIDENCE; -1: none
SIZE = 7  # numbers in the buffer

TRIGGER = float64[::1]
"""Numba's type of the buffer."""

# why a decision is due
NOT_DUE = 0
ONLY_IF_SURE = 1  # it counts only if it reaches the confidence
BY_EVENTS = 2
BY_CONFIDENCE = 3
BY_TIME = 4


@entry_point(TRIGGER, int64, int64, int64)
def until_due(trigger, n, first, last):
    """The first of the events `first <= i < last` that must wait until a decision has been tested.

    Parameters
    ----------
    trigger : float64, see above.
    n : int. Events that the window holds now.

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


@entry_point(TRIGGER, int64, int64)
def why_due(trigger, n_before, n):
    """Why a decision is due: the one rule for it. One decision at most is made at an event.

    Parameters
    ----------
    trigger : float64, see above.
    n_before, n : int. Events that the window held at the last test, and holds now.

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


@inlined
def is_sure(trigger, is_sliding, best, probability):
    """Whether a decision is one by CONFIDENCE.

    It closes a window. A window that slides has no end: there the class must be another one than at
    the last such decision, and is noted.

    Parameters
    ----------
    trigger : float64, see above. Updated in place.
    is_sliding : bool.
    best, probability : int and float. The likeliest class.
    """
    if probability < trigger[CONFIDENCE]:
        return False
    if is_sliding:
        ints = trigger.view(np.int64)
        if ints[SURE_CLASS] == best:
            return False
        ints[SURE_CLASS] = best
    return True


@entry_point(TRIGGER, int64, int64)
def schedule(trigger, now_us, start_us):
    """Set DUE_US to the first moment of EVERY_US after `now_us`.

    Parameters
    ----------
    trigger : float64, see above. Updated in place.
    now_us, start_us : int. A time in the window, and the window's start.
    """
    ints = trigger.view(np.int64)
    every_us = ints[EVERY_US]
    ints[DUE_US] = S.NEVER_US
    if every_us > 0:
        ints[DUE_US] = min(start_us + ((now_us - start_us) // every_us + 1) * every_us, S.NEVER_US)
