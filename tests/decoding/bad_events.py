"""Packets that break a rule, with the message that says so; for the tests in this folder."""

from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import torch

from async_tnt import EVENT_DTYPE

SENSOR = (346, 260)
GOOD = {"t": [10, 11, 11, 12, 13], "x": [0, 345, 1, 2, 3], "y": [259, 0, 1, 2, 3], "p": [1, 1, 1, 1, 1]}
TYPES = {"t": "<i8", "x": "<u2", "y": "<u2", "p": "i1"}
FORMS = (
    "events must be a structured array with fields t|ts|timestamp, x, y, p|on|polarity|pol, a tuple of four "
    "columns (t, x, y, p), or an object with .t .x .y .p, .polarity_events or .numpy(); got "
)

# -- numbers that break a rule: the field, how it is stored, the number, the message -------------------------

TIME = "`t` must be in [0, 2**62) microseconds, got {} at event 3"
COLUMN = "`x` must be in [0, 346), got {} at event 3"
ROW = "`y` must be in [0, 260), got {} at event 3"
POLARITY = "`p` must be 0 or 1, or -1 or +1, got {} at event 3"
NUMBERS = [
    *[("t", "<i8", value, TIME) for value in (-1, -(2**63), 2**62, 2**63 - 1)],
    *[("t", "<u8", value, TIME) for value in (2**62, 2**63, 2**64 - 1)],
    *[("t", "<i4", value, TIME) for value in (-1, -(2**31))],
    *[("t", "i1", -1, TIME), ("t", "<i2", -300, TIME)],
    *[("x", "<u2", value, COLUMN) for value in (346, 347, 32768, 65535)],
    *[("x", "<i2", value, COLUMN) for value in (346, -1, -32768, 32767)],
    *[("x", "<i4", value, COLUMN) for value in (346, -1, 65536, 65536 + 3, -65536, -65533)],  # 3 in 16 bits
    *[("x", "<u4", value, COLUMN) for value in (346, 65536 + 3, 2**32 - 1)],
    *[("x", "<i8", value, COLUMN) for value in (346, -1, 65536 + 3, 2**32 + 3, -(2**63), -(2**32) + 3)],
    *[("x", "<u8", value, COLUMN) for value in (346, 2**32 + 3, 2**63 + 3, 2**64 - 1)],
    *[("x", "i1", value, COLUMN) for value in (-1, -128)],
    *[("y", "<u2", value, ROW) for value in (260, 65535)],
    *[("y", "<i2", value, ROW) for value in (260, -1)],
    *[("y", "<i4", value, ROW) for value in (260, -1, 65536 + 3)],
    *[("p", "u1", value, POLARITY) for value in (2, 128, 255)],
    *[("p", "i1", value, POLARITY) for value in (2, -2, 127, -128)],
    *[("p", "<i8", value, POLARITY) for value in (2, -2, 2**32 + 1, 2**32 - 1, 256)],
    *[("p", "<u8", value, POLARITY) for value in (2, 2**63, 2**64 - 1)],  # 2**64 - 1 is no -1
    *[("p", "<u2", value, POLARITY) for value in (65535, 256)],
    ("p", "<u4", 2**32 - 1, POLARITY),
]


def columns_of(**changes):
    """The good packet, with `field=(how it is stored, number)` put in place of event 3's."""
    columns = {field: np.array(column, TYPES[field]) for field, column in GOOD.items()}
    for field, (number, value) in changes.items():
        columns[field] = columns[field].astype(number)
        columns[field][3] = value
    return columns


def as_records(columns, order="txyp", swap=False):
    events = np.zeros(5, [(f, columns[f].dtype.newbyteorder() if swap else columns[f].dtype) for f in order])
    for field, column in columns.items():
        events[field] = column
    return events


def in_every_form(columns):
    """The same packet as `EventDecoder` may meet it."""
    yield "records", as_records(columns)
    yield "records, other order", as_records(columns, "pyxt")
    yield "records, big-endian", as_records(columns, swap=True)
    yield "records, strided", np.repeat(as_records(columns), 2)[::2]
    yield "columns", tuple(columns.values())
    yield "columns, strided", tuple(np.repeat(column, 2)[::2] for column in columns.values())
    yield "lists", tuple(column.tolist() for column in columns.values())
    yield "object", SimpleNamespace(**columns)
    ours = {field: column.astype(EVENT_DTYPE[field]) for field, column in columns.items()}
    if all(np.array_equal(ours[field], columns[field]) for field in columns):  # what the decoder does not copy
        yield "columns as they should be", tuple(ours.values())


BAD = {}  # everything that is refused: name -> (events, type of error, its message)
for _field, _number, _value, _message in NUMBERS:
    for _form, _events in in_every_form(columns_of(**{_field: (_number, _value)})):
        _text = _message.format(_value)
        if _form == "lists" and _value >= 2**63:  # Python's integers are not bound to a type
            _text = f"`{_field}` must fit in int64, got {_value} at event 3"
        BAD[f"{_field} = {_value} in {_number}, {_form}"] = _events, ValueError, _text

# -- polarity of two kinds -----------------------------------------------------------------------------------

for _form, _events in in_every_form(columns_of() | {"p": np.array([1, 0, 1, 1, -1], "i1")}):
    BAD[f"-1 beside 0, {_form}"] = (
        _events,
        ValueError,
        "`p` must be 0 or 1, or -1 or +1, got -1 beside 0 in the same packet at event 4",
    )
for _form, _events in in_every_form(columns_of() | {"p": np.array([1, 2, 1, -1, 0], "i1")}):
    BAD[f"2 before a -1 beside 0, {_form}"] = (
        _events,
        ValueError,
        "`p` must be 0 or 1, or -1 or +1, got 2 at event 1",
    )

# -- the first fault is named --------------------------------------------------------------------------------

for _form, _events in in_every_form(columns_of() | {"x": np.array([0, 1, 900, 2, 800], "<u2")}):
    BAD[f"two off the sensor, {_form}"] = _events, ValueError, "`x` must be in [0, 346), got 900 at event 2"
for _form, _events in in_every_form(
    columns_of() | {"y": np.array([0, 260, 0, 0, 0], "<u2"), "t": np.array([0, 0, 0, 0, -1])}
):
    BAD[f"time before pixels, {_form}"] = (
        _events,
        ValueError,
        "`t` must be in [0, 2**62) microseconds, got -1 at event 4",
    )

# -- no whole numbers ----------------------------------------------------------------------------------------

NO_UNIT = "`t` must be integer microseconds, got "
SECONDS = "; its unit is unknown: convert seconds with np.rint(t * 1e6).astype('int64')"
NOT_WHOLE = [
    ("t", np.array([0.5, 1, 2, 3, 4]), TypeError, NO_UNIT + "float64 (0.5 at event 0)" + SECONDS),
    ("t", np.array([0, 1, 2, 3, 4], "f4"), TypeError, NO_UNIT + "float32 (0.0 at event 0)" + SECONDS),
    ("t", np.array([0, 1, np.nan, 3, 4]), ValueError, "`t` must be a whole number, got nan at event 2"),
    ("t", np.array([0, 1, 2, np.inf, 4], "f4"), ValueError, "`t` must be a whole number, got inf at event 3"),
    ("t", np.array([0, 1, 2, 3, -np.inf], "f2"), ValueError, "`t` must be a whole number, got -inf at event 4"),
    (
        "t",
        np.array(["2026-01-01"] * 5, "M8[us]"),
        TypeError,
        NO_UNIT + "datetime64[us] (2026-01-01T00:00:00.000000 at event 0)" + SECONDS,
    ),
    (
        "t",
        np.array([3] * 5, "m8[us]"),
        TypeError,
        NO_UNIT + "timedelta64[us] (3 microseconds at event 0)" + SECONDS,
    ),
    ("t", np.array([True] * 5), TypeError, "`t` must be whole numbers, got bool (True at event 0)"),
    ("t", np.array(["12"] * 5), TypeError, "`t` must be whole numbers, got <U2 (12 at event 0)"),
    ("x", np.array([1.0, 2, 3, 4, 5]), TypeError, "`x` must be whole numbers, got float64 (1.0 at event 0)"),
    ("x", np.array([1.0, 2, 3, 4, np.nan]), ValueError, "`x` must be a whole number, got nan at event 4"),
    ("x", np.array([1, 2, 3, 4, 5], "c8"), TypeError, "`x` must be whole numbers, got complex64 ((1+0j) at event 0)"),
    ("x", np.array([True] * 5), TypeError, "`x` must be whole numbers, got bool (True at event 0)"),
    ("x", np.array(["a" * 99] * 5), TypeError, f"`x` must be whole numbers, got <U99 ({'a' * 40} at event 0)"),
    ("y", np.array([b"ab"] * 5), TypeError, "`y` must be whole numbers, got |S2 (b'ab' at event 0)"),
    ("y", np.array([None] * 5), TypeError, "`y` must be whole numbers, got object (NoneType at event 0)"),
    ("y", np.array([1, 2, 3, 4, 5], object), TypeError, "`y` must be whole numbers, got object (int at event 0)"),
    ("y", np.array([1, 2, 3, 4, -(2**70)], object), ValueError, f"`y` must fit in int64, got {-(2**70)} at event 4"),
    ("p", np.array([1.0, 0, 1, 1, 1]), TypeError, "`p` must be whole numbers, got float64 (1.0 at event 0)"),
    ("p", np.array([1, np.nan, 1, 1, 1]), ValueError, "`p` must be a whole number, got nan at event 1"),
    ("p", np.array(["ON"] * 5), TypeError, "`p` must be whole numbers, got <U2 (ON at event 0)"),
]
for _field, _column, _error, _message in NOT_WHOLE:
    _columns = columns_of() | {_field: _column}
    BAD[f"{_field} in {_column.dtype}, records: {_message[:50]}"] = as_records(_columns), _error, _message
    BAD[f"{_field} in {_column.dtype}, columns: {_message[:50]}"] = tuple(_columns.values()), _error, _message
    BAD[f"{_field} in {_column.dtype}, object: {_message[:50]}"] = SimpleNamespace(**_columns), _error, _message

# -- no packet at all ----------------------------------------------------------------------------------------


class Broken:
    def __array__(self, dtype=None, copy=None):
        raise KeyError("no such chunk")


class Itself:
    @property
    def polarity_events(self):
        return self


class Store:
    def __init__(self, events):
        self.events = events

    def numpy(self):
        return self.events() if callable(self.events) else self.events


def never_ready():
    raise RuntimeError("not\n  ready")


T, X, Y, P = GOOD.values()
Named = namedtuple("Named", "x y")
Timeless = namedtuple("Timeless", "x y p when")
BAD |= {
    "a plain array": (np.zeros((5, 4)), TypeError, FORMS + "a plain array of shape (5, 4)"),
    "a number in an array": (np.array(5), TypeError, FORMS + "a plain array of shape ()"),
    "bytes in a void": (np.void(b"abcd"), TypeError, FORMS + "a plain array of shape ()"),
    "a table in a tensor": (torch.zeros(5, 4), TypeError, FORMS + "a plain array of shape (5, 4)"),
    "a number": (5, TypeError, FORMS + "int"),
    "a float": (float("nan"), TypeError, FORMS + "float"),
    "text": ("t,x,y,p", TypeError, FORMS + "str"),
    "bytes": (b"1234", TypeError, FORMS + "bytes"),
    "a dict": (dict(GOOD), TypeError, FORMS + "dict"),
    "a set": ({1, 2, 3, 4}, TypeError, FORMS + "set"),
    "an object": (object(), TypeError, FORMS + "object"),
    "a generator": ((event for event in ()), TypeError, FORMS + "generator"),
    "an object with x only": (SimpleNamespace(x=X), TypeError, FORMS + "SimpleNamespace"),
    "its own events": (Itself(), TypeError, FORMS + "Itself"),
    "a store of a number": (Store(5), TypeError, FORMS + "int"),
    "a store that fails": (Store(never_ready), TypeError, "Store.numpy() failed: not ready"),
    "a tensor with a gradient": (
        torch.zeros(3, requires_grad=True),
        TypeError,
        "Tensor.numpy() failed: Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.",
    ),
    "three columns": ((T, X, Y), ValueError, "a tuple of events must hold four columns (t, x, y, p), got 3"),
    "five columns": ([T, X, Y, P, P], ValueError, "a tuple of events must hold four columns (t, x, y, p), got 5"),
    "a named tuple of two": (
        Named(X, Y),
        ValueError,
        "a tuple of events must hold four columns (t, x, y, p), got 2",
    ),
    "a named tuple without a time": (
        Timeless(X, Y, P, T),
        ValueError,
        "events need a field `t` (one of t, ts, timestamp), got a Timeless with attributes x, y, p",
    ),
    "no time": (
        np.zeros(5, [("x", "<u2"), ("y", "<u2"), ("p", "u1")]),
        ValueError,
        "events need a field `t` (one of t, ts, timestamp), got a structured array with fields x, y, p",
    ),
    "no x": (
        np.zeros(0, [("t", "<i8"), ("y", "<u2"), ("p", "u1")]),
        ValueError,
        "events need a field `x` (one of x), got a structured array with fields t, y, p",
    ),
    "no polarity": (
        np.zeros(1, [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("P", "u1")])[0],
        ValueError,
        "events need a field `p` (one of p, on, polarity, pol), got a structured array with fields t, x, y, P",
    ),
    "no fields": (
        np.zeros(3, []),
        ValueError,
        "events need a field `t` (one of t, ts, timestamp), got a structured array with fields ",
    ),
    "an object without a polarity": (
        SimpleNamespace(ts=T, x=X, y=Y),
        ValueError,
        "events need a field `p` (one of p, on, polarity, pol), got a SimpleNamespace with attributes ts, x, y",
    ),
    "unequal lengths": (
        (T, X[:4], Y, P),
        ValueError,
        "t, x, y and p must have equal lengths, got 5, 4, 5, 5",
    ),
    "unequal lengths, right types": (
        (*tuple(np.zeros(5, EVENT_DTYPE[f]) for f in "txy"), np.zeros(6, "u1")),
        ValueError,
        "t, x, y and p must have equal lengths, got 5, 5, 5, 6",
    ),
    "no times for five events": (
        ([], X, Y, P),
        ValueError,
        "t, x, y and p must have equal lengths, got 0, 5, 5, 5",
    ),
    "one polarity for all": (
        (T, X, Y, 1),
        ValueError,
        "t, x, y and p must have equal lengths, got 5, 5, 5, 1",
    ),
    "an image of events": (
        np.zeros((2, 3), EVENT_DTYPE),
        ValueError,
        "`t` must have one dimension, got shape (2, 3)",
    ),
    "an empty image of events": (
        np.zeros((0, 3), EVENT_DTYPE),
        ValueError,
        "`t` must have one dimension, got shape (0, 3)",
    ),
    "two columns of x": ((T, [X, X], Y, P), ValueError, "`x` must have one dimension, got shape (2, 5)"),
    "columns that stand up": (
        tuple(np.array([column]).T for column in (T, X, Y, P)),
        ValueError,
        "`t` must have one dimension, got shape (5, 1)",
    ),
    "two numbers in a field": (
        np.zeros(5, [("t", "<i8"), ("x", "<u2", (2,)), ("y", "<u2"), ("p", "u1")]),
        ValueError,
        "`x` must have one dimension, got shape (5, 2)",
    ),
    "fields within a field": (
        np.zeros(5, [("t", "<i8"), ("x", [("a", "<u2")]), ("y", "<u2"), ("p", "u1")]),
        TypeError,
        "`x` must be whole numbers, got [('a', '<u2')] ((0,) at event 0)",
    ),
    "four events, not four columns": (
        list(np.zeros(4, EVENT_DTYPE)),
        TypeError,
        "a list of single events (void at event 0) is not a packet: hand it to `stream`, event by event, or push "
        "four columns (t, x, y, p)",
    ),
    "a time beyond int64": (
        ([5, 2**64], [0, 0], [0, 0], [0, 0]),
        ValueError,
        f"`t` must fit in int64, got {2**64} at event 1",
    ),
    "an event with a time beyond int64": (
        (-(2**63) - 1, 0, 0, 0),
        ValueError,
        f"`t` must fit in int64, got {-(2**63) - 1} at event 0",
    ),
    "a column of nothing": ((T, X, Y, None), TypeError, "`p` must be whole numbers, got object (NoneType at event 0)"),
    "a column of text": (("abc", X, Y, P), TypeError, "`t` must be whole numbers, got <U3 (abc at event 0)"),
    "a column that cannot be read": (
        (T, Broken(), Y, P),
        ValueError,
        "`x` must be a column of whole numbers: 'no such chunk'",
    ),
    "methods for columns": (
        SimpleNamespace(t=never_ready, x=X, y=Y, p=P),
        TypeError,
        "`t` must be whole numbers, got object (function at event 0)",
    ),
}

# -- masked arrays ---------------------------------------------------------------------------------------------

MASKED = (
    "`{}` must not be a masked array, whose mask would be ignored; "
    "pass `.compressed()` of each column, or `.data` to use every event"
)
_masked = {field: np.ma.array(column, EVENT_DTYPE[field], mask=[0, 1, 0, 0, 0]) for field, column in GOOD.items()}
_records = np.ma.array(as_records(columns_of()), mask=[0, 1, 0, 0, 0])
BAD |= {
    "masked columns": (tuple(_masked.values()), TypeError, MASKED.format("t")),
    "one masked column, nothing masked": (
        (*tuple(np.array(GOOD[f], EVENT_DTYPE[f]) for f in "txy"), np.ma.array(GOOD["p"], "u1")),
        TypeError,
        MASKED.format("p"),
    ),
    "an object with masked columns": (SimpleNamespace(**GOOD | {"x": _masked["x"]}), TypeError, MASKED.format("x")),
    "masked records": (_records, TypeError, MASKED.format("events")),
    "one record of masked ones": (_records[1], TypeError, MASKED.format("events")),
    "a store of masked records": (Store(_records), TypeError, MASKED.format("events")),
}

# -- one field under two names -----------------------------------------------------------------------------------

TWICE = "events need one field `{}`, got {} in {}; leave out all but one"
BAD |= {
    "two times in records": (
        np.zeros(5, [("ts", "<i8"), *EVENT_DTYPE.descr]),
        ValueError,
        TWICE.format("t", "ts and t", "a structured array with fields ts, t, x, y, p"),
    ),
    "two polarities in an object": (
        SimpleNamespace(**GOOD, on=P),
        ValueError,
        TWICE.format("p", "p and on", "a SimpleNamespace with attributes t, x, y, p, on"),
    ),
}

# -- one event: (t, x, y, p) as numbers ------------------------------------------------------------------------

ONE = [
    ((-1, 0, 0, 1), ValueError, "`t` must be in [0, 2**62) microseconds, got -1 at event 0"),
    ((2**62, 0, 0, 1), ValueError, f"`t` must be in [0, 2**62) microseconds, got {2**62} at event 0"),
    ((2**63, 0, 0, 1), ValueError, f"`t` must be in [0, 2**62) microseconds, got {2**63} at event 0"),
    ((2**64, 0, 0, 1), ValueError, f"`t` must fit in int64, got {2**64} at event 0"),
    ((5, 346, 0, 1), ValueError, "`x` must be in [0, 346), got 346 at event 0"),
    ((5, -1, 0, 1), ValueError, "`x` must be in [0, 346), got -1 at event 0"),
    ((5, 65536 + 3, 0, 1), ValueError, "`x` must be in [0, 346), got 65539 at event 0"),
    ((5, 2**64 + 3, 0, 1), ValueError, f"`x` must fit in int64, got {2**64 + 3} at event 0"),
    ((5, 0, 260, 1), ValueError, "`y` must be in [0, 260), got 260 at event 0"),
    ((5, 0, -(2**70), 1), ValueError, f"`y` must fit in int64, got {-(2**70)} at event 0"),
    ((5, 0, 0, 2), ValueError, "`p` must be 0 or 1, or -1 or +1, got 2 at event 0"),
    ((5, 0, 0, -2), ValueError, "`p` must be 0 or 1, or -1 or +1, got -2 at event 0"),
    ((5.0, 0, 0, 1), TypeError, NO_UNIT + "float64 (5.0 at event 0)" + SECONDS),
    ((5, 1.5, 0, 1), TypeError, "`x` must be whole numbers, got float64 (1.5 at event 0)"),
    ((5, float("nan"), 0, 1), ValueError, "`x` must be a whole number, got nan at event 0"),
    ((5, 0, "1", 1), TypeError, "`y` must be whole numbers, got <U1 (1 at event 0)"),
    ((5, 0, 0, None), TypeError, "`p` must be whole numbers, got object (NoneType at event 0)"),
    ((5, 0, 0, 0.5), TypeError, "`p` must be whole numbers, got float64 (0.5 at event 0)"),
    ((5, [1, 2], 0, 1), ValueError, "`x` must have one dimension, got shape (1, 2)"),
]
