"""A layer as data, and the values that its parameters may have."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

MAX_SIDE = 1 << 15
"""The sides of a map, and whole numbers among a layer's parameters, must be below this limit."""

Layer = Mapping[str, Any]
"""A layer: `op`, `name`, `inputs`, the operation's parameters, and `weights` if it has weights."""

Shape = tuple[int, ...]
"""The shape of what a layer computes: (C, H, W) of a map, or (N,) of a vector."""


@dataclass(frozen=True)
class Check:
    """The rule that a parameter's value must follow: in words, and as a function."""

    words: str
    holds: Callable[[Any], bool]


def _is_whole(value: Any, low: int) -> bool:
    # True and False are numbers of type int for Python
    return isinstance(value, int) and not isinstance(value, bool) and low <= value < MAX_SIDE


def _is_number(value: Any) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 1 << 63  # it fits into an int64
    return isinstance(value, float) and not math.isnan(value)


def _is_finite(value: Any) -> bool:
    return _is_number(value) and math.isfinite(value)


def _whole_numbers(n: int, low: int) -> Check:
    def holds(value: Any) -> bool:
        if not isinstance(value, list) or len(value) != n:
            return False
        return all(_is_whole(number, low) for number in value)

    return Check(f"a list of {n} whole numbers from {low} on", holds)


def _are_channels(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(_is_whole(one, 0) for one in value)


CHANNELS = Check("a list of at least one whole number from 0 on", _are_channels)

SIDES = _whole_numbers(2, 1)
"""Two sides, [y, x]."""

PADDING = _whole_numbers(4, 0)
"""Four paddings, [top, left, bottom, right]."""

BLOCK = Check("a whole number from 1 to 64", lambda value: _is_whole(value, 1) and value <= 64)
"""The side of a block for each place of which steps of their own are made."""

POSITIVE = Check("a positive whole number", lambda value: _is_whole(value, 1))

LIMIT = Check("a number, or null", lambda value: value is None or _is_number(value))

FINITE = Check("a finite number", _is_finite)

NOT_NEGATIVE = Check("a finite number from 0 on", lambda value: _is_finite(value) and value >= 0)
