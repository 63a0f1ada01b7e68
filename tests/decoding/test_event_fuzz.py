"""Any record layout, any numbers around the limits, any Python object: the decoder agrees with a slow oracle, and
nothing but ValueError or TypeError ever comes out of it."""

import datetime
import decimal
import fractions
import functools
from collections import namedtuple
from types import SimpleNamespace
from unittest.mock import MagicMock, Mock

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from async_tnt import EVENT_DTYPE
from async_tnt.events import NAMES, EventDecoder, as_events, checked_columns, named_columns

INTEGERS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
OURS = (np.int64, np.uint16, np.uint16, np.uint8)
FUZZ = settings(
    max_examples=250, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
SENSORS = [(34, 34), (346, 260), (128, 127), (129, 300), (256, 255), (1280, 720), (2**15, 2**15), (2, 2)]
LIMITS = [
    0,
    2**7,
    2**8,
    2**15,
    2**16,
    2**31,
    2**32,
    2**62,
    2**63,
    2**64,
    -(2**7),
    -(2**15),
    -(2**16),
    -(2**31),
    -(2**32),
]


def refused_or_columns(rows, kinds, sensor):
    """The oracle: what the rules say of these rows (t, x, y, p), in Python's integers. None: refused."""
    if any(kind not in ("iub" if field == "p" else "iu") for field, kind in kinds.items()):
        return None
    width, height = sensor
    polarities = {p for _, _, _, p in rows}
    if not (polarities <= {0, 1} or polarities <= {-1, 1}):
        return None
    for t, x, y, _ in rows:
        if not (0 <= t < 2**62 and 0 <= x < width and 0 <= y < height):
            return None
    return [(t, x, y, 1 if p == 1 else 0) for t, x, y, p in rows]


def rows_of(columns):
    assert all(column.flags.carray for column in columns[:4])
    assert [column.dtype for column in columns[:4]] == list(OURS)
    return list(zip(*(column[: columns.n].tolist() for column in columns[:4]), strict=True))


def outcome(take, *args):
    """The rows that came out, or None if they were refused."""
    try:
        return rows_of(take(*args))
    except (ValueError, TypeError):
        return None


def memory(values):
    """All bytes that an array is a view of."""
    while isinstance(values.base, np.ndarray):
        values = values.base
    return values.tobytes()


# -- records of any layout -----------------------------------------------------------------------------------


@functools.cache
def numbers(field, number, sensor, trouble):
    """Values of one field such as its type can hold: right ones, or around the limits for `trouble`."""
    end = {"t": 2**62, "x": sensor[0], "y": sensor[1], "p": 2}[field]
    low, high = -(2**65), 2**65
    if number is not None:
        low, high = (0, 1) if number == "?" else (-1024, 1024)
        if number in INTEGERS:
            low, high = int(np.iinfo(number).min), int(np.iinfo(number).max)
    if not trouble:
        return st.sampled_from([-1, 1]) if field == "p" and low < 0 else st.integers(0, min(end - 1, high))
    around = [limit + d for limit in [*LIMITS, end] for d in (-2, -1, 0, 1, 3) if low <= limit + d <= high]
    nearest = [value for value in (-1, end - 1, end) if low <= value <= high]
    right = st.integers(0, min(end - 1, high))
    return st.one_of(right, right, st.sampled_from(nearest or [0]), st.sampled_from(around), st.integers(low, high))


@functools.cache
def lists_of_rows(types, sensor, trouble, min_size=0):
    rows = (numbers(field, number, sensor, field == trouble) for field, number in zip(NAMES, types, strict=True))
    return st.lists(st.tuples(*rows), min_size=min_size, max_size=5)


USUAL = {"t": ("i8", "i8", "u8", "u4"), "x": ("u2", "i2"), "y": ("u2", "i2"), "p": ("?", "u1", "i1", "i2")}
FORMATS = st.tuples(
    *(
        st.tuples(st.one_of(st.sampled_from(usual), st.sampled_from(INTEGERS)), st.sampled_from("<<<>"))
        for usual in USUAL.values()
    )
)
STRANGE = st.one_of(st.none(), st.none(), st.none(), st.tuples(st.integers(0, 3), st.sampled_from(["f8", "f2", "?"])))
ALIASES = st.tuples(*(st.sampled_from(aliases) for aliases in NAMES.values()))
ORDERS = st.permutations(range(4))
GAPS = st.tuples(*[st.integers(0, 3)] * 5)
TROUBLE = st.sampled_from([*NAMES, *[None] * 5])
STORED = st.sampled_from(["plain", "read-only", "strided", "backwards", "unaligned"])


@st.composite
def layouts(draw):
    """A record dtype, and the names of t, x, y, p in it."""
    formats = [order + number if number != "?" else number for number, order in draw(FORMATS)]
    strange = draw(STRANGE)
    if strange is not None:
        formats[strange[0]] = strange[1]
    names, order = draw(ALIASES), draw(ORDERS)
    how = draw(st.sampled_from(["packed", "aligned", "anywhere"]))
    if how != "anywhere":
        return np.dtype([(names[k], formats[k]) for k in order], align=how == "aligned"), names
    gaps = draw(GAPS)  # fields anywhere in memory, whatever order their names are in
    offsets, end = {}, 0
    for k in draw(ORDERS):
        offsets[k] = end + gaps[k]
        end = offsets[k] + np.dtype(formats[k]).itemsize
    fields = {"names": names, "formats": formats, "offsets": [offsets[k] for k in range(4)], "itemsize": end + gaps[4]}
    return np.dtype(
        {key: [value[k] for k in order] if key != "itemsize" else value for key, value in fields.items()}
    ), names


def stored(events, how):
    """The same records in another memory."""
    if how == "strided":
        return np.repeat(events, 3)[1::3]
    if how == "backwards":
        return events[::-1].copy()[::-1]
    if how == "unaligned":
        return np.frombuffer(b"\xff" + events.tobytes(), events.dtype, offset=1)
    events.flags.writeable = how != "read-only"
    return events


@FUZZ
@given(st.data(), layouts(), st.sampled_from(SENSORS), TROUBLE, STORED, st.integers(0, 255))
def test_records_of_any_layout(data, layout, sensor, trouble, how, padding):
    dtype, names = layout
    types = tuple(dtype.fields[name][0].str.lstrip("<>|").replace("b1", "?") for name in names)
    rows = data.draw(lists_of_rows(types, sensor, trouble))
    kinds = {field: dtype.fields[name][0].kind for field, name in zip(NAMES, names, strict=True)}
    expected = refused_or_columns(rows, kinds, sensor)
    event("refused" if expected is None else "taken")

    events = np.full(len(rows) * dtype.itemsize, padding, np.uint8).view(dtype)
    for name, column in zip(names, zip(*rows, strict=True), strict=False):
        events[name] = column
    events = stored(events, how)
    before = memory(events)

    decoder = EventDecoder(sensor)
    assert outcome(decoder.decode, events) == expected  # most of them by the fast way
    assert outcome(decoder.decode, events) == expected
    assert outcome(lambda: checked_columns(*named_columns(events), sensor)) == expected  # all by the slow one
    columns = tuple(events[name] for name in names)
    assert outcome(decoder.decode, columns) == (expected if rows else [])
    assert outcome(decoder.decode, tuple(column.copy() for column in columns)) == (expected if rows else [])
    if rows:
        assert outcome(decoder.decode, events[-1]) == refused_or_columns(rows[-1:], kinds, sensor)
    if expected is not None:
        assert [tuple(row) for row in as_events(events, sensor).tolist()] == expected
    assert memory(events) == before


@FUZZ
@given(st.data(), st.sampled_from(SENSORS), TROUBLE)
def test_columns_of_python_integers(data, sensor, trouble):
    rows = data.draw(lists_of_rows((None,) * 4, sensor, trouble, min_size=1))
    expected = refused_or_columns(rows, dict.fromkeys(NAMES, "i"), sensor)
    event("refused" if expected is None else "taken")
    columns = [list(column) for column in zip(*rows, strict=True)]
    decoder = EventDecoder(sensor)
    assert outcome(decoder.decode, tuple(columns)) == expected
    assert outcome(decoder.decode, SimpleNamespace(**dict(zip(NAMES, columns, strict=True)))) == expected
    for row in rows:
        assert outcome(decoder.decode, row) == refused_or_columns([row], dict.fromkeys(NAMES, "i"), sensor)


@FUZZ
@given(st.data(), st.sampled_from(SENSORS), TROUBLE)
def test_columns_of_the_right_types(data, sensor, trouble):
    """The way in that copies nothing checks as the others do."""
    rows = data.draw(lists_of_rows(("i8", "u2", "u2", "u1"), sensor, trouble, min_size=1))
    expected = refused_or_columns(rows, dict.fromkeys(NAMES, "i"), sensor)
    event("refused" if expected is None else "taken")
    columns = tuple(np.array(column, dtype) for column, dtype in zip(zip(*rows, strict=True), OURS, strict=True))
    assert outcome(EventDecoder(sensor).decode, columns) == expected
    assert outcome(lambda: checked_columns(*columns, sensor)) == expected


# -- anything at all -----------------------------------------------------------------------------------------


class Holder:
    """An object that hands something out in one of the ways that the decoder knows."""

    def __init__(self, how, value):
        self.how, self.value = how, value

    def __getattr__(self, name):
        if name in ("how", "value"):
            raise AttributeError(name)
        if name == self.how:
            return (lambda: self.value) if name == "numpy" else self.value
        raise AttributeError(name)

    def __repr__(self):
        raise RuntimeError("no words for it")


class Array:
    """An object that claims to be an array."""

    def __init__(self, value):
        self.value = value

    def __array__(self, dtype=None, copy=None):
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value


Pair = namedtuple("Pair", "x y")
Quad = namedtuple("Quad", "p y x t")
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(-1, 33),
    st.floats(),
    st.complex_numbers(),
    st.text(max_size=4),
    st.binary(max_size=4),
    st.datetimes(),
    st.timedeltas(),
    st.decimals(),
    st.fractions(),
    st.sampled_from([object(), int, len, Ellipsis, NotImplemented, np.nan, np.float32, range(4), slice(3), iter(())]),
    st.sampled_from([datetime.date(2026, 1, 1), decimal.Decimal("1.5"), fractions.Fraction(1, 3), np.ma.masked]),
    st.builds(Array, st.sampled_from([KeyError("k"), RuntimeError("r"), ZeroDivisionError(), OSError(5), 5, None])),
)
FIELD_TYPES = st.sampled_from([np.dtype(name) for name in ("i8", "u2", "i2", ">u4", "?", "f4", "S2", "M8[us]", "O")])
DTYPES = st.one_of(
    hnp.scalar_dtypes(),
    hnp.array_dtypes(max_size=5),
    hnp.array_dtypes(FIELD_TYPES, min_size=4),
    st.sampled_from([np.dtype(object), EVENT_DTYPE]),
)
COLUMNS = st.sampled_from(  # two events each
    [[0, 1], (1, 1), [True, False], [-1, 1], np.array([1, 0]), np.array([0, 1], ">u2"), np.zeros(2, "u1"), [33, 2**62]]
)


def made_array(dtype, shape, byte):
    if dtype.hasobject or dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    return np.full(int(np.prod(shape)) * dtype.itemsize, byte, np.uint8).view(dtype).reshape(shape)


ARRAYS = st.builds(
    made_array, DTYPES, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4), st.integers(0, 255)
)
FIELDS = st.sampled_from(["t", "ts", "timestamp", "x", "y", "p", "on", "polarity", "pol", "polarity_events", "shape"])


def containers(parts):
    return st.one_of(
        st.lists(parts, max_size=6),
        st.lists(parts, max_size=6).map(tuple),
        st.tuples(parts, parts, parts, parts),
        st.lists(parts, min_size=4, max_size=4),
        st.builds(Quad, parts, parts, parts, parts),
        st.builds(Pair, parts, parts),
        st.dictionaries(FIELDS, parts, max_size=5),
        st.dictionaries(FIELDS, parts, max_size=6).map(lambda fields: SimpleNamespace(**fields)),
        st.builds(lambda t, x, y, p: SimpleNamespace(t=t, x=x, y=y, p=p), parts, parts, parts, parts),
        st.builds(Holder, st.sampled_from(["polarity_events", "numpy"]), parts),
        st.builds(Array, parts),
    )


ANYTHING = st.one_of(
    SCALARS,
    ARRAYS,
    containers(COLUMNS),
    containers(st.one_of(COLUMNS, COLUMNS, COLUMNS, SCALARS, ARRAYS)),
    containers(containers(st.one_of(COLUMNS, SCALARS, ARRAYS))),
)
RENAMED = st.permutations(["t", "x", "y", "p", "a"])


@settings(FUZZ, max_examples=600)
@given(ANYTHING, st.sampled_from(["accept", "drop", "raise"]))
def test_anything_at_all(thing, late):
    decoder = EventDecoder((34, 33), late)
    for _ in range(2):
        try:
            columns = decoder.decode(thing)
        except (ValueError, TypeError) as error:
            assert str(error)
            event(type(error).__name__)
            continue
        event("taken, empty" if columns.n == 0 else "taken")
        for t, x, y, p in rows_of(columns):
            assert 0 <= t < 2**62 and 0 <= x < 34 and 0 <= y < 33 and p in (0, 1)
    assert rows_of(decoder.decode(([2**62 - 1], [33], [32], [1]))) == [(2**62 - 1, 33, 32, 1)]


@FUZZ
@given(
    st.one_of(hnp.array_dtypes(FIELD_TYPES, min_size=4), DTYPES),
    RENAMED,
    st.integers(0, 3),
    st.sampled_from([0, 0, 1, 255]),
)
def test_structured_arrays_of_any_types(dtype, names, n, byte):
    """Fields of every type that NumPy has, under the right names: whole numbers or nothing."""
    if dtype.names is not None:
        formats = [dtype.fields[name][0] for name in dtype.names][:5]
        dtype = np.dtype(list(zip(names, formats, strict=False)))
    events = made_array(dtype, (n,), byte)
    fast = outcome(EventDecoder((34, 33)).decode, events)
    assert fast == outcome(EventDecoder((34, 33)).decode, np.repeat(events, 2)[::2])
    event("taken" if fast else "refused or empty")
    if fast:
        assert all(dtype.fields[name][0].kind in "iu" for name in "txy")
        assert fast == [(*(int(row[name]) for name in "txy"), int(row["p"] == 1)) for row in events]


def test_a_mock_has_every_attribute():
    with pytest.raises(ValueError, match=r"^events need one field `t`, got t and ts and timestamp in a Mock"):
        EventDecoder((34, 34)).decode(Mock())
    assert outcome(EventDecoder((34, 34)).decode, MagicMock()) in (None, [])
