"""The accepted forms of events, each split into four columns, unchecked.

    a structured array      fields t|ts|timestamp, x, y, p|on|polarity|pol, in any order and of any
                            integer type: Metavision, faery, neuromorphic-drivers, dv-processing's
                            .numpy(), tonic
    a tuple of four columns (t, x, y, p): arrays, lists, tensors; or a named tuple with these names
    a tuple of four numbers (t, x, y, p): a single event
    a table                 with columns of these names: a dict of columns, pandas, polars, pyarrow
    an object               with .t .x .y .p, with .polarity_events (neuromorphic-drivers' packets),
                            or with .numpy()
    None, or an empty list, tuple or array: no events

Times are integer microseconds, or NumPy's datetime64 and timedelta64. Polarity is bool, 0/1 or
-1/+1. A field under two names, two columns of one name, and masked arrays are rejected. A plain
array does not say what its columns are, see `event_columns`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import permutations
from types import MappingProxyType
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError, refuse_mask
from async_tnt.base.messages import one_line, short

NAMES = {
    "t": ("t", "ts", "timestamp"),
    "x": ("x",),
    "y": ("y",),
    "p": ("p", "on", "polarity", "pol"),
}
"""Names that each field of an event may have."""
UNMASKED = "`.compressed()` of each column, or `.data` to use every event"
"""What to pass instead of a masked array."""
MAX_INT64 = (1 << 63) - 1
"""Largest number of an int64."""
UNITS_AS = MappingProxyType(
    {
        "as": 1,
        "fs": 10**3,
        "ps": 10**6,
        "ns": 10**9,
        "us": 10**12,
        "ms": 10**15,
        "s": 10**18,
        "m": 60 * 10**18,
        "h": 3_600 * 10**18,
        "D": 86_400 * 10**18,
        "W": 604_800 * 10**18,
    }
)
"""NumPy's units of time, in attoseconds."""
CALENDAR_DAYS = MappingProxyType({"M": 31, "Y": 366})
"""The most days that a month and a year of NumPy can have."""
MAX_DEPTH = 4
"""How many times in a row `.numpy()` or `.polarity_events` may return an object that must be
converted again."""
FORMS = (
    "a structured array with fields t|ts|timestamp, x, y, p|on|polarity|pol, a dict or table of "
    "such columns, a tuple of four columns (t, x, y, p), or an object with .t .x .y .p, "
    ".polarity_events or .numpy()"
)
"""The accepted forms, for messages."""

Four = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def named_columns(events: Any, depth: int = 0) -> Four | None:
    """The four columns of any accepted form, unchecked; None for no events.

    Raises
    ------
    TypeError, ValueError : `events` has none of the accepted forms; the message says what was
        passed and what is accepted.
    """
    if events is None:
        return None
    if isinstance(events, (np.ndarray, np.void)):
        return _columns_of_array(events)
    kind = type(events).__name__

    names = _names_in(events)
    if names is not None:
        what = f"a {kind} with columns {', '.join(map(str, names))}"
        return _columns_by_name(names, what, events.__getitem__)

    has_names = hasattr(events, "x") and hasattr(events, "y")
    if isinstance(events, (tuple, list)):
        if len(events) == 0:
            return None
        _check_four(events)
        # a named tuple with these names is read by them, below
        if not has_names:
            t, x, y, p = events
            return _as_column("t", t), _as_column("x", x), _as_column("y", y), _as_column("p", p)

    if depth < MAX_DEPTH and hasattr(events, "polarity_events"):
        return named_columns(events.polarity_events, depth + 1)
    if has_names:
        attributes = [name for names in NAMES.values() for name in names if hasattr(events, name)]
        what = f"a {kind} with attributes {', '.join(attributes)}"
        return _columns_by_name(attributes, what, lambda name: getattr(events, name))
    if depth < MAX_DEPTH and callable(getattr(events, "numpy", None)):
        try:
            array = events.numpy()
        except RuntimeError as error:  # torch: a tensor that requires grad
            raise TypeError(f"{kind}.numpy() failed: {one_line(error)}") from error
        return named_columns(array, depth + 1)
    raise TypeError(f"events must be {FORMS}; got {kind}")


def _columns_by_name(names: Collection[str], what: str, get: Callable[[str], Any]) -> Four:
    """The columns that `get` returns for the names of t, x, y and p among `names`."""
    return (
        _as_column("t", get(the_name("t", names, what))),
        _as_column("x", get(the_name("x", names, what))),
        _as_column("y", get(the_name("y", names, what))),
        _as_column("p", get(the_name("p", names, what))),
    )


def event_columns(table: Any, order: str) -> Four:
    """The columns t, x, y, p of a plain array of events, to be pushed as a packet.

    Parameters
    ----------
    table : array or tensor of shape (N, 4): integers, or floats that are whole numbers.
    order : the field of each column, such as "txyp" or "xytp".

    Raises
    ------
    ValueError : the table has another shape; `order` does not have each letter once; the columns
        look like another order, which the message names; or floats are 2**24 (float32) or 2**53
        (float64) and more, and may have been rounded. Everything else is checked when the columns
        are pushed.

    Examples
    --------
    >>> event_columns([[5, 3, 1_000, 1], [6, 3, 1_250, 0]], "xytp")[0].tolist()
    [1000, 1250]
    """
    refuse_mask("table", table, UNMASKED)
    array = np.asarray(table)
    check_order("order", order)
    if array.ndim != 2 or array.shape[1] != 4 or array.dtype.kind not in "iufb":
        got = f"{array.dtype} in shape {array.shape}"
        raise ParameterValueError("table", "must be numbers in shape (N, 4)", got)
    likely = likely_order(array, order)
    if likely != order:
        raise ValueError(f"the columns are not {order!r}; they look like {likely!r}")
    columns = dict(zip(order, array.T, strict=True))
    return (
        _whole_numbers("t", columns["t"]),
        _whole_numbers("x", columns["x"]),
        _whole_numbers("y", columns["y"]),
        _whole_numbers("p", columns["p"]),
    )


def _whole_numbers(field: str, column: np.ndarray) -> np.ndarray:
    """A column of floats as int64; other columns unchanged."""
    if column.dtype.kind != "f":
        return column
    # from this number on, floats may have been rounded
    exact = 2 ** min(63, np.finfo(column.dtype).nmant + 1)
    fits = (np.rint(column) == column) & (np.abs(column) < exact)
    if not fits.all():  # nan never fits
        i = int(np.argmin(fits))
        raise ValueError(
            f"`{field}` must be whole numbers, as {column.dtype} below {exact}, got "
            f"{column[i]} in row {i}; times are microseconds"
        )
    return column.astype(np.int64)


def check_order(name: str, order: Any) -> None:
    """Raise a ParameterValueError unless `order` has each of the letters t, x, y and p once.

    name : name of the parameter.
    """
    if not isinstance(order, str) or sorted(order) != sorted("txyp"):
        rule = "must have the letters t, x, y and p, each once"
        raise ParameterValueError(name, rule, short(order))


def likely_order(table: np.ndarray, order: str) -> str:
    """The likely order of a table's columns: `order`, or another order with better signs.

    Two signs can speak for an order, see `_signs`. If any sign speaks for `order`, it is returned.
    Another order is returned only if both signs speak for that order.

    Parameters
    ----------
    table : numbers in shape (N, 4).
    order : the order that the caller assumes, such as "txyp".
    """
    if any(_signs(table, order)):
        return order
    for letters in permutations("txyp"):
        other = "".join(letters)
        # x and y cannot be told apart, so x is taken to come first.
        x_is_first = other.index("x") < other.index("y")
        if x_is_first and all(_signs(table, other)):
            return other
    return order


def _signs(table: np.ndarray, order: str) -> tuple[bool, bool]:
    """Two signs that a table's columns have this order: times increase, and times are the largest.

    Both signs are False if the column of polarities has other values than -1, 0 and 1.
    """
    columns = dict(zip(order, table.T, strict=True))
    if not np.isin(columns["p"], (-1, 0, 1)).all():
        return False, False
    t = columns["t"]
    increase = (t[1:] >= t[:-1]).all()
    largest = max(column.max(initial=0) for column in columns.values())
    return bool(increase), bool(t.max(initial=0) == largest)


def _names_in(events: Any) -> Sequence[str] | None:
    """The names of the columns of a mapping or a table; None for anything else."""
    if isinstance(events, Mapping):
        return list(events)
    names = getattr(events, "column_names", None)  # pyarrow
    if names is None:
        names = getattr(events, "columns", None)  # pandas, polars
    if names is None or not hasattr(names, "__iter__") or not hasattr(events, "__getitem__"):
        return None
    return [name for name in names if isinstance(name, str)]


def _columns_of_array(events: np.ndarray | np.void) -> Four | None:
    """The four columns of a structured array, or of one of its records; None for no events."""
    refuse_mask("events", events, UNMASKED)
    names = events.dtype.names
    if names is None:
        if isinstance(events, np.ndarray) and events.size == 0:
            return None
        hint = ""
        if events.shape[1:] == (4,):
            hint = "; async_tnt.event_columns(array, order) says what its columns are"
        raise TypeError(
            f"events must be {FORMS}; got a plain array of shape {np.shape(events)}{hint}"
        )
    what = f"a structured array with fields {', '.join(names)}"
    t = np.atleast_1d(events[the_name("t", names, what)])
    x = np.atleast_1d(events[the_name("x", names, what)])
    y = np.atleast_1d(events[the_name("y", names, what)])
    p = np.atleast_1d(events[the_name("p", names, what)])
    return _microseconds(t), x, y, p


def _check_four(events: tuple[Any, ...] | list[Any]) -> None:
    """Refuse a list of single events, and anything but four columns."""
    first = events[0]
    holds_events = isinstance(first, (dict, np.void))
    if isinstance(first, tuple) and len(events) != 4:
        holds_events = True
    if isinstance(events, list) and holds_events:
        raise TypeError(
            f"a list of single events ({type(first).__name__} at event 0) is not a packet: "
            "pass it to `stream`, event by event, or push four columns (t, x, y, p)"
        )
    if len(events) != 4:
        raise ValueError(
            f"a tuple of events must hold four columns (t, x, y, p), got {len(events)}"
        )


def _as_column(field: str, values: Any) -> np.ndarray:
    """The values of one field as an array; times with a unit as microseconds."""
    refuse_mask(field, values, UNMASKED)
    try:
        column = np.atleast_1d(np.asarray(values))
    except Exception as error:  # a foreign object's `__array__` may raise any error
        raise ValueError(
            f"`{field}` must be a column of whole numbers: {one_line(error)}"
        ) from error
    if column.size == 0:
        return np.empty(column.shape, np.int64)  # [] is float64 to NumPy
    # NumPy makes floats of Python integers if one of them is beyond int64. As objects they keep
    # their values, so that the decoder can name the number that does not fit.
    may_be_integers = column.dtype.kind == "f" and isinstance(values, (list, tuple))
    if may_be_integers and all(type(value) is int for value in values):
        return np.array(values, object)
    return _microseconds(column) if field == "t" else column


def _microseconds(t: np.ndarray) -> np.ndarray:
    """Times as whole microseconds, rounded down, if they have a unit; others unchanged.

    NumPy's own conversion would wrap around silently where microseconds do not fit into int64.
    """
    if t.dtype.kind not in "mM":
        return t
    unit, multiple = np.datetime_data(t.dtype)
    if unit == "generic":
        return t
    if np.isnat(t).any():
        raise ValueError(f"`t` must be a time, got NaT at event {int(np.argmax(np.isnat(t)))}")
    in_calendar = unit in CALENDAR_DAYS
    if in_calendar and t.dtype.kind == "m":
        raise ValueError(
            f"`t` must be durations of a fixed length, got {t.dtype}; convert them to microseconds"
        )

    # microseconds = count * factor / divisor. Months and years are taken as long as they can be,
    # because for them this only decides whether the microseconds fit into int64.
    unit_as = CALENDAR_DAYS[unit] * UNITS_AS["D"] if in_calendar else UNITS_AS[unit]
    step_as = multiple * unit_as
    common = math.gcd(step_as, UNITS_AS["us"])
    factor = step_as // common
    divisor = UNITS_AS["us"] // common

    count = t.astype(np.int64)
    is_too_large = np.abs(count) > min(MAX_INT64, MAX_INT64 * divisor // factor)
    if is_too_large.any():
        i = int(np.argmax(is_too_large))
        written_unit = unit if multiple == 1 else f"x {multiple} {unit}"
        raise ValueError(
            f"`t` must be in [0, 2**62) microseconds, got {count[i]} {written_unit} at event {i}"
        )

    if in_calendar:
        return t.astype("M8[us]").astype(np.int64)
    if factor == 1:
        return count // divisor
    if divisor == 1:
        return count * factor
    # units such as 1500 ns: the product may not fit into int64, but fits into Python's integers
    exact = [value * factor // divisor for value in count.tolist()]
    return np.array(exact, np.int64)


def fields_of_records(dtype: np.dtype) -> list[str] | None:
    """The fields of records that hold t, x, y and p; None if one is missing or has two names."""
    if dtype.names is None:
        return None
    fields = []
    for names in NAMES.values():
        matches = [name for name in names if name in dtype.names]
        if len(matches) != 1:
            return None
        fields += matches
    return fields


def the_name(field: str, names: Collection[str], description: str) -> str:
    """The one name among `names` that means `field`.

    Raises
    ------
    ValueError : no name among `names` means `field`, or several do. `description` says what the
        events are, for the message.
    """
    matches = [name for name in names if name in NAMES[field]]
    if not matches:
        raise ValueError(
            f"events need a field `{field}` (one of {', '.join(NAMES[field])}), got {description}"
        )
    if len(matches) == 1:
        return matches[0]
    has_one_name = len(set(matches)) == 1
    got = f"{matches[0]} {len(matches)} times" if has_one_name else " and ".join(matches)
    raise ValueError(
        f"events need one field `{field}`, got {got} in {description}; leave out all but one"
    )
