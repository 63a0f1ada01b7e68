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
    """An object: the index of its class, its probability, and its place and size on the map.

    Place and size are given in columns and rows. The size is 0 if the map has none.
    """

    label: int
    probability: float
    column: float
    row: float
    width: float = 0.0
    height: float = 0.0


def box_overlap(
    place: torch.Tensor, size: torch.Tensor, other_place: torch.Tensor, other_size: torch.Tensor
) -> torch.Tensor:
    """The area that two boxes share, divided by the area that they cover; 0 without areas.

    Each box has a middle (x, y) and a size (width, height): float64, (..., 2). If the first boxes
    have the shape (N, 1, 2) and the others (K, 2), the result, (N, K), has the overlaps of all
    pairs.

    Example
    -------
    >>> middle, side = torch.zeros(2).double(), torch.full((2,), 8.0).double()
    >>> float(box_overlap(middle, side, middle + torch.tensor([4.0, 0.0]), side))
    0.3333333333333333
    """
    upper = torch.minimum(place + size / 2, other_place + other_size / 2)
    lower = torch.maximum(place - size / 2, other_place - other_size / 2)
    shared = (upper - lower).clamp(min=0).prod(-1)
    covered = size.prod(-1) + other_size.prod(-1) - shared
    return torch.where(covered > 0, shared / covered, 0.0)


def _pairs(pairs: Sequence[tuple[float, float]]) -> torch.Tensor:
    """Float64, (N, 2)."""
    return torch.tensor(pairs, dtype=torch.float64).reshape(-1, 2)


def boxes_on_map(
    maps: torch.Tensor,
    scale: tuple[float, float],
    most_overlap: float = 0.5,
    near: int = 1,
    *,
    has_places: bool = False,
) -> list[FoundObject]:
    """The objects on a map whose last channels say what boxes they have, the likeliest first.

    At a peak of the logits, see `objects_on_map`, with the numbers a and b of two channels:

        width = exp(min(max(a, -10), 10))    height = exp(min(max(b, -10), 10))

    in columns and rows. With the numbers c and d of two more, the place of an object is not the
    mean over places around its peak, but

        column = x + min(max(c, -10), 10)    row = y + min(max(d, -10), 10)

    with the column x and the row y of the peak. From the likeliest on, an object is left out if its
    box overlaps by more than `most_overlap` with that of an object of its class that is not left
    out.

    Parameters
    ----------
    maps : (K + n, R, C), with n channels that are no classes: 3, or 5 if they say places.
    scale : the distances between neighbouring columns and rows: boxes overlap in these units.
    has_places : whether the map says where the middles of boxes are.
    """
    # the last of the n channels that are no classes belongs to the logits: "no object here"
    n_numbers = 4 if has_places else 2
    boxes = maps[-n_numbers:].double().clamp(-10, 10)
    places = boxes[2:] if has_places else None
    objects = objects_on_map(maps[:-n_numbers], near, boxes[:2].exp(), places)
    numbers = torch.tensor(objects, dtype=torch.float64).reshape(-1, len(FoundObject._fields))
    middle = numbers[:, 2:4] * _pairs([scale])
    size = numbers[:, 4:] * _pairs([scale])
    overlaps = box_overlap(middle[:, None], size[:, None], middle, size)
    is_same_class = numbers[:, None, 0] == numbers[:, 0]
    excludes = ((overlaps > most_overlap) & is_same_class).tolist()
    kept: list[int] = []
    for i in range(len(objects)):
        if not any(excludes[i][k] for k in kept):
            kept.append(i)
    return [objects[i] for i in kept]


def objects_on_map(
    logits: torch.Tensor,
    near: int = 1,
    sizes: torch.Tensor | None = None,
    places: torch.Tensor | None = None,
) -> list[FoundObject]:
    """The objects on a map, the likeliest first; of equally likely ones the first, row by row.

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
    sizes : (2, R, C), the width and height of an object at each place; None: objects have none.
    places : (2, R, C), how many columns to the right and how many rows down from each place an
        object there is; None: its place is the mean above.

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
    windows = _around(s, near, -torch.inf)
    n_before = len(windows) // 2  # places of a window before its middle
    is_peak = (s > 0) & (windows[:n_before] < s).all(0) & (windows[n_before + 1 :] <= s).all(0)
    rows, columns = is_peak.nonzero().T

    label = z[:-1, rows, columns].argmax(0)
    # Equal logits must have equal probabilities, to the bit. Torch's vectorized exp rounds the last
    # columns of a tensor otherwise than the others, so equal columns are computed once.
    different, which = torch.unique(z[:, rows, columns], dim=1, return_inverse=True)
    probability = torch.softmax(different, 0)[:, which].gather(0, label[None])[0]
    weights = _around(s.clamp(min=0), 1, 0.0)[:, rows, columns]  # (9, N)
    down, right = torch.meshgrid(torch.arange(-1, 2), torch.arange(-1, 2), indexing="ij")
    place_x = (weights * (columns + right.reshape(9, 1))).sum(0) / weights.sum(0)
    place_y = (weights * (rows + down.reshape(9, 1))).sum(0) / weights.sum(0)
    if places is not None:
        place_x, place_y = torch.stack([columns, rows]) + places[:, rows, columns]
    size = torch.zeros(2, len(rows)) if sizes is None else sizes[:, rows, columns]

    fields = (label, probability, place_x, place_y, *size)
    found = zip(*(field.tolist() for field in fields), strict=True)
    objects = [FoundObject(*one) for one in found]
    return sorted(objects, key=lambda found_object: -found_object.probability)


def _around(s: torch.Tensor, near: int, border: float) -> torch.Tensor:
    """The values at and around each place, row by row: ((2 near + 1)^2, R, C) of (R, C).

    border : the value around the map.
    """
    side = 2 * near + 1
    padded = F.pad(s[None, None], [near] * 4, value=border)
    return F.unfold(padded, side).reshape(side * side, *s.shape)


class _KnownObject(NamedTuple):
    """An object of an earlier decision.

    number : the object's number.
    x, y, time_us : where and when the object was seen last.
    size : the width and height of its box then.
    decision : the last decision that saw the object, counted from 0.
    rank : how many objects of that decision were likelier.
    """

    number: int
    x: float
    y: float
    time_us: int
    decision: int
    rank: int
    size: tuple[float, float] = (0.0, 0.0)


class ObjectNumbers:
    """Numbers for the objects of one decision after another.

    An object keeps its number while it moves little.

    The objects of a decision are numbered from the likeliest on. Each takes the number of the
    nearest known object whose number is not taken yet, if

        ((x - x') / reach_x)^2 + ((y - y') / reach_y)^2 < 1    and    time - time' <= memory_us

    An object with a box takes the number of the known object whose box overlaps most with its own,
    however near others are; of equal overlaps, the nearer one.

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

    def follow(
        self,
        time_us: int,
        places: Sequence[tuple[float, float]],
        sizes: Sequence[tuple[float, float]] | None = None,
    ) -> list[int]:
        """The numbers of a decision's objects, given by their (x, y), the likeliest first.

        sizes : the width and height of their boxes; None: they have none.
        """
        known = [known for known in self.known if time_us - known.time_us <= self.memory_us]
        if sizes is None:
            sizes = [(0.0, 0.0)] * len(places)
        overlaps, distances = self._compared(places, sizes, known)
        is_free = torch.ones(len(known), dtype=torch.bool)
        current_objects = []
        for rank, (x, y) in enumerate(places):
            near: list[int] = []
            if rank < self.most and is_free.any():
                overlap = overlaps[rank]
                is_most = is_free & (overlap == overlap[is_free].max())
                near = (is_most & ((overlap > 0) | (distances[rank] < 1))).nonzero()[:, 0].tolist()
            number = self.next_number
            if near:
                distance = distances[rank].tolist()
                nearest = min(near, key=lambda k: (distance[k], -known[k].decision, known[k].rank))
                is_free[nearest] = False
                number = known[nearest].number
            else:
                self.next_number += 1
            current = _KnownObject(number, x, y, time_us, self.decision, rank, sizes[rank])
            current_objects.append(current)
        not_found = [known[k] for k in is_free.nonzero()[:, 0].tolist()]
        earlier = sorted(not_found, key=lambda known: (-known.decision, known.rank))
        self.known = (current_objects[: self.most] + earlier)[: self.room]
        self.decision += 1
        return [current.number for current in current_objects]

    def _compared(
        self,
        places: Sequence[tuple[float, float]],
        sizes: Sequence[tuple[float, float]],
        known: Sequence[_KnownObject],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """How much the box of each object overlaps with that of each known one; their distances.

        Distances are squared, in units of the reach. Two tensors of shape (objects, known objects).
        """
        place = _pairs(places)[:, None]
        size = _pairs(sizes)[:, None]
        known_place = _pairs([(one.x, one.y) for one in known])
        known_size = _pairs([one.size for one in known])
        reach = torch.tensor(self.reach, dtype=torch.float64)
        distances = (((place - known_place) / reach) ** 2).sum(-1)
        return box_overlap(place, size, known_place, known_size), distances
