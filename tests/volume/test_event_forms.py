"""Events in any accepted form become the same four columns."""

import array
import importlib
import itertools
import math
import warnings
import zipfile
from collections import namedtuple
from contextlib import suppress
from fractions import Fraction
from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from async_tnt.sources import open_recording
from async_tnt.volume.event_forms import NAMES, event_columns
from async_tnt.volume.events import EVENT_DTYPE, EventDecoder, as_events

SENSOR = (346, 260)
T = [16_777_217, 16_777_219, 16_777_219, 16_777_218, 2_000_000_003, 2_000_000_004, 2_000_000_005]
X = [0, 345, 1, 255, 256, 128, 17]
Y = [259, 0, 1, 255, 256, 127, 33]
P = [1, 0, 0, 1, 1, 0, 1]
EVENTS = [T, X, Y, P]
TYPES = (np.int64, np.uint16, np.uint16, np.uint8)

LAYOUTS = {  # fuzzing makes any other
    "metavision": [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")],
    "dv": [("timestamp", "<i8"), ("x", "<i2"), ("y", "<i2"), ("polarity", "<i1")],
    "ours": EVENT_DTYPE,
    "aligned, with titles": np.dtype(
        [
            (("column", "x"), "<u2"),
            (("row", "y"), "<u2"),
            (("on?", "p"), "i1"),
            (("us", "t"), "<i8"),
        ],
        align=True,
    ),
    "more fields": [
        ("id", "S3"),
        *EVENT_DTYPE.descr,
        ("wall", "M8[us]"),
        ("w", "<f4", (2,)),
        ("note", "U2"),
    ],
    "big-endian": [("t", ">i8"), ("x", ">u2"), ("y", ">u2"), ("p", ">i2")],
    "with objects": [*EVENT_DTYPE.descr, ("note", "O")],
}


def records(layout, columns=EVENTS):
    """A structured array of these columns."""
    events = np.zeros(len(columns[0]), layout)
    for names, column in zip(NAMES.values(), columns, strict=True):
        events[next(name for name in names if name in events.dtype.names)] = column
    return events


STORED = {
    "read-only": lambda values: np.frombuffer(values.tobytes(), values.dtype),
    "every second": lambda values: np.repeat(values, 2)[::2],
    "backwards": lambda values: values[::-1].copy()[::-1],
    "unaligned": lambda values: np.frombuffer(b"\xff" + values.tobytes(), values.dtype, offset=1),
    "in Fortran order": lambda values: np.asfortranarray(np.stack([values, values]))[1],
}


def decoded(decoder, events):
    """The columns as lists; what is promised of their memory is checked on the way."""
    columns = decoder.decode(events)
    for column, dtype in zip(columns[:4], TYPES, strict=True):
        assert column.dtype == dtype and column.ndim == 1 and len(column) >= columns.n
        assert column.flags.carray  # one compiled version of every kernel
    return [column[: columns.n].tolist() for column in columns[:4]]


def assert_decoded(events, expected=EVENTS):
    """Twice by one decoder, and by `as_events`; the caller's arrays are left as they are."""
    arrays = [
        a
        for a in (events if isinstance(events, (tuple, list)) else [events])
        if isinstance(a, np.ndarray)
    ]
    before = [a.tobytes() for a in arrays]
    decoder = EventDecoder(SENSOR)
    assert decoded(decoder, events) == decoded(decoder, events) == expected
    packed = as_events(events, SENSOR)
    assert packed.dtype == EVENT_DTYPE
    assert [packed[name].tolist() for name in "txyp"] == expected
    assert [a.tobytes() for a in arrays] == before


# -- structured arrays -----------------------------------------------------------------------------


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_records_of_every_layout(layout):
    events = records(layout)
    assert_decoded(events)
    assert_decoded(events[3], [[column[3]] for column in EVENTS])  # one record
    assert_decoded(events[3:4].reshape(()), [[column[3]] for column in EVENTS])
    assert_decoded(SimpleNamespace(polarity_events=SimpleNamespace(numpy=lambda: events)))


def test_fields_that_are_renamed_in_place_are_found_by_their_new_names():
    columns = [[5, 6], [1, 2], [3, 4], [1, 0]]
    events = records(EVENT_DTYPE.descr, columns)
    decoder = EventDecoder(SENSOR)
    assert decoded(decoder, events) == columns
    events.dtype.names = ("t", "y", "x", "p")
    assert decoded(decoder, events) == [columns[k] for k in (0, 2, 1, 3)]


@pytest.mark.parametrize("stored", STORED.values(), ids=STORED)
def test_any_memory(stored):
    for layout in ("ours", "big-endian"):
        assert_decoded(stored(records(LAYOUTS[layout])))
    assert_decoded(
        tuple(stored(np.array(column, dtype)) for column, dtype in zip(EVENTS, TYPES, strict=True))
    )
    assert_decoded([stored(np.array(column)) for column in EVENTS])


# -- columns ---------------------------------------------------------------------------------------


def test_columns_that_are_not_arrays():
    for make in (
        tuple,
        lambda column: [np.int32(value) for value in column],
        lambda column: memoryview(array.array("l", column)),
        lambda column: torch.tensor(column, dtype=torch.int32),
    ):
        assert_decoded(tuple(make(column) for column in EVENTS))
        assert_decoded([make(T), np.array(X), Y, [bool(p) for p in P]])


# -- single events, objects, nothing ---------------------------------------------------------------


@pytest.mark.parametrize("number", [int, np.uint16, torch.tensor])
def test_single_events(number):
    assert_decoded(tuple(number(value) for value in (60_000, 5, 6, 1)), [[60_000], [5], [6], [1]])
    for polarity, expected in ((True, 1), (-1, 0), (np.bool_(False), 0)):
        assert_decoded([number(5), 1, 2, polarity], [[5], [1], [2], [expected]])


def test_objects_and_named_tuples_name_their_columns():
    for t, p in (("t", "p"), ("ts", "pol"), ("timestamp", "polarity"), ("t", "on")):
        assert_decoded(
            SimpleNamespace(
                **{t: np.array(T), "x": np.array(X), "y": Y, p: [bool(value) for value in P]}
            )
        )
        assert_decoded(SimpleNamespace(**{t: 7, "x": 1, "y": 2, p: True}), [[7], [1], [2], [1]])
    order = namedtuple("Order", "x y p t")
    assert_decoded(order(x=X, y=Y, p=P, t=T))
    assert_decoded(order(x=1, y=2, p=0, t=3), [[3], [1], [2], [0]])
    assert_decoded(namedtuple("Nameless", "a b c d")(T, X, Y, P))


def test_tables_name_their_columns():
    """The columns are in any order, with others beside them."""
    columns = {"polarity": P, "ts": np.array(T), "y": Y, "weight": [0.5] * len(T), "x": X}
    assert_decoded(columns)
    assert_decoded({"t": 7, "x": 1, "y": 2, "p": True}, [[7], [1], [2], [1]])
    for library, make in (
        ("pandas", lambda module: module.DataFrame(columns)),
        ("polars", lambda module: module.DataFrame(columns)),
        ("pyarrow", lambda module: module.table(columns)),
    ):
        try:
            module = importlib.import_module(library)
        except ImportError:  # none of them is needed
            continue
        assert_decoded(make(module))
    assert_decoded(Table("columns", tuple(columns), columns.values()))
    assert_decoded(Table("column_names", tuple(columns), columns.values()))


@pytest.mark.parametrize("unit", ["ns", "us", "D"])
@pytest.mark.parametrize("kind", ["datetime64", "timedelta64"])
def test_times_with_a_unit(kind, unit):
    t = np.array([1, 2, 2, 9], f"{kind}[{unit}]")
    expected = [
        [{"ns": 0, "us": int(n), "D": int(n) * 86_400_000_000}[unit] for n in (1, 2, 2, 9)],
        [1] * 4,
        [2] * 4,
        [1] * 4,
    ]
    assert_decoded((t, [1] * 4, [2] * 4, [1] * 4), expected)
    events = np.zeros(4, [("t", t.dtype), ("x", "u2"), ("y", "u2"), ("p", "?")])
    events["t"] = t
    events["x"] = 1
    events["y"] = 2
    events["p"] = True
    assert_decoded(events, expected)


class Table:
    """A table with pandas' `columns`, or with `column_names` of polars and pyarrow.

    If a name is there twice, its last column is returned.
    """

    def __init__(self, attribute, names, columns):
        setattr(self, attribute, list(names))
        self._columns = dict(zip(names, columns, strict=True))

    def __getitem__(self, name):
        return self._columns[name]


def as_records(t, x, y, p):
    events = np.zeros(len(t), [("t", t.dtype), ("x", "u2"), ("y", "u2"), ("p", "u1")])
    for name, column in zip("txyp", (t, x, y, p), strict=True):
        events[name] = column
    return events


NAMED_FORMS = {  # functions that make a form of four columns
    "a tuple": lambda *columns: columns,
    "a list": lambda *columns: list(columns),
    "lists of scalars": lambda *columns: tuple(list(column) for column in columns),
    "records": as_records,
    "a dict": lambda *columns: dict(zip("txyp", columns, strict=True)),
    "an object": lambda *columns: SimpleNamespace(**dict(zip("txyp", columns, strict=True))),
    "a named tuple": lambda *columns: namedtuple("Events", "t x y p")(*columns),
    "a table with columns": lambda *columns: Table("columns", "txyp", columns),
    "a table with column_names": lambda *columns: Table("column_names", "txyp", columns),
    "an object with .numpy()": lambda *columns: SimpleNamespace(numpy=lambda: as_records(*columns)),
}
MICROSECONDS = {
    "as": Fraction(1, 10**12),
    "fs": Fraction(1, 10**9),
    "ps": Fraction(1, 10**6),
    "ns": Fraction(1, 1000),
    "us": 1,
    "ms": 1000,
    "s": 10**6,
    "m": 60 * 10**6,
    "h": 3600 * 10**6,
    "D": 86400 * 10**6,
    "W": 7 * 86400 * 10**6,
    "1500ns": Fraction(3, 2),
    "2147483647as": Fraction(2147483647, 10**12),
    "30s": 30 * 10**6,
    "7D": 7 * 86400 * 10**6,
}


@pytest.mark.parametrize("form", NAMED_FORMS.values(), ids=NAMED_FORMS)
def test_times_beyond_int64_microseconds_are_named(form):
    """Up to the last time that an event may have, times are exact, rounded down.

    Beyond int64 nothing wraps around.
    """
    decoder = EventDecoder(SENSOR)
    message = r"^`t` must be in \[0, 2\*\*62\) microseconds, got -?\d.* at event 1$"
    for (unit, us), kind in itertools.product(MICROSECONDS.items(), ("datetime64", "timedelta64")):
        last = min((2**62 - 1) // us, 2**63 - 1)
        for n in (last, last // 3, 1):
            t = np.array([0, n], np.int64).view(f"{kind}[{unit}]")
            expected = [[0, math.floor(n * us)], [1, 1], [2, 2], [1, 0]]
            assert (
                decoded(decoder, form(t, np.array([1, 1]), np.array([2, 2]), np.array([1, 0])))
                == expected
            )
        for n in (2**62, 2**63 - 1, -(2**62), 1 - 2**63, (2**64 + 5) // us, -((2**64) // us)):
            if not -(2**63) < n < 2**63 or 0 <= n <= last or -1 <= n * us <= 0:
                continue
            t = np.array([0, n], np.int64).view(f"{kind}[{unit}]")
            with pytest.raises(ValueError, match=message):
                decoder.decode(form(t, np.array([1, 1]), np.array([2, 2]), np.array([1, 0])))


def test_years_and_months():
    """As dates they are exact within the times of events; as durations they have no length."""
    one = np.array([1]), np.array([2]), np.array([1])
    for unit, n, date in (("Y", 50, "2020-01-01"), ("M", 601, "2020-02-01")):
        t = np.array([n], np.int64)
        expected = (np.datetime64(date) - np.datetime64("1970-01-01")) // np.timedelta64(1, "us")
        assert decoded(EventDecoder(SENSOR), (t.view(f"M8[{unit}]"), *one))[0] == [int(expected)]
        with pytest.raises(
            ValueError,
            match=rf"^`t` must be durations of a fixed length, got timedelta64\[{unit}\]",
        ):
            as_events((t.view(f"m8[{unit}]"), *one), SENSOR)
        # the last one is just beyond int64 microseconds
        for far in (2**40, 2**62, -(2**62), {"Y": 292_300, "M": 12 * 292_300}[unit]):
            with pytest.raises(
                ValueError, match=rf"^`t` must be in .*, got {far} {unit} at event 0$"
            ):
                as_events((np.array([far]).view(f"M8[{unit}]"), *one), SENSOR)


def tables_of(names, columns):
    """Tables of every kind that can have a column named twice."""
    yield Table("columns", names, columns)
    yield Table("column_names", names, columns)
    for library, make in (
        ("pandas", lambda module: module.DataFrame(np.array(columns).T, columns=names)),
        ("pyarrow", lambda module: module.table(list(map(module.array, columns)), names=names)),
    ):
        with suppress(ImportError):  # none of them is needed
            yield make(importlib.import_module(library))


@pytest.mark.parametrize("twice", ["t", "x", "y", "p"])
def test_a_column_named_twice_is_an_error(twice, tmp_path):
    """This holds in every form and file that can have one.

    Another column, which is not used, may be there twice.
    """
    names = [*"txyp", twice]
    columns = [[5, 6], [1, 1], [2, 2], [0, 1], [0, 1]]
    rows = zip(*columns, strict=True)
    text = "\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)])
    (tmp_path / "a.csv").write_text(text + "\n")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zipfile warns of a name that is there twice
        for name, column in zip(names, columns, strict=True):
            content = BytesIO()
            np.save(content, np.array(column))
            archive.writestr(f"{name}.npy", content.getvalue())
    message = (
        rf"need one field `{twice}`, got {twice} 2 times|holds the array '{twice}' more than once"
    )
    for table in tables_of(names, columns):
        with pytest.raises(ValueError, match=message):
            as_events(table, SENSOR)
    for file in ("a.csv", "a.npz"):
        with pytest.raises(ValueError, match=rf"{file}: .*({message})"):
            open_recording(tmp_path / file)
    for table in tables_of([*"txyp", "note", "note"], [*columns, columns[0]]):
        assert as_events(table, SENSOR)["t"].tolist() == [5, 6]


@pytest.mark.parametrize("order", ["".join(order) for order in itertools.permutations("txyp")])
def test_plain_arrays_whose_order_is_stated(order):
    """The right order is taken, and a wrong order is refused where it can be seen.

    The message then names the right one.
    """
    columns = dict(zip("txyp", (sorted(T), X, Y, P), strict=True))
    expected = [columns[name] for name in "txyp"]
    for dtype in (np.int64, np.uint32, np.float64):
        table = np.stack([np.array(columns[name], dtype) for name in order], axis=1)
        assert_decoded(event_columns(table, order), expected)
        assert_decoded(event_columns(torch.from_numpy(table), order), expected)
        for wrong in map("".join, itertools.permutations("txyp")):
            if wrong.index("t") == order.index("t") and wrong.index("p") == order.index("p"):
                continue  # x for y cannot be seen
            named = (
                order
                if order.index("x") < order.index("y")
                else order.translate(str.maketrans("xy", "yx"))
            )
            with pytest.raises(
                ValueError, match=f"^the columns are not '{wrong}'; they look like '{named}'$"
            ):
                event_columns(table, wrong)


def test_the_order_of_a_plain_array_with_signed_polarities_can_be_seen():
    signed = [1, -1, -1, 1, 1, -1, 1]
    table = np.stack([X, Y, signed, sorted(T)], axis=1)
    assert_decoded(event_columns(table, "xypt"), [sorted(T), X, Y, [1, 0, 0, 1, 1, 0, 1]])
    with pytest.raises(ValueError, match=r"^the columns are not 'txyp'; they look like 'xypt'$"):
        event_columns(table, "txyp")


def test_unsorted_times_and_small_ones_are_not_taken_for_another_order():
    for t, x in ((T, X), ([3, 5, 9], [30, 20, 33]), ([900, 300, 500], [7, 7, 7]), ([], [])):
        table = np.stack([t, x, x, [1] * len(t)], axis=1)
        assert event_columns(table, "txyp")[0].tolist() == list(t)


def test_plain_arrays_that_are_refused():
    whole = "`t` must be whole numbers, as float64 below 9007199254740992, got"
    for table, order, message in (
        (
            [[1, 2, 3]],
            "txyp",
            r"`table` must be numbers in shape \(N, 4\), got int64 in shape \(1, 3\)",
        ),
        (
            [[1, 2, 3, 1]],
            "txy",
            "`order` must have the letters t, x, y and p, each once, got 'txy'",
        ),
        ([[0.5, 2, 3, 1]], "txyp", f"{whole} 0.5 in row 0; times are microseconds"),
        ([[float("nan"), 2, 3, 1]], "txyp", f"{whole} nan in row 0; times are microseconds"),
        (
            np.float32([[2**24, 2, 3, 1]]),
            "txyp",
            "`t` must be whole numbers, as float32 below 16777216, got 1.*",
        ),
        (
            np.float32([[-(2**24), 2, 3, 1]]),
            "txyp",
            "`t` must be whole numbers, as float32 below 16777216, got -1.*",
        ),
        (
            [["a", "b", "c", "d"]],
            "txyp",
            r"`table` must be numbers in shape \(N, 4\), got <U1 in shape \(1, 4\)",
        ),
    ):
        with pytest.raises(ValueError, match=f"^{message}$"):
            event_columns(table, order)


EMPTY = {
    "an empty dict of columns": {"t": [], "x": [], "y": [], "p": []},
    "None": None,
    "[]": [],
    "four float arrays, as numpy makes them": (np.array([]),) * 4,
    "polarity_events is None": SimpleNamespace(polarity_events=None),
    "empty records": np.zeros(0, EVENT_DTYPE),
}


@pytest.mark.parametrize("late", ["accept", "drop"])
@pytest.mark.parametrize("events", EMPTY.values(), ids=EMPTY)
def test_empty_packets(events, late):
    decoder = EventDecoder(SENSOR, late)
    assert decoded(decoder, events) == [[], [], [], []]
    assert decoded(decoder, ([7], [1], [2], [1])) == [[7], [1], [2], [1]]
    assert decoded(decoder, events) == [[], [], [], []]
    assert (decoder.newest_us, decoder.n_dropped) == ((-1, 0) if late == "accept" else (7, 0))
    assert len(as_events(events, SENSOR)) == 0
