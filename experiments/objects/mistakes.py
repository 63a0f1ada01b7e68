"""Which drawn objects are missed, and which are taken for another kind, by their size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.objects.scenes import SIZES

EDGES = np.geomspace(*SIZES, 5)[1:-1]
"""Sizes that divide objects into four parts: longer sides as shares of the sensor's shorter side.
Sizes are log-uniform, so that the parts have about as many objects each."""

LEAST_OVERLAP = 0.5
"""The least overlap of a found box with an object's box."""

MOST_PAIRS = 6
"""How many pairs of kinds that were mistaken are told."""


class Mistakes:
    """Counts for objects of several sizes, at one moment of many scenes."""

    def __init__(self) -> None:
        self._n_objects = np.zeros(len(EDGES) + 1, np.int64)
        self._n_found = np.zeros(len(EDGES) + 1, np.int64)
        self._n_right = np.zeros(len(EDGES) + 1, np.int64)
        self._pairs: Counter[tuple[str, str]] = Counter()

    def add(
        self,
        boxes: np.ndarray,
        kinds: Sequence[str],
        found_boxes: np.ndarray,
        found_kinds: Sequence[str],
        shorter: int,
    ) -> None:
        """Add a scene.

        An object is found if its box overlaps enough with a box of any kind. It is right if such a
        box is of its kind. Otherwise it was taken for the kind of the box that overlaps most.

        Parameters
        ----------
        boxes, found_boxes : float64, (N, 4) and (M, 4), x0, y0, x1, y1.
        kinds, found_kinds : what they show.
        shorter : the sensor's shorter side, in pixels.
        """
        overlaps = overlaps_of(boxes, found_boxes)
        sides = (boxes[:, 2:] - boxes[:, :2]).max(axis=1) / shorter
        for k, (kind, part) in enumerate(zip(kinds, np.searchsorted(EDGES, sides), strict=True)):
            near = np.flatnonzero(overlaps[k] >= LEAST_OVERLAP).tolist()
            is_right = any(found_kinds[i] == kind for i in near)
            self._n_objects[part] += 1
            self._n_found[part] += len(near) > 0
            self._n_right[part] += is_right
            if near and not is_right:
                taken_for = found_kinds[near[int(overlaps[k, near].argmax())]]
                self._pairs[kind, taken_for] += 1

    def to_dict(self) -> dict[str, Any]:
        """Counts by size, and the pairs that are mistaken most often, for JSON."""
        pairs = [
            {"kind": kind, "taken_for": other, "objects": n}
            for (kind, other), n in self._pairs.most_common(MOST_PAIRS)
        ]
        return {
            "edges": [round(edge, 4) for edge in EDGES.tolist()],
            "objects": self._n_objects.tolist(),
            "found": self._n_found.tolist(),
            "right": self._n_right.tolist(),
            "mistaken": pairs,
        }


def overlaps_of(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The shared area of each pair of boxes, divided by the area that they cover: (N, M)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    shared = np.clip(high - low, 0, None).prod(axis=2)
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    other_areas = (others[:, 2:] - others[:, :2]).prod(axis=1)
    overlap: np.ndarray = shared / (areas[:, None] + other_areas - shared)
    return overlap
