"""Every form of events that the field hands around becomes the same four columns."""

import array
from collections import namedtuple
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from async_tnt import events as door_module
from async_tnt.events import EVENT_DTYPE, EventDecoder, as_events
from async_tnt.kernels.records import FINE

SENSOR = (346, 260)
T = [16_777_217, 16_777_219, 16_777_219, 16_777_218, 2_000_000_003, 2_000_000_004, 2_000_000_005]
X = [0, 345, 1, 255, 256, 128, 17]
Y = [259, 0, 1, 255, 256, 127, 33]
P = [1, 0, 0, 1, 1, 0, 1]
SMALL = [[0, 1, 1, 127, 5], [0, 99, 3, 127, 64], [127, 0, 3, 1, 64], [0, 1, 1, 0, 1]]  # fits every integer type
TYPES = (np.int64, np.uint16, np.uint16, np.uint8)

PACKED = {
    "metavision": [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")],
    "faery": [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")],
    "dv": [("timestamp", "<i8"), ("x", "<i2"), ("y", "<i2"), ("polarity", "<i1")],
    "dv, the struct in memory": np.dtype(
        {
            "names": ["timestamp", "x", "y", "polarity"],
            "formats": ["<i8", "<i2", "<i2", "?"],
            "offsets": [0, 8, 10, 12],
            "itemsize": 16,
        }
    ),
    "expelliarmus": [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")],
    "tonic, int64": [("x", "<i8"), ("y", "<i8"), ("t", "<i8"), ("p", "<i8")],
    "tonic, int32": [("x", "<i4"), ("y", "<i4"), ("t", "<i4"), ("p", "<i4")],
    "tonic, int16 and bool": [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "?")],
    "uint32": [("ts", "<u4"), ("x", "<u4"), ("y", "<u4"), ("pol", "<u4")],
    "ours": EVENT_DTYPE,
    "aligned": np.dtype([("p", "u1"), ("x", "<u2"), ("t", "<i8"), ("y", "<u2")], align=True),
    "aligned, with titles": np.dtype(
        [(("column", "x"), "<u2"), (("row", "y"), "<u2"), (("on?", "p"), "i1"), (("us", "t"), "<i8")], align=True
    ),
    "fields out of order": np.dtype(
        {
            "names": ["t", "x", "y", "p"],
            "formats": ["<i8", "<u2", "<u2", "i1"],
            "offsets": [7, 3, 17, 0],
            "itemsize": 23,
        }
    ),
    "more fields": [("id", "S3"), *EVENT_DTYPE.descr, ("wall", "M8[us]"), ("w", "<f4", (2,)), ("note", "U2")],
}
OTHER = {  # only a closer look can tell
    "big-endian": [("t", ">i8"), ("x", ">u2"), ("y", ">u2"), ("p", ">i2")],
    "one field big-endian": [("t", "<i8"), ("x", "<u2"), ("y", ">u2"), ("p", "u1")],
    "uint64 polarity": [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "<u8")],
}
LAYOUTS = PACKED | OTHER


def records(layout, columns=(T, X, Y, P)):
    """A structured array of these columns."""
    events = np.zeros(len(columns[0]), layout)
    for names, column in zip(door_module.NAMES.values(), columns, strict=True):
        events[next(name for name in names if name in events.dtype.names)] = column
    return events


def unaligned(values):
    """The same numbers one byte off."""
    raw = np.zeros(values.nbytes + 1, np.uint8)
    raw[1:] = np.frombuffer(values.tobytes(), np.uint8)
    return raw[1:].view(values.dtype)


def read_only(values):
    values = values.copy()
    values.flags.writeable = False
    return values


def every_second(values):
    wide = np.zeros(2 * len(values), values.dtype)
    wide[::2] = values
    return wide[::2]


def row_in_fortran_order(values):
    return np.asfortranarray(np.stack([values, values]))[1]


STORED = {
    "contiguous": np.copy,
    "read-only": read_only,
    "every second": every_second,
    "backwards": lambda values: values[::-1].copy()[::-1],
    "unaligned": unaligned,
    "read-only, from bytes": lambda values: np.frombuffer(values.tobytes(), values.dtype),
    "in Fortran order": row_in_fortran_order,
    "a slice": lambda values: np.concatenate([values, values, values])[len(values) : 2 * len(values)],
}


def taken(decoder, events):
    """The decoder's columns, as lists; what is promised of their memory is checked on the way."""
    columns = decoder.decode(events)
    for column, dtype in zip(columns[:4], TYPES, strict=True):
        assert column.dtype == dtype
        assert column.flags.carray  # one compiled version of every kernel
        assert column.ndim == 1 and len(column) >= columns.n
    return [column[: columns.n].tolist() for column in columns[:4]]


def as_it_is(values):
    """All there is to an array, with the memory that it is a view of (padding included)."""
    owner = values
    while isinstance(owner.base, np.ndarray):
        owner = owner.base
    return owner.tobytes("A"), str(values.flags), values.dtype, values.shape, values.strides


def assert_taken(events, expected=(T, X, Y, P), *, arrays=()):
    """`events` come out as `expected`, from the decoder and from `as_events`; `arrays` are left as they are."""
    before = [as_it_is(a) for a in arrays]
    decoder = EventDecoder(SENSOR)
    for _ in range(2):
        assert taken(decoder, events) == [list(column) for column in expected]
    packed = as_events(events, SENSOR)
    assert packed.dtype == EVENT_DTYPE
    assert [packed[name].tolist() for name in "txyp"] == [list(column) for column in expected]
    assert [as_it_is(a) for a in arrays] == before


# -- structured arrays -----------------------------------------------------------------------------------


@pytest.mark.parametrize("stored", STORED)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_structured_arrays(layout, stored):
    events = STORED[stored](records(LAYOUTS[layout]))
    assert_taken(events, arrays=[events])


@pytest.mark.parametrize("layout", PACKED)
def test_packed_records_take_the_fast_way(layout, monkeypatch):
    monkeypatch.delattr(door_module, "named_columns")
    events = records(PACKED[layout])
    assert taken(EventDecoder(SENSOR), events) == [T, X, Y, P]
    assert taken(EventDecoder(SENSOR), unaligned(read_only(events))) == [T, X, Y, P]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_memory_mapped_files(layout, tmp_path):
    records(LAYOUTS[layout]).tofile(tmp_path / "events.raw")
    events = np.memmap(tmp_path / "events.raw", LAYOUTS[layout], mode="r")
    assert_taken(events, arrays=[events])
    names = [next(name for name in names if name in events.dtype.names) for names in door_module.NAMES.values()]
    columns = tuple(events[name] for name in names)
    assert all(isinstance(column, np.memmap) for column in columns)
    assert_taken(columns, arrays=columns)


def test_record_arrays_and_fields_that_hold_objects():
    assert_taken(records(EVENT_DTYPE).view(np.recarray))
    events = records([*EVENT_DTYPE.descr, ("note", "O")])
    events["note"] = [None, {}, "a", 1, [], (), object]
    assert_taken(events)


def test_one_record_repeated_without_memory():
    events = np.broadcast_to(records(EVENT_DTYPE)[1], (4,))
    assert_taken(events, [[T[1]] * 4, [X[1]] * 4, [Y[1]] * 4, [P[1]] * 4], arrays=[events])


@pytest.mark.parametrize("t", ["t", "ts", "timestamp"])
@pytest.mark.parametrize("p", ["p", "on", "polarity", "pol"])
def test_field_names(t, p):
    events = np.zeros(1, [(p, "i1"), ("y", "<u2"), (t, "<i8"), ("x", "<u2")])
    events[0] = (1, 2, 3, 4)
    assert_taken(events, [[3], [4], [2], [1]])


def test_one_door_takes_any_form_after_any_other():
    decoder = EventDecoder(SENSOR)
    for _ in range(2):
        for layout in LAYOUTS.values():
            assert taken(decoder, records(layout)) == [T, X, Y, P]
            assert taken(decoder, records(layout)[2:3]) == [T[2:3], X[2:3], Y[2:3], P[2:3]]
            assert taken(decoder, (T, X, Y, P)) == [T, X, Y, P]
            assert taken(decoder, None) == [[], [], [], []]


@pytest.mark.parametrize("sizes", [(1, 1023, 1024, 1025, 2, 5000, 1), (3000, 0, 3001, 1)])
def test_packets_of_growing_and_shrinking_size(sizes):
    decoder = EventDecoder(SENSOR)
    rng = np.random.default_rng(0)
    for n in sizes:
        columns = [rng.integers(0, 2**62, n), rng.integers(0, 346, n), rng.integers(0, 260, n), rng.integers(0, 2, n)]
        assert taken(decoder, records(PACKED["metavision"], columns)) == [column.tolist() for column in columns]


def test_fields_renamed_in_place_between_packets():
    events = np.array([(5, 1, 2, 1)], EVENT_DTYPE.descr)
    decoder = EventDecoder(SENSOR)
    assert taken(decoder, events) == [[5], [1], [2], [1]]
    events.dtype.names = ("t", "y", "x", "p")  # the same dtype object with another meaning
    assert taken(decoder, events) == [[5], [2], [1], [1]]


# -- polarity --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", ["i1", "i2", "i4", "i8", ">i2", ">i4", ">i8"])
@pytest.mark.parametrize("form", ["records", "columns"])
def test_signed_polarity(number, form):
    signed = np.array([1, -1, -1, 1, 1, -1, 1], number)
    if form == "records":
        assert_taken(records([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", number)], (T, X, Y, signed)))
    assert_taken((T, X, Y, signed), arrays=[signed])


@pytest.mark.parametrize(
    ("polarity", "expected"),
    [([1, 1], [1, 1]), ([-1, -1], [0, 0]), ([0, 0], [0, 0]), ([True, False], [1, 0]), ([-1, 1], [0, 1])],
)
@pytest.mark.parametrize("number", ["i1", "i8", None])
def test_polarity_of_one_kind_only(polarity, expected, number):
    t, x, y = [1, 2], [3, 4], [5, 6]
    if number is None:
        assert_taken((t, x, y, polarity), (t, x, y, expected))
    else:
        layout = [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", number)]
        assert_taken(records(layout, (t, x, y, polarity)), (t, x, y, expected))


def test_one_packet_may_say_minus_one_and_the_next_zero():
    decoder = EventDecoder(SENSOR)
    assert taken(decoder, ([1, 2], [0, 0], [0, 0], [-1, 1]))[3] == [0, 1]
    assert taken(decoder, ([1, 2], [0, 0], [0, 0], [0, 1]))[3] == [0, 1]


# -- columns ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("stored", STORED)
def test_tuples_of_columns_of_every_integer_type(number, order, stored):
    columns = tuple(STORED[stored](np.array(column, order + number)) for column in SMALL)
    assert_taken(columns, SMALL, arrays=columns)
    assert_taken(list(columns), SMALL, arrays=columns)


@pytest.mark.parametrize("stored", STORED)
def test_columns_of_the_right_types(stored):
    columns = tuple(STORED[stored](np.array(c, dtype)) for c, dtype in zip((T, X, Y, P), TYPES, strict=True))
    assert_taken(columns, arrays=columns)


def test_columns_of_the_right_form_are_not_copied():
    columns = tuple(np.array(c, dtype) for c, dtype in zip((T, X, Y, P), TYPES, strict=True))
    for came, went in zip(columns, EventDecoder(SENSOR).decode(columns)[:4], strict=True):
        assert came is went


@pytest.mark.parametrize(
    "make",
    [
        list,
        tuple,
        lambda column: [np.int32(value) for value in column],
        lambda column: array.array("q", column),
        lambda column: memoryview(array.array("l", column)),
        lambda column: torch.tensor(column),
        lambda column: torch.tensor(column, dtype=torch.int32),
        lambda column: torch.tensor([column, column]).T[:, 0],  # strided
    ],
    ids=["list", "tuple", "numpy numbers", "array.array", "memoryview", "tensor", "int32 tensor", "strided tensor"],
)
def test_columns_that_are_not_arrays(make):
    assert_taken((make(T), make(X), make(Y), make(P)))
    assert_taken([make(T), np.array(X), tuple(Y), [bool(p) for p in P]])


def test_columns_of_a_table_in_either_order():
    for order in "CF":
        table = np.array([T, X, Y, P], order=order)
        assert_taken(tuple(table), arrays=[table])
        assert_taken(tuple(np.array(table.T, order=order).T), arrays=[table])


def test_limits_of_time():
    last = 2**62 - 1
    for number in ("<i8", "<u8", ">i8", ">u8"):
        assert_taken(
            records([("t", number), *EVENT_DTYPE.descr[1:]], ([0, last], [0, 0], [0, 0], [0, 0])),
            ([0, last], [0, 0], [0, 0], [0, 0]),
        )
        assert_taken((np.array([0, last], number), [0, 0], [0, 0], [0, 0]), ([0, last], [0, 0], [0, 0], [0, 0]))


# -- one event -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", LAYOUTS)
def test_single_records(layout):
    events = records(LAYOUTS[layout])
    for i, event in enumerate(events):
        assert isinstance(event, np.void)
        assert_taken(event, ([T[i]], [X[i]], [Y[i]], [P[i]]))
    assert_taken(events[1:2].reshape(()), ([T[1]], [X[1]], [Y[1]], [P[1]]))


@pytest.mark.parametrize("number", [int, np.int64, np.uint16, np.array, torch.tensor])
def test_single_events_of_plain_numbers(number):
    event = (number(60_000), number(5), number(6), number(1))
    assert_taken(event, ([60_000], [5], [6], [1]))
    assert_taken(list(event), ([60_000], [5], [6], [1]))


def test_single_event_with_a_polarity_of_its_own():
    for polarity, expected in ((True, 1), (False, 0), (-1, 0), (np.bool_(True), 1), (np.int8(-1), 0)):
        assert_taken((5, 1, 2, polarity), ([5], [1], [2], [expected]))


# -- objects ---------------------------------------------------------------------------------------------


@dataclass
class Event:
    timestamp: int
    x: int
    y: int
    polarity: bool


class Store:
    """An event store, such as dv-processing's: an object with `.numpy()`."""

    def __init__(self, events):
        self.events = events

    def numpy(self):
        return self.events


@pytest.mark.parametrize(("t", "p"), [("t", "p"), ("ts", "pol"), ("timestamp", "polarity"), ("t", "on")])
def test_objects_with_columns(t, p):
    assert_taken(SimpleNamespace(**{t: np.array(T), "x": np.array(X), "y": np.array(Y), p: np.array(P)}))
    assert_taken(SimpleNamespace(**{t: T, "x": X, "y": Y, p: [bool(value) for value in P], "width": 346}))


def test_objects_with_one_event():
    assert_taken(Event(timestamp=7, x=1, y=2, polarity=True), ([7], [1], [2], [1]))


def test_named_tuples_say_which_column_is_which():
    order = namedtuple("Order", "x y p t")
    assert_taken(order(x=X, y=Y, p=P, t=T))
    assert_taken(order(x=1, y=2, p=0, t=3), ([3], [1], [2], [0]))
    nameless = namedtuple("Nameless", "a b c d")
    assert_taken(nameless(T, X, Y, P))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_objects_that_hold_events(layout):
    events = records(LAYOUTS[layout])
    assert_taken(SimpleNamespace(polarity_events=events), arrays=[events])
    assert_taken(Store(events), arrays=[events])
    assert_taken(SimpleNamespace(polarity_events=Store(events)))
    assert_taken(Store((T, X, Y, P)))


# -- nothing ---------------------------------------------------------------------------------------------

EMPTY = {
    "None": None,
    "()": (),
    "[]": [],
    "an empty plain array": np.array([]),
    "an empty table": np.zeros((0, 4)),
    "four lists": ([], [], [], []),
    "four lists in a list": [[], [], [], []],
    "four float arrays, as numpy makes them": (np.array([]),) * 4,
    "four columns": tuple(np.zeros(0, dtype) for dtype in TYPES),
    "four tensors": (torch.tensor([]),) * 4,
    "polarity_events is None": SimpleNamespace(polarity_events=None),
    "polarity_events is empty": SimpleNamespace(polarity_events=np.zeros(0, EVENT_DTYPE)),
    "an empty store": Store(np.zeros(0, PACKED["dv"])),
    "an empty tensor": torch.tensor([]),
    "an object with empty columns": SimpleNamespace(t=[], x=[], y=[], p=[]),
    "an empty strided array": np.zeros(4, EVENT_DTYPE)[4::2],
    **{f"empty {name}": np.zeros(0, layout) for name, layout in LAYOUTS.items()},
}


@pytest.mark.parametrize("form", EMPTY)
@pytest.mark.parametrize("late", ["accept", "drop", "raise"])
def test_empty_packets(form, late):
    decoder = EventDecoder(SENSOR, late)
    for _ in range(2):
        assert taken(decoder, EMPTY[form]) == [[], [], [], []]
    assert taken(decoder, (T[:1], X[:1], Y[:1], P[:1])) == [T[:1], X[:1], Y[:1], P[:1]]
    assert taken(decoder, EMPTY[form]) == [[], [], [], []]
    assert (decoder.newest_us, decoder.n_dropped) == ((-1, 0) if late == "accept" else (T[0], 0))
    assert len(as_events(EMPTY[form], SENSOR)) == 0


@pytest.mark.parametrize("swapped", range(3))
@pytest.mark.parametrize("rows", [[], [(5, 3, 2, 1)]])
def test_columns_of_the_other_byte_order_are_turned_whatever_numba_takes_them_for(monkeypatch, swapped, rows):
    decoder = EventDecoder((34, 34))
    monkeypatch.setattr(door_module, "check_columns", lambda *columns: FINE)  # as if all had the right form
    columns = [np.array([row[k] for row in rows], dtype) for k, dtype in enumerate(("<i8", "<u2", "<u2", "u1"))]
    columns[swapped] = columns[swapped].astype(columns[swapped].dtype.newbyteorder(">"))
    taken = decoder.decode(tuple(columns))
    assert [column.dtype.str for column in taken[:4]] == ["<i8", "<u2", "<u2", "|u1"]
    assert list(zip(*(column[: taken.n].tolist() for column in taken[:4]), strict=True)) == rows
