"""Which values the parameters of a layer may have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MAX_SIDE = 1 << 15


@dataclass(frozen=True)
class Check:
    words: str
    holds: Callable[[Any], bool]


def _is_whole(value: Any, low: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value < MAX_SIDE


def _is_number(value: Any) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 1 << 63
    return isinstance(value, float) and not math.isnan(value)


def _whole_numbers(n: int, low: int) -> Check:
    words = f"a list of {n} whole numbers from {low} on"
    return Check(
        words, lambda value: isinstance(value, list) and len(value) == n and all(_is_whole(v, low) for v in value)
    )


SIDES = _whole_numbers(2, 1)
PADDING = _whole_numbers(4, 0)
POSITIVE = Check("a positive whole number", lambda value: _is_whole(value, 1))
LIMIT = Check("a number, or null", lambda value: value is None or _is_number(value))
FINITE = Check("a finite number", lambda value: _is_number(value) and math.isfinite(value))
NOT_NEGATIVE = Check("a finite number from 0 on", lambda value: FINITE.holds(value) and value >= 0)
