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

Times are integer microseconds, or NumPy's datetime64 and timedelta64; polarity is bool, 0/1 or
-1/+1. A field under two names, two columns of one name, and masked arrays are rejected. Plain
arrays do not say what their columns are, see `event_columns`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import permutations
from types import MappingProxyType
from typing import Any

import numpy as np

from async_tnt.base.checks import one_line, refuse_mask, short

NAMES = {
    "t": ("t", "ts", "timestamp"),
    "x": ("x",),
    "y": ("y",),
    "p": ("p", "on", "polarity", "pol"),
}
UNMASKED = "`.compressed()` of each column, or `.data` to use every event"
MAX_INT64 = (1 << 63) - 1
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
"""Days that NumPy's months and years have at most."""
MAX_DEPTH = 4  # `.numpy()` may return events in another form, but not endlessly
FORMS = (
    "a structured array with fields t|ts|timestamp, x, y, p|on|polarity|pol, a dict or table of "
    "such columns, a tuple "
    "of four columns (t, x, y, p), or an object with .t .x .y .p, .polarity_events or .numpy()"
)

Four = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def named_columns(events: Any, depth: int = 0) -> Four | None:
    """The four columns of any accepted form, unchecked; None for no events.

    Raises
    ------
    TypeError, ValueError : not a form of events; the message says what came and what is accepted.
    """
    if events is None:
        return None
    if isinstance(events, (np.ndarray, np.void)):
        return _columns_of_array(events)
    if (names := _names_in(events)) is not None:
        what = f"a {type(events).__name__} with columns {', '.join(map(str, names))}"
        t, x, y, p = (_as_column(field, events[the_name(field, names, what)]) for field in NAMES)
        return t, x, y, p
    by_name = hasattr(events, "x") and hasattr(events, "y")
    if isinstance(events, (tuple, list)):
        if len(events) == 0:
            return None
        _check_four(events)
        if not by_name:  # a named tuple names its columns
            t, x, y, p = (
                _as_column(field, column) for field, column in zip(NAMES, events, strict=True)
            )
            return t, x, y, p
    if depth < MAX_DEPTH and hasattr(events, "polarity_events"):
        return named_columns(events.polarity_events, depth + 1)
    if by_name:
        have = [name for names in NAMES.values() for name in names if hasattr(events, name)]
        what = f"a {type(events).__name__} with attributes {', '.join(have)}"
        t, x, y, p = (
            _as_column(field, getattr(events, the_name(field, have, what))) for field in NAMES
        )
        return t, x, y, p
    if depth < MAX_DEPTH and callable(getattr(events, "numpy", None)):
        try:
            array = events.numpy()
        except RuntimeError as error:  # torch: a tensor that requires grad
            raise TypeError(f"{type(events).__name__}.numpy() failed: {one_line(error)}") from error
        return named_columns(array, depth + 1)
    raise TypeError(f"events must be {FORMS}; got {type(events).__name__}")


def event_columns(table: Any, order: str) -> Four:
    """The columns t, x, y, p of a plain array of events, to be pushed as a packet.

    Parameters
    ----------
    table : array or tensor of shape (N, 4), of integers or of floats that are whole numbers.
    order : what its columns are, such as "txyp" or "xytp".

    Raises
    ------
    ValueError : another shape or `order`; columns that look like another order, which the message
        names; floats of 2**24 (float32) or 2**53 (float64) and more, which may have been rounded.
        All else is checked by a push.

    Examples
    --------
    >>> event_columns([[5, 3, 1_000, 1], [6, 3, 1_250, 0]], "xytp")[0].tolist()
    [1000, 1250]
    """
    refuse_mask("table", table, UNMASKED)
    array = np.asarray(table)
    check_order("order", order)
    if array.ndim != 2 or array.shape[1] != 4 or array.dtype.kind not in "iufb":
        raise ValueError(
            f"`table` must be numbers in shape (N, 4), got {array.dtype} in shape {array.shape}"
        )
    if (likely := likely_order(array, order)) != order:
        raise ValueError(f"the columns are not {order!r}; they look like {likely!r}")
    columns = dict(zip(order, array.T, strict=True))
    for field, column in columns.items():
        if column.dtype.kind == "f":
            # from here on floats may have been rounded
            exact = 2 ** min(63, np.finfo(column.dtype).nmant + 1)
            fits = (np.rint(column) == column) & (np.abs(column) < exact)
            if not fits.all():  # not a number, too
                i = int(np.argmin(fits))
                raise ValueError(
                    f"`{field}` must be whole numbers, as {column.dtype} below {exact}, got "
                    f"{column[i]} in row {i}; "
                    "times are microseconds"
                )
            columns[field] = column.astype(np.int64)
    return columns["t"], columns["x"], columns["y"], columns["p"]


def check_order(name: str, order: Any) -> None:
    """A ValueError that names the parameter, if `order` does not have each of the letters t, x, y
    and p once."""
    if not isinstance(order, str) or sorted(order) != sorted("txyp"):
        raise ValueError(
            f"`{name}` must have the letters t, x, y and p, each once, got {short(order)}"
        )


def likely_order(table: np.ndarray, order: str) -> str:
    """The order of a table's columns: `order`, unless nothing speaks for it and all for another
    one.

    Parameters
    ----------
    table : numbers in shape (N, 4).
    order : what its columns are thought to be, such as "txyp".
    """
    if any(_signs(dict(zip(order, table.T, strict=True)))):
        return order
    for letters in permutations("txyp"):  # x and y cannot be told apart: x comes first
        other = "".join(letters)
        if other.index("x") < other.index("y") and all(
            _signs(dict(zip(other, table.T, strict=True)))
        ):
            return other
    return order


def _signs(columns: Mapping[str, np.ndarray]) -> tuple[bool, bool]:
    """Two signs that columns are what they are called: polarity has its values, and times increase;
    or it has them, and times are the largest numbers."""
    if not np.isin(columns["p"], (-1, 0, 1)).all():
        return False, False
    t = columns["t"]
    largest = max((column.max(initial=0) for column in columns.values()), default=0)
    return bool((t[1:] >= t[:-1]).all()), bool(t.max(initial=0) == largest)


def _names_in(events: Any) -> Sequence[str] | None:
    """The columns' names of a mapping or a table; None of anything else."""
    if isinstance(events, Mapping):
        return list(events)
    names = getattr(events, "column_names", None)  # pyarrow
    if names is None:
        names = getattr(events, "columns", None)  # pandas, polars
    if names is None or not hasattr(events, "__getitem__"):
        return None
    return [name for name in names if isinstance(name, str)] if hasattr(names, "__iter__") else None


def _columns_of_array(events: np.ndarray | np.void) -> Four | None:
    refuse_mask("events", events, UNMASKED)
    names = events.dtype.names
    if names is None:
        if isinstance(events, np.ndarray) and events.size == 0:
            return None
        order = (
            "; async_tnt.event_columns(array, order) says what its columns are"
            if events.shape[1:] == (4,)
            else ""
        )
        raise TypeError(
            f"events must be {FORMS}; got a plain array of shape {np.shape(events)}{order}"
        )
    what = f"a structured array with fields {', '.join(names)}"
    t, x, y, p = (np.atleast_1d(events[the_name(field, names, what)]) for field in NAMES)
    return _microseconds(t), x, y, p


def _check_four(events: tuple[Any, ...] | list[Any]) -> None:
    """Refuse a list of single events, and anything but four columns."""
    is_event = isinstance(events[0], (dict, np.void)) or (
        isinstance(events[0], tuple) and len(events) != 4
    )
    if isinstance(events, list) and is_event:
        raise TypeError(
            f"a list of single events ({type(events[0]).__name__} at event 0) is not a packet: "
            "pass it to "
            "`stream`, event by event, or push four columns (t, x, y, p)"
        )
    if len(events) != 4:
        raise ValueError(
            f"a tuple of events must hold four columns (t, x, y, p), got {len(events)}"
        )


def _as_column(field: str, values: Any) -> np.ndarray:
    refuse_mask(field, values, UNMASKED)
    try:
        column = np.atleast_1d(np.asarray(values))
    except Exception as error:  # whatever a foreign object's __array__ raises
        raise ValueError(
            f"`{field}` must be a column of whole numbers: {one_line(error)}"
        ) from error
    if column.size == 0:
        return np.empty(column.shape, np.int64)  # [] is float64 to NumPy
    if (
        column.dtype.kind == "f"
        and isinstance(values, (list, tuple))
        and all(type(v) is int for v in values)
    ):
        # some beyond int64: NumPy made floats of them, `_check_type` names them
        return np.array(values, object)
    return _microseconds(column) if field == "t" else column


def _microseconds(t: np.ndarray) -> np.ndarray:
    """Dates and durations with a unit as whole microseconds, rounded down; others as they are.

    NumPy's own conversion would wrap around silently where microseconds do not fit into int64.
    """
    if t.dtype.kind not in "mM" or np.datetime_data(t.dtype)[0] == "generic":
        return t
    if np.isnat(t).any():
        raise ValueError(f"`t` must be a time, got NaT at event {int(np.argmax(np.isnat(t)))}")
    unit, multiple = np.datetime_data(t.dtype)
    in_calendar = unit in CALENDAR_DAYS
    if in_calendar and t.dtype.kind == "m":
        raise ValueError(
            f"`t` must be durations of a fixed length, got {t.dtype}; convert them to microseconds"
        )
    length = multiple * (CALENDAR_DAYS[unit] * UNITS_AS["D"] if in_calendar else UNITS_AS[unit])
    factor = length // math.gcd(length, UNITS_AS["us"])
    divisor = UNITS_AS["us"] // math.gcd(length, UNITS_AS["us"])
    count = t.astype(np.int64)
    beyond = np.abs(count) > min(MAX_INT64, MAX_INT64 * divisor // factor)
    if beyond.any():
        i = int(np.argmax(beyond))
        step = unit if multiple == 1 else f"x {multiple} {unit}"
        raise ValueError(
            f"`t` must be in [0, 2**62) microseconds, got {count[i]} {step} at event {i}"
        )
    if in_calendar:
        return t.astype("M8[us]").astype(np.int64)
    if factor == 1:
        return count // divisor
    if divisor == 1:
        return count * factor
    exact = [value * factor // divisor for value in count.tolist()]  # such as of units of 1500 ns
    return np.array(exact, np.int64)


def the_name(field: str, have: Collection[str], what: str) -> str:
    """The one name among `have` that means `field`.

    Raises
    ------
    ValueError : there is none, or there are several.
    """
    found = [name for name in have if name in NAMES[field]]
    if len(found) == 1:
        return found[0]
    if found:
        got = " and ".join(found) if len(set(found)) > 1 else f"{found[0]} {len(found)} times"
        raise ValueError(
            f"events need one field `{field}`, got {got} in {what}; leave out all but one"
        )
    raise ValueError(
        f"events need a field `{field}` (one of {', '.join(NAMES[field])}), got {what}"
    )
