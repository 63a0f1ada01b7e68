"""Box: a rectangle of places."""

from __future__ import annotations

from typing import NamedTuple


class Box(NamedTuple):
    """A rectangle of places of a map: columns x0 <= x < x1 and rows y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def is_empty(self) -> bool:
        """Whether no place is in it."""
        return self.x0 == self.x1
