"""Text for messages: on one line, short, printable."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np


def one_line(error: Exception | str, limit: int = 300) -> str:
    """A text from a library or a file, for a message: on one line, cut after `limit` characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= limit else text[:limit] + " ..."


_short_repr = reprlib.Repr()
_short_repr.maxstring = 120
_short_repr.maxother = 120


def short(value: Any) -> str:
    """The `repr` of a value, for a message: on one line, and without its middle if it is long."""
    plain = value.item() if isinstance(value, np.generic) else value
    return " ".join(_short_repr.repr(plain).split())


def printable(text: str) -> str:
    """The text on one line, unprintable characters escaped.

    Examples
    --------
    >>> print(printable("a\\nb: no events"))
    a\\nb: no events
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
