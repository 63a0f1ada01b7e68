"""When a training ends before its last epoch: where nothing that is measured on held-out windows
can improve.

The weights of the last epoch are kept, and the learning rate falls to 0 by then. So a training does
not stop where it stands: it is given `COOLING` more epochs, over which the rate falls.

    settled at epoch e   every share of what is held out was 1 after each of the epochs e - PATIENCE
                         + 1 .. e, and no held-out loss has fallen in these by the share GAIN or
                         more of what it was when it last did
    last epoch           min(e + COOLING, as many as were asked for), of the first such e

All of it follows from the history alone, so that a training that was interrupted ends in the same
epoch. Without anything held out, a training never settles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

PATIENCE = 10
"""Epochs."""
GAIN = 0.1
"""Share of the held-out loss. Where few windows are held out, all are soon right, and only their
loss still tells that the network learns: of three of N-MNIST's digits, with 18 windows held out,
.876 of 540 others were right after 15 epochs, .898 after 34 and .915 after 98, though all that were
held out were right from the tenth on."""
COOLING = 5
"""Epochs over which the learning rate falls to 0."""
SHARES = ("per_window", "per_recording", "f1", "motions_per_window")
LOSSES = ("validation_loss", "motions_validation_loss")


def settled_at(history: Sequence[Mapping[str, float]]) -> int | None:
    """The epoch, from 1 on, after which nothing that is measured could improve; None: there is none
    yet.

    Parameters
    ----------
    history : of `train`, a row for each epoch.

    Examples
    --------
    >>> perfect = {"per_window": 1.0, "per_recording": 1.0, "validation_loss": 0.1}
    >>> settled_at([perfect] * 10), settled_at([perfect] * 11), settled_at([perfect | {"per_window": 0.9}] * 99)
    (None, 11, None)
    """
    lowest = dict.fromkeys(LOSSES, float("inf"))
    n_perfect = n_without_gain = 0
    for epoch, row in enumerate(history, 1):
        shares = [row[name] for name in SHARES if name in row]
        is_perfect = bool(shares) and min(shares) == 1.0
        n_perfect = n_perfect + 1 if is_perfect else 0
        gained = [name for name in LOSSES if name in row and row[name] <= (1 - GAIN) * lowest[name]]
        for name in gained:
            lowest[name] = row[name]
        n_without_gain = 0 if gained else n_without_gain + 1
        if min(n_perfect, n_without_gain) >= PATIENCE:
            return epoch
    return None


def share_while_cooling(step: int, first: int, last: int) -> float:
    """The share that is left of the learning rate of step `first`, at a step in first .. last - 1.
    It falls to 0.

    Examples
    --------
    >>> [share_while_cooling(step, 10, 14) for step in range(10, 14)]
    [1.0, 0.75, 0.5, 0.25]
    """
    return (last - step) / (last - first)
