"""The rule by which a training ends before its last epoch.

A training settles when no measurement on held-out windows can improve any more. Then it ends early.

A model has the weights of the last epoch, and the learning rate must have fallen to 0 by then. So a
settled training does not stop at once. It goes on for `COOLING` more epochs, over which the rate
falls to 0.

    settled      after the first epoch e for which both conditions hold in all of the epochs
                 e - PATIENCE + 1 .. e:
                 - every value of `SHARES` is 1
                 - no loss of `LOSSES` gains. A loss gains when it falls by the share GAIN or more
                   below its value at its last gain
    last epoch   min(e + COOLING, the epochs that were asked for)

The rule depends on the history alone. So a training that was interrupted and resumed ends in the
same epoch. If nothing is held out, a training never settles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

PATIENCE = 10
"""Number of epochs without an improvement after which a training has settled."""
GAIN = 0.1
"""Share by which a held-out loss must fall to count as an improvement.

If few windows are held out, all of them are soon right. From then on only their loss shows that the
network still learns. An example is a training on three of N-MNIST's digits with 18 held-out
windows. All 18 were right from epoch 10 on. Yet the share of right windows among 540 others still
rose: .876 after 15 epochs, .898 after 34 and .915 after 98."""
COOLING = 5
"""Number of epochs over which the learning rate falls to 0."""
SHARES = ("per_window", "per_recording", "f1", "motions_per_window")
"""Names of the measurements in the history that are 1 when all held-out windows are right."""
LOSSES = ("validation_loss", "motions_validation_loss")
"""Names of the measurements in the history that are losses on held-out windows."""


def settled_at(history: Sequence[Mapping[str, float]]) -> int | None:
    """The epoch, counted from 1, after which the training has settled; None if it has not yet.

    Parameters
    ----------
    history : a row for each epoch, as `train` returns it.

    Examples
    --------
    >>> perfect = {"per_window": 1.0, "per_recording": 1.0, "validation_loss": 0.1}
    >>> settled_at([perfect] * 10), settled_at([perfect] * 11)
    (None, 11)
    >>> settled_at([perfect | {"per_window": 0.9}] * 99) is None
    True
    """
    lowest = dict.fromkeys(LOSSES, float("inf"))
    n_perfect = 0
    n_without_gain = 0
    for epoch, row in enumerate(history, 1):
        shares = [row[name] for name in SHARES if name in row]
        is_perfect = bool(shares) and min(shares) == 1.0
        n_perfect = n_perfect + 1 if is_perfect else 0
        has_gained = False
        for name in LOSSES:
            # a loss of 0, or just below 0 by rounding, gains no more unless it falls
            falls = name in row and row[name] < lowest[name]
            if falls and row[name] <= (1 - GAIN) * lowest[name]:
                lowest[name] = row[name]
                has_gained = True
        n_without_gain = 0 if has_gained else n_without_gain + 1
        if min(n_perfect, n_without_gain) >= PATIENCE:
            return epoch
    return None


def share_while_cooling(step: int, first: int, last: int) -> float:
    """The share of the learning rate that is left at `step`: 1 at step `first`, 0 at step `last`.

    Examples
    --------
    >>> [share_while_cooling(step, 10, 14) for step in range(10, 14)]
    [1.0, 0.75, 0.5, 0.25]
    """
    return (last - step) / (last - first)
