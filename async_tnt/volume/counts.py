"""What became of the events that a volume received."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Counts:
    """What became of the events since the volume was made or reset.

    Where windows do not overlap, every event is counted once, as kept or as dropped for one reason:
    received = kept + dropped_outside + dropped_tau_zero + dropped_late + dropped_decided.
    """

    received: int = 0
    """Events in total."""
    kept: int = 0
    """Events added to the volume."""
    dropped_outside: int = 0
    """Events that the transform moved off the grid."""
    dropped_tau_zero: int = 0
    """Events at the very start of their window, where TNT time is zero."""
    dropped_late: int = 0
    """Events older than all open windows, and late events where `late` is "drop". The events of
    `dropped_decided` are not among them."""
    dropped_decided: int = 0
    """Late events of a window that `confidence` had closed early. All windows between that window
    and the oldest open window were closed early, too."""

    def __add__(self, other: Counts) -> Counts:
        """The sum, count by count."""
        sums = {name: value + getattr(other, name) for name, value in vars(self).items()}
        return Counts(**sums)
