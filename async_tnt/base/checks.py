"""Checks that everything shares, and text for their messages.

Arguments (whole numbers become Python's int, masked arrays are refused), JSON that comes from
outside, installed extras, and calls that must not overlap.
"""

from __future__ import annotations

import functools
import json
import math
import operator
import re
import reprlib
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Real
from typing import Any, TypeVar, cast

import numpy as np

Method = TypeVar("Method", bound=Callable[..., Any])


class ParameterError(Exception):
    """A parameter has a value that it must not have. Raised as one of the two classes below.

    The program writes the name of the parameter as its option. So an error about what a file states
    must be of another class.

    Parameters
    ----------
    name : name of the parameter.
    rule : what its value must be, such as "must be at least 1". Names of other parameters stand in
        braces: "must not be longer than {window_us}".
    got : the value that came, as text, see `short`; None where the rule says it all.

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
        if self.got is None:
            return f"{named} {rule}"
        return f"{named} {rule}, got {self.got}"

    def __str__(self) -> str:
        return self.text()


class ParameterValueError(ParameterError, ValueError):
    """The value of a parameter is outside of what the parameter allows."""


class ParameterTypeError(ParameterError, TypeError):
    """The value of a parameter is of a wrong type."""


class ParameterWarning(ParameterError, UserWarning):
    """The value of a parameter is allowed, but hardly meant."""


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number of any type. True and False are not."""
    # np.bool_ too: NumPy 1 lets it pass for an index
    if isinstance(value, (bool, np.bool_)):
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def real_number(name: str, value: Any) -> float:
    """A real number of any type as a float; one that float cannot hold becomes infinite.

    Raises
    ------
    ParameterTypeError : not a number. True and False are not.
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
    ParameterTypeError : not a whole number.
    ParameterValueError : out of the range.
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
    """`np.asarray` that refuses masked arrays.

    Raises
    ------
    ParameterTypeError : a masked array, whose mask `np.asarray` would silently drop.
    """
    # a masked array is of a subclass
    if type(values) is not np.ndarray:
        refuse_mask(name, values, "`.filled(value)`, or `.data` to use every value")
    return np.asarray(values)


def refuse_mask(name: str, values: Any, advice: str) -> None:
    """Raise a ParameterTypeError for a masked array, even for one that masks nothing.

    `advice` says what to pass instead.
    """
    # The import of numpy.ma takes 10 ms. Until somebody has imported it, no array is masked.
    masked_array = getattr(sys.modules.get("numpy.ma"), "MaskedArray", None)
    if masked_array is not None and isinstance(values, masked_array):
        rule = f"must not be a masked array, whose mask would be ignored; pass {advice}"
        raise ParameterTypeError(name, rule)


def one_line(error: Exception | str, limit: int = 300) -> str:
    """Text from a library or a file for a message: on one line, cut after `limit` characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= limit else text[:limit] + " ..."


_short = reprlib.Repr()
_short.maxstring = 120
_short.maxother = 120


def short(value: Any) -> str:
    """The `repr` of a value for a message: on one line, a long one without its middle."""
    plain = value.item() if isinstance(value, np.generic) else value
    return " ".join(_short.repr(plain).split())


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


MAX_JSON_DEPTH = 100
"""Most lists and objects within each other. Python's own reader and writer of JSON end in a
RecursionError at some thousand."""


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text that comes from outside.

    Raises
    ------
    ValueError : the text is not JSON; it is nested deeper than `MAX_JSON_DEPTH`; a whole number has
        thousands of digits; or an object has a name twice (Python would silently use the last
        value). The message is one line.

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
    except ValueError:  # Python's limit of digits
        raise ValueError(
            "it has a whole number of thousands of digits; expected numbers of float64 or int64"
        ) from None
    _check_depth(value)
    return value


_TOO_DEEP = f"its JSON is nested more than {MAX_JSON_DEPTH} deep"


class _JsonError(ValueError):
    """A fault that `_json_object` has found, in our words."""


def _json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object as a dict; no name may occur twice."""
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise _JsonError(f"it names {short(name)} twice in one object")
        values[name] = value
    return values


def _check_depth(value: Any) -> None:
    """Refuse a value with more than `MAX_JSON_DEPTH` lists and objects within each other."""
    level = [value]
    for _ in range(MAX_JSON_DEPTH):
        deeper: list[Any] = []
        for one in level:
            if type(one) is dict:
                deeper += one.values()
            elif type(one) is list:
                deeper += one
        level = [one for one in deeper if type(one) in (dict, list)]
        if not level:
            return
    raise ValueError(_TOO_DEEP)


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Turn a failing import within the block into an ImportError of one line.

    The line says `what` needs the package, and how the `extra` is installed.
    """
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what}: pip install 'async_tnt[{extra}]' ({error})") from None


# -- calls that must not overlap -------------------------------------------------------------------
# Compiled code runs without the GIL and does not check bounds: two calls that change the same
# memory would corrupt it.


class Running:
    """Whether a call is running on an object. Errors call the object `name`.

    A copy of it says that no call is running, and so does what is loaded from a pickle.

    With the GIL, test and assignment are one step: CPython switches threads and handles signals
    only at calls, at the start of functions and where loops jump back. So this is as safe as a
    lock, and Ctrl-C does not leave it set. Without the GIL, two calls that begin within some
    nanoseconds of each other can both pass.
    """

    __slots__ = ("name", "now")

    def __init__(self, name: str) -> None:
        self.name = name
        self.now = False

    def __reduce__(self) -> Any:
        return Running, (self.name,)

    def begin(self) -> None:
        """Note that a call begins; a RuntimeError if another one is running.

        The caller continues with `try`, and sets `now = False` in its `finally`.
        """
        if self.now:
            raise self.overlap()
        self.now = True

    def overlap(self) -> RuntimeError:
        """The error of the second call."""
        return RuntimeError(
            f"a {self.name} was called while another call on it is running, in another thread or "
            f"further up in this one; use one {self.name} per thread, or hold one lock around "
            "every call"
        )


def one_at_a_time(method: Method) -> Method:
    """Refuse a call of this method while another decorated call runs on the same object.

    The object has a `Running` as its attribute `_running`. The decorator costs 0.2 us: methods that
    take about a microsecond write these lines themselves.
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
