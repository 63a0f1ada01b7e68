"""The decoder agrees with a slow oracle, and raises nothing but ValueError or TypeError.

It is given any record layout, any numbers around the limits, and any Python object.
"""

from collections import namedtuple
from types import SimpleNamespace

import hypothesis.extra.numpy as hnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from async_tnt import EVENT_DTYPE
from async_tnt.volume.event_forms import NAMES, named_columns
from async_tnt.volume.events import EventDecoder, as_events, checked_columns

INTEGERS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
OURS = ("i8", "u2", "u2", "u1")
SENSORS = st.sampled_from(
    [(34, 34), (346, 260), (128, 127), (129, 300), (256, 255), (2**15, 2**15), (2, 2)]
)
LIMITS = [
    0,
    2**62,
    *(sign * 2**bits for bits in (7, 8, 15, 16, 31, 32, 63, 64) for sign in (1, -1)),
]


def oracle(rows, kinds, sensor):
    """What the rules say of these rows (t, x, y, p), in Python's integers. None: refused."""
    allowed = {"t": "iuM", "x": "iu", "y": "iu", "p": "iub"}  # M: dates with a unit
    if any(kind not in allowed[field] for field, kind in kinds.items()):
        return None
    width, height = sensor
    polarities = {p for _, _, _, p in rows}
    if not (polarities <= {0, 1} or polarities <= {-1, 1}):
        return None
    if not all(0 <= t < 2**62 and 0 <= x < width and 0 <= y < height for t, x, y, _ in rows):
        return None
    return [(t, x, y, int(p == 1)) for t, x, y, p in rows]


def rows_of(columns):
    assert all(column.flags.carray for column in columns[:4])
    assert tuple(column.dtype for column in columns[:4]) == OURS
    return list(zip(*(column[: columns.n].tolist() for column in columns[:4]), strict=True))


def outcome(take, *args):
    """The rows that came out, or None if they were refused."""
    try:
        return rows_of(take(*args))
    except (ValueError, TypeError):
        return None


@st.composite
def rows_for(draw, types, sensor, min_size=0):
    """Up to five rows of numbers that their types can hold.

    They are valid, or one field is around the limits.
    """
    trouble = draw(st.sampled_from([*NAMES, None, None, None]))
    columns = []
    for field, number in zip(NAMES, types, strict=True):
        end = {"t": 2**62, "x": sensor[0], "y": sensor[1], "p": 2}[field]
        low, high = (0, 1) if number == "?" else (-(2**65), 2**65)
        if number in INTEGERS:
            low = int(np.iinfo(number).min)
            high = int(np.iinfo(number).max)
        elif number not in ("?", None):
            low = 0
            high = 1000
        valid = (
            st.sampled_from([-1, 1])
            if field == "p" and low < 0
            else st.integers(0, min(end - 1, high))
        )
        around = [
            limit + d for limit in [*LIMITS, end] for d in (-1, 0, 1, 3) if low <= limit + d <= high
        ]
        columns.append(st.one_of(valid, st.sampled_from(around)) if field == trouble else valid)
    return draw(st.lists(st.tuples(*columns), min_size=min_size, max_size=5))


@st.composite
def layouts(draw):
    """A record dtype, and the names of t, x, y, p in it."""
    usual = (("i8", "u8", "u4"), ("u2", "i2"), ("u2", "i2"), ("?", "u1", "i1", "i2"))
    numbers = [draw(st.one_of(st.sampled_from(some), st.sampled_from(INTEGERS))) for some in usual]
    if draw(st.integers(0, 3)) == 0:
        numbers[draw(st.integers(0, 3))] = draw(st.sampled_from(["f8", "?", "S9", "M8[us]"]))
    formats = [
        number if number == "?" else draw(st.sampled_from("<<<>")) + number for number in numbers
    ]
    names = [draw(st.sampled_from(aliases)) for aliases in NAMES.values()]
    order = draw(st.permutations(range(4)))
    offsets = {}
    end = 0
    for k in order:  # fields anywhere in memory, whatever order their names are in
        offsets[k] = end + draw(st.sampled_from([0, 0, 1, 3]))
        end = offsets[k] + np.dtype(formats[k]).itemsize
    fields = {
        "names": names,
        "formats": formats,
        "offsets": [offsets[k] for k in range(4)],
        "itemsize": end + 2,
    }
    return np.dtype(fields), names


@given(st.data(), layouts(), SENSORS)
def test_records_of_any_layout(data, layout, sensor):
    dtype, names = layout
    types = [dtype.fields[name][0].str.lstrip("<>|").replace("b1", "?") for name in names]
    rows = data.draw(rows_for(types, sensor))
    kinds = {field: dtype.fields[name][0].kind for field, name in zip(NAMES, names, strict=True)}
    expected = oracle(rows, kinds, sensor)

    # padding, too
    events = np.full(len(rows) * dtype.itemsize, data.draw(st.integers(0, 255)), np.uint8).view(
        dtype
    )
    for name, column in zip(names, zip(*rows, strict=True), strict=False):
        events[name] = column
    before = events.tobytes()

    decoder = EventDecoder(sensor)
    assert outcome(decoder.decode, events) == expected  # most of them by the fast path
    assert outcome(decoder.decode, events) == expected
    # all by the slow one
    assert outcome(lambda: checked_columns(*named_columns(events), sensor)) == expected
    columns = tuple(events[name] for name in names)
    assert outcome(decoder.decode, columns) == (expected if rows else [])
    if rows:
        assert outcome(decoder.decode, events[-1]) == oracle(rows[-1:], kinds, sensor)
    if expected is not None:
        assert [tuple(row) for row in as_events(events, sensor).tolist()] == expected
    assert events.tobytes() == before


@given(st.data(), SENSORS, st.sampled_from([(None,) * 4, OURS]))
def test_columns_of_any_numbers(data, sensor, types):
    """Numbers come in lists, one by one, and in arrays of the decoder's own types.

    The decoder does not copy such arrays.
    """
    rows = data.draw(rows_for(types, sensor, min_size=1))
    columns = [list(column) for column in zip(*rows, strict=True)]
    decoder = EventDecoder(sensor)
    expected = oracle(rows, dict.fromkeys(NAMES, "i"), sensor)
    assert outcome(decoder.decode, tuple(columns)) == expected
    for row in rows:
        assert outcome(decoder.decode_one, *row) == oracle([row], dict.fromkeys(NAMES, "i"), sensor)
    if types == OURS:
        arrays = tuple(np.array(column, dtype) for column, dtype in zip(columns, OURS, strict=True))
        assert outcome(decoder.decode, arrays) == expected


# -- anything at all -------------------------------------------------------------------------------


def containers(parts):
    fields = st.sampled_from(
        [name for names in NAMES.values() for name in names] + ["polarity_events", "shape"]
    )
    return st.one_of(
        st.lists(parts, max_size=6),
        st.tuples(parts, parts, parts, parts),
        st.builds(namedtuple("Quad", "p y x t"), parts, parts, parts, parts),
        st.dictionaries(fields, parts, max_size=6).map(lambda fields: SimpleNamespace(**fields)),
        parts.map(lambda part: SimpleNamespace(numpy=lambda: part)),
    )


SCALARS = st.one_of(
    st.integers(),
    st.floats(),
    st.text(max_size=4),
    st.sampled_from(
        [None, True, 1j, object(), int, ..., range(4), iter(()), np.float32(1), np.ma.masked]
    ),
)
# two events
COLUMNS = st.sampled_from(
    [[0, 1], (1, 1), [True, False], [-1, 1], np.array([0, 1], ">u2"), [33, 2**62]]
)
RECORDS = st.tuples(*[hnp.scalar_dtypes()] * 4).map(
    lambda types: list(zip("txyp", types, strict=True))
)
ARRAYS = hnp.arrays(
    st.one_of(hnp.scalar_dtypes(), RECORDS, st.just(EVENT_DTYPE)),
    hnp.array_shapes(min_dims=0, max_side=4),
)


@given(st.recursive(st.one_of(COLUMNS, COLUMNS, SCALARS, ARRAYS), containers, max_leaves=10))
def test_anything_at_all(thing):
    decoder = EventDecoder((34, 33), "drop")
    for _ in range(2):
        try:
            columns = decoder.decode(thing)
        except (ValueError, TypeError) as error:
            assert str(error)
            continue
        for t, x, y, p in rows_of(columns):
            assert 0 <= t < 2**62 and 0 <= x < 34 and 0 <= y < 33 and p in (0, 1)
    assert rows_of(decoder.decode(([2**62 - 1], [33], [32], [1]))) == [(2**62 - 1, 33, 32, 1)]
