"""All decisions of a part of a packet, from one compiled call after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.kernels.decisions import trigger as T
from async_tnt.kernels.decisions.classify import DECISION_FIELDS, FULL, NOT_FINITE
from async_tnt.streaming.decision import Decision, Trigger

TRIGGER_NAMES: dict[int, Trigger] = {
    T.ONLY_IF_SURE: "confidence",
    T.BY_EVENTS: "every_events",
    T.BY_CONFIDENCE: "confidence",
    T.BY_TIME: "every_us",
}
"""Number of the cause, as a kernel states it -> trigger of the Decision."""

ROWS = 256
"""The most decisions that one compiled call makes."""

STRETCH = 500
"""The fewest events for which one compiled call saves time, if decisions are due by time alone."""

Call = Callable[[int, np.ndarray, np.ndarray, np.ndarray], tuple[int, int, int]]
"""Absorbs events from a first one on, and decides: (first, logits, probabilities, notes) -> the
first event not absorbed, the number of decisions, and why it returned, see `kernels.decisions.
classify.absorb_and_decide`."""


def decide_stretch(
    call: Call,
    classes: Sequence[str],
    triggers: np.ndarray,
    first: int,
    last: int,
    *,
    slides: bool = False,
) -> tuple[int, list[Decision], ValueError | None]:
    """Add the events `first <= i < last` to a window, and decide whenever a decision is due.

    Parameters
    ----------
    call : the compiled call.
    classes : class names.
    triggers : float64, see `kernels.decisions.trigger`.
    slides : whether the window slides, so that no decision closes it.

    Returns
    -------
    absorbed : int, the first event not added. It is `last`, the first event at or past the volume's
        limit, or the event after a decision that reached the level of confidence.
    decisions : list of Decision, in order.
    error : ValueError if the next decision would have logits that are not finite, else None.
    """
    every_events = int(triggers.view(np.int64)[T.EVERY_EVENTS])
    blocks = []
    absorbed = first
    outcome = FULL
    while outcome == FULL:
        # These arrays have room for the decisions of most packets. If they are full, the next call
        # goes on with new arrays.
        n_rows = last - absorbed
        if every_events:
            n_rows = n_rows // every_events + 1
        logits = np.empty((min(ROWS, n_rows), len(classes)), np.float32)
        probabilities = np.empty(logits.shape)
        notes = np.empty((len(logits), DECISION_FIELDS), np.int64)
        absorbed, n, outcome = call(absorbed, logits, probabilities, notes)
        blocks.append((notes[:n].tolist(), probabilities, logits))

    decisions = []
    for rows, block_probabilities, block_logits in blocks:
        for k, (n_events, time_us, why, index, start_us) in enumerate(rows):
            decision = Decision(
                classes[index],
                index,
                block_probabilities[k],
                block_logits[k],
                start_us,
                time_us,
                n_events,
                why == T.BY_CONFIDENCE and not slides,
                TRIGGER_NAMES[why],
            )
            decisions.append(decision)
    error = not_finite_error(logits[n]) if outcome == NOT_FINITE else None
    return absorbed, decisions, error


def not_finite_error(logits: np.ndarray) -> ParameterValueError:
    """The error about logits that are not all finite."""
    got = short(logits.tolist())
    return ParameterValueError("classifier", "must return finite logits", got)
