"""Objects on a map of logits: peaks of how much likelier some class is than nothing."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch.nn import functional as F


class FoundObject(NamedTuple):
    """A class by its number, its probability, and where on the map it stands, in columns and rows."""

    label: int
    probability: float
    column: float
    row: float


def objects_on_map(logits: torch.Tensor, near: int = 1) -> list[FoundObject]:
    """The objects on a map, the likeliest first.

        s(y, x) = max_k<K z_k(y, x) - z_K(y, x)                            a class against nothing, the last channel
        (y, x) is a peak:  s > 0, s > s(y', x') of the places before it, s >= s(y', x') of those behind it, by rows,
                           for all |y' - y|, |x' - x| <= near
        place = sum of s+ (y', x') over the 3x3 places around the peak / sum of s+,  s+ = max(s, 0)

    Parameters
    ----------
    logits : (K + 1, R, C).

    Example
    -------
    >>> logits = torch.zeros(2, 3, 4)
    >>> logits[0, 1, 2], logits[0, 1, 3] = 3.0, 1.0
    >>> logits[1] += 0.5
    >>> [(found.label, round(found.column, 3), found.row) for found in objects_on_map(logits)]
    [(0, 2.167, 1.0)]
    """
    z = logits.double()
    s = z[:-1].amax(0) - z[-1]  # (R, C)
    rows, columns = s.shape
    side = 2 * near + 1
    around = F.unfold(F.pad(s[None, None], [near] * 4, value=-torch.inf), side).reshape(side * side, rows, columns)
    middle = side * side // 2
    is_peak = (s > 0) & (around[:middle] < s).all(0) & (around[middle + 1 :] <= s).all(0)
    probabilities = torch.softmax(z, 0)
    found = []
    for row, column in is_peak.nonzero().tolist():
        ys = torch.arange(max(0, row - 1), min(rows, row + 2))
        xs = torch.arange(max(0, column - 1), min(columns, column + 2))
        weights = s[ys][:, xs].clamp(min=0)
        index = int(z[:-1, row, column].argmax())
        place_x, place_y = (weights.sum(0) * xs).sum() / weights.sum(), (weights.sum(1) * ys).sum() / weights.sum()
        found.append(FoundObject(index, float(probabilities[index, row, column]), float(place_x), float(place_y)))
    return sorted(found, key=lambda one: -one.probability)
