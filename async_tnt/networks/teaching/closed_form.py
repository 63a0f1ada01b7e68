"""The logits of taught classes, in closed form from statistics.

A taught class t has one row r on the components x of the features, phi = (x, 1). Its logit
z_t = r . phi should lie M above s = log sum_k exp z_k where the class is shown, and M below it
elsewhere. Then s is the logit of "one of the trained classes", and the softmax over all logits is
about right. The row minimizes

    sum_c w_c E_c[(r . phi - s - M y)^2] + a |r_x|^2        y = 1 in class t, -1 elsewhere

in which E_c is the mean over the windows of class c, w_t = TAUGHT_SHARE, and all other classes (and
windows that show no class) have equal shares of the rest. So with G = sum w_c E_c[phi phi^T]:

    r = (G + a I_x)^-1 (sum w_c E_c[phi s] + M sum w_c E_c[phi] y)

which needs the moments of u = (x, s) only. The logits z of the trained classes stay as they are.
The row of a taught class depends on the moments of all other classes, taught ones included, but not
on their rows. Its M is chosen against the classes that are known when the class is taught, and then
kept, so M depends on the order in which classes are taught.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from async_tnt.networks.teaching.moments import Moments, merged
from async_tnt.networks.teaching.statistics import Statistics

TAUGHT_SHARE = 0.3
"""The share w_t of the taught class in the sum. With .5, and 50 recordings, old classes lose twice
as much; with .1, five recordings give 6 % fewer right windows of the new one (held-out N-MNIST)."""

RIDGE = 0.03
"""The weight a, as a share of the mean variance of the components. From .001 to .1 it hardly
matters."""

LEAST_SPREAD = 1e-200
"""The mean variance of the components up to which they say nothing, and a is 1. Features are
float32, so the square of any but 0 is larger. Numbers below 1e-308 have too few bits to divide."""

MARGIN = 8.0
"""The distance M if there are too few recordings to choose it."""

MARGINS = tuple(float(m) for m in np.geomspace(2.0, 32.0, 33))
"""The distances M of which one is chosen."""

LEAST_RECORDINGS = 5
"""The fewest recordings of a class from which its M is chosen."""

FOLDS = 20
"""The most parts that are left out in turn; with more recordings, a part has several."""

NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(20)
"""Points and weights for means over a normal distribution."""


@dataclass(frozen=True)
class Row:
    """The row r = level + M rise of a class, on phi = (x, 1), for any M.

    Parameters
    ----------
    level : float64, (p + 1,). Its product with phi is about s.
    rise : float64, (p + 1,). Its product with phi is about 1 in the class and -1 elsewhere.
    """

    level: np.ndarray
    rise: np.ndarray

    def at(self, margin: float) -> np.ndarray:
        """The row for the distance M."""
        return np.asarray(self.level + margin * self.rise)


def row_of(
    taught: Moments,
    others: Sequence[Moments],
    *,
    share: float = TAUGHT_SHARE,
    ridge: float = RIDGE,
) -> Row:
    """The row of a class.

    Parameters
    ----------
    taught : moments of u in windows of the class.
    others : moments of u in windows of each other class, and in windows that show none.
    share, ridge : see `TAUGHT_SHARE` and `RIDGE`.
    """
    p = taught.size - 1
    phi = [*range(p), p + 1]  # of (x, s, 1)
    of_each = (1.0 - share) / len(others)
    rest = of_each * np.sum([moments.second for moments in others], axis=0)
    mine = share * taught.second
    both = mine + rest
    gram = both[np.ix_(phi, phi)]
    spread = np.trace(gram[:p, :p]) / p
    gram[np.arange(p), np.arange(p)] += ridge * spread if spread > LEAST_SPREAD else 1.0
    targets = np.stack([both[phi, p], (mine - rest)[phi, -1]], axis=1)
    level, rise = np.linalg.solve(gram, targets).T
    return Row(level, rise)


def others_of(statistics: Statistics, name: str) -> dict[str | None, Moments]:
    """The moments of all classes but `name`.

    If the moments of windows that show nothing are known, their key is None.
    """
    others: dict[str | None, Moments] = {
        other: moments for other, moments in statistics.moments.items() if other != name
    }
    if statistics.nothing is not None:
        others[None] = statistics.nothing
    return others


def rows_of(statistics: Statistics) -> np.ndarray:
    """The rows of all taught classes: float64, (number of them, p + 1)."""
    rows = [
        row_of(statistics.moments[name], list(others_of(statistics, name).values())).at(margin)
        for name, margin in statistics.margins.items()
    ]
    return np.stack(rows)


def weights_of(statistics: Statistics) -> tuple[np.ndarray, np.ndarray]:
    """The rows of taught classes on the features f themselves.

    r . (P^T (f - f0), 1) = (P r_x) . f + r_1 - (P r_x) . f0

    Returns
    -------
    weight, bias : float32, (number of taught classes, D) and (number of taught classes,).
    """
    rows = rows_of(statistics)
    weight = rows[:, :-1] @ statistics.projection.astype(np.float64).T
    bias = rows[:, -1] - weight @ statistics.center
    return weight.astype(np.float32), bias.astype(np.float32)


# -- what a class takes of the others --------------------------------------------------------------


def _difference(row: Row, moments: Moments) -> tuple[np.ndarray, np.ndarray]:
    """Mean (2,) and covariance (2, 2) of (level . phi - s, rise . phi) in windows of a class."""
    on_u = np.zeros((2, moments.size))
    on_u[0, :-1] = row.level[:-1]
    on_u[0, -1] = -1.0
    on_u[1, :-1] = row.rise[:-1]
    mean = on_u @ moments.mean + [row.level[-1], row.rise[-1]]
    return mean, on_u @ moments.covariance @ on_u.T


def taken(row: Row, margin: float, moments: Moments) -> float:
    """The share of a class's windows in which z_t > s, if z_t - s is normally distributed.

    Examples
    --------
    >>> moments = Moments.of(np.array([[0.0, 3.0], [0.0, 1.0]]))  # s is 3 or 1, x says nothing
    >>> row = Row(np.array([0.0, 1.0]), np.zeros(2))  # z_t is always 1: one deviation below
    >>> round(taken(row, 8.0, moments), 4)
    0.1587
    """
    mean, covariance = _difference(row, moments)
    along = np.array([1.0, margin])
    centre = float(along @ mean)
    deviation = math.sqrt(max(0.0, float(along @ covariance @ along)))
    if deviation == 0.0:
        return float(centre > 0)
    return 0.5 * math.erfc(-centre / deviation / math.sqrt(2.0))


# -- the distance M --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Choice:
    """The distance M of a class, and what it was chosen by.

    Parameters
    ----------
    margin : M.
    held_out : share of the class's readings that are right while their recording is left out; None
        if there are fewer than `LEAST_RECORDINGS`, and M is the default.
    """

    margin: float
    held_out: float | None = None


def choose_margin(recordings: Sequence[np.ndarray], others: Mapping[str | None, Moments]) -> Choice:
    """The distance M under which what is left out is likeliest.

    Each recording (or part of `FOLDS`) is left out in turn, and the row is made of the rest. Then M
    minimizes the mean of log(1 + exp(-+(z_t - s))) over classes: of the class itself over readings
    that were left out, of the others over a normal distribution. Each class counts alike. So M is
    an inverse temperature of the class: it makes the probabilities right.

    Parameters
    ----------
    recordings : the vectors u of each recording of the class, (N, p + 1).
    others : moments of u in windows of each other class, and in windows that show nothing.
    """
    if len(recordings) < LEAST_RECORDINGS:
        return Choice(MARGIN)
    parts = np.array_split(np.arange(len(recordings)), min(FOLDS, len(recordings)))
    moments = [Moments.of(np.concatenate([recordings[i] for i in part])) for part in parts]
    rest = list(others.values())
    differences = []
    for k, part in enumerate(parts):
        row = row_of(merged(moments[:k] + moments[k + 1 :]), rest)
        u = np.concatenate([recordings[i] for i in part])
        phi = np.hstack([u[:, :-1], np.ones((len(u), 1))])
        differences.append(np.stack([phi @ row.level - u[:, -1], phi @ row.rise], axis=1))
    own = np.concatenate(differences)
    row = row_of(merged(moments), rest)
    theirs = [_difference(row, other) for other in rest]

    losses = [_loss(own, theirs, margin) for margin in MARGINS]
    margin = MARGINS[int(np.argmin(losses))]
    return Choice(margin, float((own @ [1.0, margin] > 0).mean()))


def _loss(own: np.ndarray, theirs: Sequence[tuple[np.ndarray, np.ndarray]], margin: float) -> float:
    """The mean over classes of the logarithmic loss of "is it this class", see `choose_margin`."""
    along = np.array([1.0, margin])
    losses = [np.logaddexp(0.0, -(own @ along)).mean()]
    for mean, covariance in theirs:
        deviation = math.sqrt(max(0.0, float(along @ covariance @ along)))
        at_nodes = np.logaddexp(0.0, float(along @ mean) + deviation * NODES)
        losses.append(float(at_nodes @ NODE_WEIGHTS / NODE_WEIGHTS.sum()))
    return float(np.mean(losses))
