"""Comparison: the worst difference of what is compared, and its bound."""

from __future__ import annotations

import math
from dataclasses import dataclass

PACKET_SIZES = (1, 2, 7, 100, 0)
"""The packet sizes that are compared, in events. 0 stands for all events at once."""


@dataclass
class Comparison:
    """The comparisons for one promise and one configuration: the worst difference, and its bound.

    Parameters
    ----------
    what : the compared values, in words.
    config : name of the configuration.
    bound : largest difference that is allowed.
    n : number of comparisons so far.
    worst : largest difference so far.
    """

    what: str
    config: str
    bound: float
    n: int = 0
    worst: float = 0.0

    def add(self, difference: float) -> None:
        """Add one comparison with this difference."""
        self.include(Comparison(self.what, self.config, self.bound, 1, float(difference)))

    def include(self, other: Comparison) -> None:
        """Add the comparisons of another recording."""
        self.n += other.n
        # A nan must be taken over and then stay, so that the comparison fails. `not <=` is true
        # for a nan, but `>` would be false.
        is_worse = not other.worst <= self.worst
        if is_worse and not math.isnan(self.worst):
            self.worst = other.worst

    @property
    def holds(self) -> bool:
        """Whether something was compared, and the worst difference is within the bound."""
        return self.n > 0 and self.worst <= self.bound
