"""Objects on a map of logits, and their numbers over time.

An object is a peak of the difference between the logit of the likeliest class and the logit of "no
object here", which is the last channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch.nn import functional as F


class FoundObject(NamedTuple):
    """An object: the index of its class, its probability, and its place on the map.

    The place is given in columns and rows.
    """

    label: int
    probability: float
    column: float
    row: float


def objects_on_map(logits: torch.Tensor, near: int = 1) -> list[FoundObject]:
    """The objects on a map, the likeliest first.

        s(y, x) = max_k<K z_k(y, x) - z_K(y, x)
        (y, x) is a peak:  s > 0
                           s >  s(y', x')   at the places before (y, x), row by row
                           s >= s(y', x')   at the places behind (y, x)
                           for all |y' - y|, |x' - x| <= near
        place = sum of s+ (y', x') over the 3x3 places around the peak / sum of s+
        s+ = max(s, 0)

    Parameters
    ----------
    logits : (K + 1, R, C): a channel for each class, then one for "no object here".
    near : number of rows and of columns around an object in which there is no other object.

    Example
    -------
    >>> logits = torch.zeros(2, 3, 4)
    >>> logits[0, 1, 2] = 3.0
    >>> logits[0, 1, 3] = 1.0
    >>> logits[1] += 0.5
    >>> [(found.label, round(found.column, 3), found.row) for found in objects_on_map(logits)]
    [(0, 2.167, 1.0)]
    """
    z = logits.double()
    s = z[:-1].amax(0) - z[-1]  # (R, C)
    rows, columns = s.shape
    side = 2 * near + 1
    padded = F.pad(s[None, None], [near] * 4, value=-torch.inf)
    windows = F.unfold(padded, side).reshape(side * side, rows, columns)
    n_before = side * side // 2  # places of a window before its middle
    is_peak = (s > 0) & (windows[:n_before] < s).all(0) & (windows[n_before + 1 :] <= s).all(0)
    probabilities = torch.softmax(z, 0)
    objects = []
    for row, column in is_peak.nonzero().tolist():
        ys = torch.arange(max(0, row - 1), min(rows, row + 2))
        xs = torch.arange(max(0, column - 1), min(columns, column + 2))
        weights = s[ys][:, xs].clamp(min=0)
        index = int(z[:-1, row, column].argmax())
        place_x = float((weights.sum(0) * xs).sum() / weights.sum())
        place_y = float((weights.sum(1) * ys).sum() / weights.sum())
        probability = float(probabilities[index, row, column])
        objects.append(FoundObject(index, probability, place_x, place_y))
    return sorted(objects, key=lambda found_object: -found_object.probability)


class _KnownObject(NamedTuple):
    """An object of an earlier decision.

    number : the object's number.
    x, y, time_us : where and when the object was seen last.
    decision : the last decision that saw the object, counted from 0.
    rank : how many objects of that decision were likelier.
    """

    number: int
    x: float
    y: float
    time_us: int
    decision: int
    rank: int


class ObjectNumbers:
    """Numbers for the objects of one decision after another.

    An object keeps its number while it moves little.

    The objects of a decision are numbered from the likeliest on. Each takes the number of the
    nearest known object whose number is not taken yet, if

        ((x - x') / reach_x)^2 + ((y - y') / reach_y)^2 < 1    and    time - time' <= memory_us

    If there is no such object, the object gets a new number. Among known objects that are equally
    near, it takes the number of the one seen by the latest decision and, within that decision, of
    the likeliest one.

    After a decision, its `most` likeliest objects are known. Objects of earlier decisions are
    added, those of the latest decision first, until `room` objects are known.

    Parameters
    ----------
    reach : (x, y), in pixels.
    memory_us : how long an object that is not found again is known.
    most : how many objects of a decision, from the likeliest on, may take the number of a known
        object.
    room : how many objects are known at a time.

    Example
    -------
    >>> numbers = ObjectNumbers((4.0, 4.0), memory_us=1000, most=2, room=4)
    >>> numbers.follow(0, [(10.0, 10.0), (30.0, 10.0)])
    [0, 1]
    >>> numbers.follow(100, [(33.0, 10.0), (20.0, 10.0)])
    [1, 2]
    """

    def __init__(self, reach: tuple[float, float], memory_us: int, most: int, room: int) -> None:
        self.reach = reach
        self.memory_us = memory_us
        self.most = most
        self.room = room
        self.known: list[_KnownObject] = []
        self.next_number = 0
        self.decision = 0

    def follow(self, time_us: int, places: Sequence[tuple[float, float]]) -> list[int]:
        """The numbers of a decision's objects, given by their (x, y), the likeliest first."""
        free_objects = [known for known in self.known if time_us - known.time_us <= self.memory_us]
        current_objects = []
        for rank, (x, y) in enumerate(places):
            near = [
                known
                for known in free_objects
                if self._distance(known, x, y) < 1 and rank < self.most
            ]
            number = self.next_number
            if near:
                nearest = min(near, key=lambda known: self._preference(known, x, y))
                free_objects.remove(nearest)
                number = nearest.number
            else:
                self.next_number += 1
            current_objects.append(_KnownObject(number, x, y, time_us, self.decision, rank))
        earlier = sorted(free_objects, key=lambda known: (-known.decision, known.rank))
        self.known = (current_objects[: self.most] + earlier)[: self.room]
        self.decision += 1
        return [known.number for known in current_objects]

    def _preference(self, known: _KnownObject, x: float, y: float) -> tuple[float, int, int]:
        """A key of a known object: an object at (x, y) takes the number with the lowest key."""
        return self._distance(known, x, y), -known.decision, known.rank

    def _distance(self, known: _KnownObject, x: float, y: float) -> float:
        """The squared distance, in units of the reach."""
        return float(((x - known.x) / self.reach[0]) ** 2 + ((y - known.y) / self.reach[1]) ** 2)
