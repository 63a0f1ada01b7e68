"""Errors that carry the name of a parameter, and checks of arguments that raise them."""

from __future__ import annotations

import math
import operator
import re
import sys
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from async_tnt.base.messages import short


class ParameterError(Exception):
    """A parameter has a value that it must not have.

    It is raised as a `ParameterValueError` or a `ParameterTypeError`. The program replaces the name
    of the parameter by its option. So an error about a value in a file must be of another class.

    Parameters
    ----------
    name : name of the parameter.
    rule : what its value must be, such as "must be at least 1". Names of other parameters stand in
        braces: "must not be longer than {window_us}".
    got : the value that was passed, as text, see `short`; None where the rule needs no value.

    Examples
    --------
    >>> error = ParameterValueError("hop_us", "must be at most {window_us}", 7)
    >>> print(error)
    `hop_us` must be at most `window_us`, got 7
    >>> error.text({"hop_us": "HOP"})
    'HOP must be at most `window_us`, got 7'
    """

    def __init__(self, name: str, rule: str, got: object = None) -> None:
        super().__init__(name, rule, got)
        self.name = name
        self.rule = rule
        self.got = got

    def text(self, option_names: Mapping[str, str] | None = None) -> str:
        """The message. Parameters have the names in `option_names`, or else backticks."""
        names = option_names or {}

        def name_of(match: re.Match[str]) -> str:
            return names.get(match[1], f"`{match[1]}`")

        rule = re.sub(r"\{(\w+)\}", name_of, self.rule)
        subject = names.get(self.name, f"`{self.name}`")
        if self.got is None:
            return f"{subject} {rule}"
        return f"{subject} {rule}, got {self.got}"

    def __str__(self) -> str:
        return self.text()


class ParameterValueError(ParameterError, ValueError):
    """The value of a parameter is outside of what the parameter allows."""


class ParameterTypeError(ParameterError, TypeError):
    """The value of a parameter is of a wrong type."""


class ParameterWarning(ParameterError, UserWarning):
    """The value of a parameter is allowed, but is probably a mistake."""


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number of any type. True and False are not."""
    # np.bool_, too, because NumPy 1 lets it pass for an index
    if isinstance(value, (bool, np.bool_)):
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def real_number(name: str, value: Any) -> float:
    """A real number of any type as a float; a number too large for a float becomes infinite.

    Raises
    ------
    ParameterTypeError : `value` is not a number. True and False are not numbers.
    """
    if not isinstance(value, Real) or isinstance(value, bool):
        raise ParameterTypeError(name, "must be a number", short(value))
    try:
        return float(value)
    except OverflowError:
        return -math.inf if value < 0 else math.inf


def whole_number(name: str, value: Any, low: int, end: int, rule: str = "") -> int:
    """A whole number in [low, end) as Python's int; `rule` describes the range in other words.

    Raises
    ------
    ParameterTypeError : `value` is not a whole number.
    ParameterValueError : `value` is out of the range.
    """
    if not is_whole(value):
        raise ParameterTypeError(name, "must be a whole number", short(value))
    if not low <= value < end:
        expected = rule or f"in [{low}, {end - 1}]"
        raise ParameterValueError(name, f"must be {expected}", short(value))
    return int(value)


def positive_int(name: str, value: Any) -> int:
    """A whole number of at least 1 that compiled code can hold."""
    is_too_small = is_whole(value) and value < 1
    rule = "at least 1" if is_too_small else "below 2**62"
    return whole_number(name, value, 1, 1 << 62, rule)


def checked_time(name: str, t_us: Any) -> int:
    """A time in microseconds that a window may start at."""
    return whole_number(name, t_us, 0, 1 << 62, "in [0, 2**62)")


def plain_array(name: str, values: Any) -> np.ndarray:
    """The values as `np.asarray` returns them; masked arrays are refused.

    Raises
    ------
    ParameterTypeError : `values` is a masked array. `np.asarray` would silently drop its mask.
    """
    # a masked array is of a subclass of np.ndarray
    if type(values) is not np.ndarray:
        refuse_mask(name, values, "`.filled(value)`, or `.data` to use every value")
    return np.asarray(values)


def refuse_mask(name: str, values: Any, advice: str) -> None:
    """Raise a ParameterTypeError for a masked array, even if it masks nothing.

    `advice` says what to pass instead.
    """
    # The import of numpy.ma takes 10 ms. Until somebody has imported it, no array is masked.
    masked_array = getattr(sys.modules.get("numpy.ma"), "MaskedArray", None)
    if masked_array is not None and isinstance(values, masked_array):
        rule = f"must not be a masked array, whose mask would be ignored; pass {advice}"
        raise ParameterTypeError(name, rule)
