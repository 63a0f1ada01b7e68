"""Settings that are whole numbers: checked, and as Python's int."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np


def is_whole(value: Any) -> bool:
    """Whether it is a whole number of any type, True and False not among them."""
    if isinstance(value, (bool, np.bool_)):  # the latter: NumPy 1 lets it pass for an index
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def positive_int(name: str, value: Any) -> int:
    """A whole number of at least 1, which compiled code can hold."""
    if not is_whole(value):
        raise TypeError(f"`{name}` must be a whole number, got {value!r}")
    if value < 1:
        raise ValueError(f"`{name}` must be at least 1, got {value}")
    if value >= 1 << 62:
        raise ValueError(f"`{name}` must be below 2**62, got {value:.3g}")
    return int(value)


def checked_time(name: str, t_us: Any) -> int:
    """A time in microseconds that a window may start at."""
    if not is_whole(t_us):
        raise TypeError(f"`{name}` must be a whole number of microseconds, got {t_us!r}")
    if not 0 <= t_us < 1 << 62:
        raise ValueError(f"`{name}` must be in [0, 2**62), got {t_us}")
    return int(t_us)
