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
    """Added to the volume."""
    dropped_outside: int = 0
    """The transform moved it off the grid."""
    dropped_tau_zero: int = 0
    """At the very start of its window, where TNT time is zero."""
    dropped_late: int = 0
    """Older than all open windows and not `dropped_decided`, or late under late="drop"."""
    dropped_decided: int = 0
    """Late for a window that `confidence` had closed early, as it had all later ones before the
    oldest open one."""

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(getattr(self, f) + getattr(other, f) for f in self.__dataclass_fields__))
