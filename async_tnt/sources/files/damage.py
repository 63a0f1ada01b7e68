"""What is said of a file that is not as its format should be."""

from __future__ import annotations


class DamagedRecording(UserWarning):
    """A recording is damaged: it was read up to the damage, and nothing after it."""


class Damage(Exception):
    """Raised by a source where it cannot read on. `Recording` turns it into a warning or a ValueError.

    Parameters
    ----------
    reason : what is wrong, and where in the file: "row 17: expected `t x y p`, got 'abc'".
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason
