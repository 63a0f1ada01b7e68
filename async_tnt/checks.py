"""Checks of arguments: whole numbers as Python's int, arrays without a mask; of installed extras; text for messages."""

from __future__ import annotations

import operator
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import DTypeLike


def is_whole(value: Any) -> bool:
    """Whether it is a whole number of any type, which True and False are not."""
    if isinstance(value, (bool, np.bool_)):  # the latter: NumPy 1 lets it pass for an index
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def check_number(name: str, value: Any) -> None:
    """Refuse anything but a real number of any type, which True and False are not."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise TypeError(f"`{name}` must be a number, got {value!r}")


def positive_int(name: str, value: Any) -> int:
    """A whole number of at least 1 that compiled code can hold."""
    if not is_whole(value):
        raise TypeError(f"`{name}` must be a whole number, got {value!r}")
    if value < 1:
        raise ValueError(f"`{name}` must be at least 1, got {value}")
    if value >= 1 << 62:
        raise ValueError(f"`{name}` must be below 2**62, got {value}")
    return int(value)


def checked_time(name: str, t_us: Any) -> int:
    """A time in microseconds that a window may start at."""
    if not is_whole(t_us):
        raise TypeError(f"`{name}` must be a whole number of microseconds, got {t_us!r}")
    if not 0 <= t_us < 1 << 62:
        raise ValueError(f"`{name}` must be in [0, 2**62), got {t_us}")
    return int(t_us)


def plain_array(name: str, values: Any, dtype: DTypeLike | None = None) -> np.ndarray:
    """`np.asarray`, except that a masked array, whose mask that would silently drop, is a TypeError."""
    if type(values) is not np.ndarray:  # a masked array is of another
        refuse_mask(name, values, "`.filled(value)`, or `.data` to use every value")
    return np.asarray(values, dtype)


def refuse_mask(name: str, values: Any, advice: str) -> None:
    """Raise a TypeError for a masked array, even one that masks nothing; `advice` is what to pass instead."""
    # through `sys.modules`: nothing can be masked before numpy.ma is imported, and importing it takes 10 ms
    if isinstance(values, getattr(sys.modules.get("numpy.ma"), "MaskedArray", ())):
        raise TypeError(f"`{name}` must not be a masked array, whose mask would be ignored; pass {advice}")


def one_line(error: Exception, limit: int = 300) -> str:
    """Text from a library or a file for a message: on one line, cut after `limit` characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= limit else text[:limit] + " ..."


def printable(text: str) -> str:
    """The text on one line, unprintable characters escaped.

    Examples
    --------
    >>> print(printable("a\\nb: no events"))
    a\\nb: no events
    """
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Imports within the block that fail raise an ImportError in one line: `what` needs it, and how to install it."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what}: pip install 'async_tnt[{extra}]' ({error})") from None
