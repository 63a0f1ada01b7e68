"""Checks: of arguments (whole numbers as Python's int, arrays without a mask), of JSON from
outside, of installed extras, and of calls that must not overlap; text for messages."""

from __future__ import annotations

import functools
import json
import math
import operator
import re
import reprlib
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Real
from typing import Any, TypeVar, cast

import numpy as np

Method = TypeVar("Method", bound=Callable[..., Any])


class ParameterError(Exception):
    """A parameter has a value that it must not have. Raised as one of the two classes below.

    The program writes the names as its options; an error about what a file states is none of these.

    Parameters
    ----------
    name : of the parameter.
    rule : what its value must be, such as "must be at least 1". Names of other parameters stand in
        braces: "must not be longer than {window_us}".
    got : what came, as text, by `short` perhaps; None where the rule says it all.

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

    def text(self, written: Mapping[str, str] | None = None) -> str:
        """The message, in which parameters are named as `written` says, or else in backticks."""
        known = written or {}

        def name_of(match: re.Match[str]) -> str:
            return known.get(match[1], f"`{match[1]}`")

        rule = re.sub(r"\{(\w+)\}", name_of, self.rule)
        named = known.get(self.name, f"`{self.name}`")
        return f"{named} {rule}" if self.got is None else f"{named} {rule}, got {self.got}"

    def __str__(self) -> str:
        return self.text()


class ParameterValueError(ParameterError, ValueError):
    """The value of a parameter is outside of what the parameter allows."""


class ParameterTypeError(ParameterError, TypeError):
    """The value of a parameter is of a wrong type."""


class ParameterWarning(ParameterError, UserWarning):
    """The value of a parameter is allowed, but hardly meant."""


def is_whole(value: Any) -> bool:
    """Whether it is a whole number of any type, which True and False are not."""
    if isinstance(value, (bool, np.bool_)):  # the latter: NumPy 1 lets it pass for an index
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def real_number(name: str, value: Any) -> float:
    """A real number of any type, which True and False are not; one beyond float is infinite."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise ParameterTypeError(name, "must be a number", short(value))
    try:
        return float(value)
    except OverflowError:
        return -math.inf if value < 0 else math.inf


def whole_number(name: str, value: Any, low: int, end: int, rule: str = "") -> int:
    """A whole number in [low, end), or as `rule` puts it."""
    if not is_whole(value):
        raise ParameterTypeError(name, "must be a whole number", short(value))
    if not low <= value < end:
        expected = rule or f"in [{low}, {end - 1}]"
        raise ParameterValueError(name, f"must be {expected}", short(value))
    return int(value)


def positive_int(name: str, value: Any) -> int:
    """A whole number of at least 1 that compiled code can hold."""
    return whole_number(
        name, value, 1, 1 << 62, "at least 1" if is_whole(value) and value < 1 else "below 2**62"
    )


def checked_time(name: str, t_us: Any) -> int:
    """A time in microseconds that a window may start at."""
    return whole_number(name, t_us, 0, 1 << 62, "in [0, 2**62)")


def plain_array(name: str, values: Any) -> np.ndarray:
    """`np.asarray`, except that a masked array, whose mask that would silently drop, is a
    TypeError."""
    if type(values) is not np.ndarray:  # a masked array is of another
        refuse_mask(name, values, "`.filled(value)`, or `.data` to use every value")
    return np.asarray(values)


def refuse_mask(name: str, values: Any, advice: str) -> None:
    """Raise a TypeError for a masked array, even one that masks nothing; `advice` is what to pass
    instead."""
    # through `sys.modules`: nothing can be masked before numpy.ma is imported, and importing it
    # takes 10 ms
    if isinstance(values, getattr(sys.modules.get("numpy.ma"), "MaskedArray", ())):
        raise TypeError(
            f"`{name}` must not be a masked array, whose mask would be ignored; pass {advice}"
        )


def one_line(error: Exception | str, limit: int = 300) -> str:
    """Text from a library or a file for a message: on one line, cut after `limit` characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= limit else text[:limit] + " ..."


_short = reprlib.Repr()
_short.maxstring = _short.maxother = 120


def short(value: Any) -> str:
    """What came, for a message: its `repr`, on one line, without the middle of what is long."""
    return " ".join(_short.repr(value.item() if isinstance(value, np.generic) else value).split())


def printable(text: str) -> str:
    """The text on one line, unprintable characters escaped.

    Examples
    --------
    >>> print(printable("a\\nb: no events"))
    a\\nb: no events
    """
    return (
        text
        if text.isprintable()
        else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    )


MAX_JSON_DEPTH = 100
"""Lists and objects within each other. Python's reader and writer would end in a RecursionError at
some thousand."""


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text that comes from outside.

    Raises
    ------
    ValueError : it is not JSON, is nested deeper than `MAX_JSON_DEPTH`, has a whole number of
        thousands of digits, or an object names a value twice, of which Python would silently use
        the last. One line.

    Examples
    --------
    >>> parse_json('{"bins": 9}')
    {'bins': 9}
    """
    try:
        value = json.loads(text, object_pairs_hook=_json_object)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except _JsonError:
        raise
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"it is not JSON: {one_line(error)}") from None
    except ValueError:  # of Python's limit of digits
        raise ValueError(
            "it has a whole number of thousands of digits; expected numbers of float64 or int64"
        ) from None
    _check_depth(value)
    return value


_TOO_DEEP = f"its JSON is nested more than {MAX_JSON_DEPTH} deep"


class _JsonError(ValueError):
    """A fault that `_json_object` has found, in our words."""


def _json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON, each of whose names is there once."""
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = next(name for name, n in Counter(name for name, _ in pairs).items() if n > 1)
        raise _JsonError(f"it names {short(twice)} twice in one object")
    return values


def _check_depth(value: Any) -> None:
    """Refuse a value with more than `MAX_JSON_DEPTH` lists and objects within each other."""
    level = [value]
    for _ in range(MAX_JSON_DEPTH):
        inner = [
            one.values() if type(one) is dict else one for one in level if type(one) in (dict, list)
        ]
        level = [one for some in inner for one in some if type(one) in (dict, list)]
        if not level:
            return
    raise ValueError(_TOO_DEEP)


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Imports within the block that fail raise an ImportError in one line: `what` needs it, and how
    to install it."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what}: pip install 'async_tnt[{extra}]' ({error})") from None


# -- calls that must not overlap -------------------------------------------------------------------
# Compiled code runs without the GIL and does not check bounds: two calls that change the same
# memory would corrupt it.


class Running:
    """Whether a call is running on an object, which errors call `name`; on a copy or a pickled one,
    none is.

    With the GIL, test and assignment are one step: CPython switches threads and handles signals
    only at calls, at the start of functions and where loops jump back. So this is as safe as a
    lock, and not left set by Ctrl-C. Without the GIL, two calls that begin within some nanoseconds
    of each other can both pass.
    """

    __slots__ = ("name", "now")

    def __init__(self, name: str) -> None:
        self.name = name
        self.now = False

    def __reduce__(self) -> Any:
        return Running, (self.name,)

    def begin(self) -> None:
        """Refuse to begin if a call is running. To be followed by `try`, and at its end by `now =
        False`."""
        if self.now:
            raise self.overlap()
        self.now = True

    def overlap(self) -> RuntimeError:
        """The error of the second call."""
        return RuntimeError(
            f"a {self.name} was called while another call on it is running, in another thread or "
            "further up in this "
            f"one; use one {self.name} per thread, or hold one lock around every call"
        )


def one_at_a_time(method: Method) -> Method:
    """Refuse a call of this method while one of this kind is running on the same object, by its
    `_running`.

    Takes 0.2 us; methods that take about a microsecond themselves write it out.
    """

    @functools.wraps(method)
    def alone(self: Any, *args: Any, **kwargs: Any) -> Any:
        running = self._running
        running.begin()
        try:
            return method(self, *args, **kwargs)
        finally:
            running.now = False

    return cast(Method, alone)
