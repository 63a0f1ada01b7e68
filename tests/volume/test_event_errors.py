"""An invalid packet is refused with a message, and nothing has changed then.

The message names field, rule, value and event.
"""

import re
from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from made import random_model, thesis_model

from async_tnt import EVENT_DTYPE, Processor, TNTConfig, TNTVolume
from async_tnt.networks.models.compiled import CompiledClassifier
from async_tnt.simulation.simulator import simulate
from async_tnt.sources.pixels.pixel_filter import PixelFilter
from async_tnt.volume.events import EventDecoder, as_events

SENSOR = (346, 260)
CONFIG = TNTConfig(sensor=SENSOR, grid=(20, 16), bins=3)
T = [10, 11, 11, 12, 13]
X = [0, 345, 1, 2, 3]
Y = [259, 0, 1, 2, 3]
P = [1, 1, 1, 1, 1]


def packet(**changes):
    """A valid packet of five events as columns, but for these fields."""
    columns = {
        field: np.array(c, EVENT_DTYPE[field])
        for field, c in zip("txyp", (T, X, Y, P), strict=True)
    }
    return columns | {field: np.asarray(column) for field, column in changes.items()}


def as_records(columns):
    events = np.zeros(5, [(field, column.dtype) for field, column in columns.items()])
    for field, column in columns.items():
        events[field] = column
    return events


FORMS = {
    "records": as_records,
    "big-endian records": lambda columns: as_records(columns).astype(
        as_records(columns).dtype.newbyteorder(">")
    ),
    "columns": lambda columns: tuple(columns.values()),
    "lists": lambda columns: tuple(column.tolist() for column in columns.values()),
    "object": lambda columns: SimpleNamespace(**columns),
}


def assert_refused(events, error, message, advice=""):
    """Check that a packet is refused with exactly this message.

    It is the same if the decoder, which adds advice, knows the layout. Packet and decoder are
    as before.
    """
    decoder = EventDecoder(SENSOR, "drop", LARGER_CAMERA)
    decoder.decode((T, X, Y, P))
    arrays = [
        a for a in (events if isinstance(events, tuple) else (events,)) if type(a) is np.ndarray
    ]
    before = [a.tobytes() for a in arrays]
    for _ in range(2):
        with pytest.raises(error) as refused:
            decoder.decode(events)
        assert str(refused.value) == message + advice
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        as_events(events, SENSOR)
    assert [a.tobytes() for a in arrays] == before
    assert (decoder.newest_us, decoder.n_dropped) == (13, 0)


# -- numbers that break a rule ---------------------------------------------------------------------

RULES = {
    "t": "`t` must be in [0, 2**62) microseconds",
    "x": "`x` must be in [0, 346)",
    "y": "`y` must be in [0, 260)",
    "p": "`p` must be 0 or 1, or -1 or +1",
}
LARGER_CAMERA = "; `PixelFilter` cuts a part out of a larger camera's image"
OUT_OF_RANGE = [
    ("t", "<i8", [-1, 2**62]),
    ("t", "<u8", [2**64 - 1]),
    ("x", "<u2", [346]),
    ("x", "<i4", [346, -1, 65536 + 3]),  # 3 in 16 bits
    ("y", "<i2", [260, -1]),
    ("p", "u1", [2, 255]),
    ("p", "<u2", [2, 256, 65535]),
    ("p", "<i2", [2, 255, 256, -2, -255]),  # 255 is -1 in one byte
    ("p", "<u8", [2, 2**64 - 1]),  # 2**64 - 1 is not -1
]


@pytest.mark.parametrize(("field", "number", "values"), OUT_OF_RANGE)
def test_numbers_out_of_range(field, number, values):
    """Through the compiled checks of records and of columns, and NumPy's."""
    for value in values:
        columns = packet()
        columns[field] = columns[field].astype(number)
        columns[field][3] = value
        off = field in "xy" and value > 0
        advice = LARGER_CAMERA if off else ""
        for form in ("records", "columns"):
            assert_refused(
                FORMS[form](columns), ValueError, f"{RULES[field]}, got {value} at event 3", advice
            )


@pytest.mark.parametrize("form", FORMS)
def test_the_first_fault_is_named_in_every_form_wherever_it_is(form):
    for field, rule in RULES.items():
        for i in (0, 2, 4):
            column = packet()[field].astype("<i4")
            column[i:] = -5
            assert_refused(
                FORMS[form](packet(**{field: column})), ValueError, f"{rule}, got -5 at event {i}"
            )
    two_fields = packet(y=[0, 260, 0, 0, 0], t=[0, 0, 0, 0, -1])
    assert_refused(FORMS[form](two_fields), ValueError, f"{RULES['t']}, got -1 at event 4")
    mixed = f"{RULES['p']}, got -1 beside 0 in the same packet at event 4"
    assert_refused(FORMS[form](packet(p=[1, 0, 1, 1, -1])), ValueError, mixed)
    assert_refused(
        FORMS[form](packet(p=[1, 2, 1, -1, 0])), ValueError, f"{RULES['p']}, got 2 at event 1"
    )


NO_UNIT = (
    "`t` must be integer microseconds, got {} at event 0); its unit is unknown: "
    "convert seconds with np.rint(t * 1e6).astype('int64')"
)
NOT_WHOLE = [
    ("t", [0.5, 1, 2, 3, 4], TypeError, NO_UNIT.format("float64 (0.5")),
    ("t", np.zeros(5, "m8"), TypeError, NO_UNIT.format("timedelta64 (0 generic time units")),
    (
        "x",
        ["a" * 99] * 5,
        TypeError,
        f"`x` must be whole numbers, got <U99 ({'a' * 40} at event 0)",
    ),
    ("x", [True] * 5, TypeError, "`x` must be whole numbers, got bool (True at event 0)"),
    ("y", [None] * 5, TypeError, "`y` must be whole numbers, got object (NoneType at event 0)"),
    ("x", [0, 1, 2, np.inf, 4], ValueError, "`x` must be a whole number, got inf at event 3"),
    (
        "y",
        np.array([1, 2, 3, 4, -(2**70)], object),
        ValueError,
        f"`y` must fit in int64, got {-(2**70)} at event 4",
    ),
]


@pytest.mark.parametrize(("field", "column", "error", "message"), NOT_WHOLE)
def test_columns_of_other_than_whole_numbers(field, column, error, message):
    for form in ("records", "columns"):
        assert_refused(FORMS[form](packet(**{field: column})), error, message)


# -- forms that are not events ---------------------------------------------------------------------


class Broken:
    def __array__(self, dtype=None, copy=None):
        raise KeyError("no such chunk")


ENDLESS = SimpleNamespace()
ENDLESS.polarity_events = ENDLESS
ENDLESS_TENSOR = SimpleNamespace()
ENDLESS_TENSOR.numpy = lambda: ENDLESS_TENSOR
WITH_GRADIENT = torch.zeros(3, requires_grad=True)

NO_EVENTS = (
    "events must be a structured array with fields t|ts|timestamp, x, y, p|on|polarity|pol, a dict "
    "or table of such "
    "columns, a tuple of four columns (t, x, y, p), or an object with .t .x .y .p, "
    ".polarity_events or .numpy(); got "
)
ORDER = "; async_tnt.event_columns(array, order) says what its columns are"
FOUR = "a tuple of events must hold four columns (t, x, y, p), got "
EQUAL = "t, x, y and p must have equal lengths, got "
MISSING = "events need a field `{}` (one of {}), got {}"
TWICE = "events need one field `{}`, got {} in {}; leave out all but one"
SINGLES = (
    "a list of single events ({} at event 0) is not a packet: pass it to `stream`, event by "
    "event, or push four columns (t, x, y, p)"
)
Timeless = namedtuple("Timeless", "x y p when")
WRONG_FORMS = [
    (np.zeros((5, 4)), TypeError, NO_EVENTS + f"a plain array of shape (5, 4){ORDER}"),
    (np.zeros((5, 3)), TypeError, NO_EVENTS + "a plain array of shape (5, 3)"),
    (np.zeros(4), TypeError, NO_EVENTS + "a plain array of shape (4,)"),
    # columns with names, but no way to read one
    (SimpleNamespace(columns=["t", "x", "y", "p"]), TypeError, NO_EVENTS + "SimpleNamespace"),
    (
        {"t": T, "x": X, "y": Y},
        ValueError,
        MISSING.format("p", "p, on, polarity, pol", "a dict with columns t, x, y"),
    ),
    (
        (np.array([1, "NaT"] * 2, "M8[us]"), X, Y, P),
        ValueError,
        "`t` must be a time, got NaT at event 1",
    ),
    ("t,x,y,p", TypeError, NO_EVENTS + "str"),
    (ENDLESS, TypeError, NO_EVENTS + "SimpleNamespace"),
    (ENDLESS_TENSOR, TypeError, NO_EVENTS + "SimpleNamespace"),
    (
        WITH_GRADIENT,
        TypeError,
        "Tensor.numpy() failed: Can't call numpy() on Tensor that requires grad. "
        "Use tensor.detach().numpy() instead.",
    ),
    ((T, X, Y), ValueError, FOUR + "3"),
    (((5, 1, 2, 0),) * 3, ValueError, FOUR + "3"),
    (
        Timeless(X, Y, P, T),
        ValueError,
        MISSING.format("t", "t, ts, timestamp", "a Timeless with attributes x, y, p"),
    ),
    (
        np.zeros(0, [("t", "<i8"), ("y", "<u2"), ("p", "u1")]),
        ValueError,
        MISSING.format("x", "x", "a structured array with fields t, y, p"),
    ),
    (
        SimpleNamespace(t=T, x=X, y=Y, p=P, on=P),
        ValueError,
        TWICE.format("p", "p and on", "a SimpleNamespace with attributes t, x, y, p, on"),
    ),
    ((T, X[:4], Y, P), ValueError, EQUAL + "5, 4, 5, 5"),
    (np.zeros((2, 3), EVENT_DTYPE), ValueError, "`t` must have one dimension, got shape (2, 3)"),
    (np.zeros((0, 3), EVENT_DTYPE), ValueError, "`t` must have one dimension, got shape (0, 3)"),
    ((T, Broken(), Y, P), ValueError, "`x` must be a column of whole numbers: 'no such chunk'"),
    (list(np.zeros(4, EVENT_DTYPE)), TypeError, SINGLES.format("void")),
    ([dict(t=1, x=2, y=3, p=1)] * 4, TypeError, SINGLES.format("dict")),
    *[([(5, 1, 2, 0)] * n, TypeError, SINGLES.format("tuple")) for n in (1, 3, 5)],
]


@pytest.mark.parametrize(("events", "error", "message"), WRONG_FORMS)
def test_events_of_a_wrong_form(events, error, message):
    assert_refused(events, error, message)


@pytest.mark.parametrize("numbers", [(5,), (5, 1, 2), (5, 1, 2, 1, 0)])
def test_integers_that_are_no_event_are_refused_as_columns(numbers):
    """Four of them are a single event."""
    processor = Processor(CONFIG, classifier=lambda volume: volume.sum((1, 2)))
    assert processor.push((5, 1, 2, 1)) == []
    with pytest.raises(ValueError, match=re.escape(f"{FOUR}{len(numbers)}")):
        processor.push(numbers)


# -- single events ---------------------------------------------------------------------------------

ONE = [
    ((2**64, 0, 0, 1), ValueError, f"`t` must fit in int64, got {2**64} at event 0"),
    ((2**62, 0, 0, 1), ValueError, f"{RULES['t']}, got {2**62} at event 0"),
    ((-1, 0, 0, 1), ValueError, f"{RULES['t']}, got -1 at event 0"),
    ((5, 346, 0, 1), ValueError, f"{RULES['x']}, got 346 at event 0{LARGER_CAMERA}"),
    ((5, -1, 0, 1), ValueError, f"{RULES['x']}, got -1 at event 0"),
    ((5, 0, 260, 1), ValueError, f"{RULES['y']}, got 260 at event 0{LARGER_CAMERA}"),
    ((5, 0, -1, 1), ValueError, f"{RULES['y']}, got -1 at event 0"),
    ((5, 0, 0, 2), ValueError, f"{RULES['p']}, got 2 at event 0"),
    ((5, 0, 0, -2), ValueError, f"{RULES['p']}, got -2 at event 0"),
    ((5.0, 0, 0, 1), TypeError, NO_UNIT.format("float64 (5.0")),
    ((5, 0, 0, None), TypeError, "`p` must be whole numbers, got object (NoneType at event 0)"),
]


@pytest.mark.parametrize(("event", "error", "message"), ONE)
def test_single_events(event, error, message):
    """Before the first event and after it; the open window stays open."""
    volume = TNTVolume(CONFIG)
    processor = Processor(CONFIG, classifier=lambda volume: volume.sum((1, 2)))
    for take in (
        EventDecoder(SENSOR, advice=LARGER_CAMERA).decode_one,
        volume.update_one,
        processor.push_one,
    ):
        for _ in range(2):
            with pytest.raises(error, match=f"^{re.escape(message)}$"):
                take(*event)
            take(14, 4, 4, 1)
    assert volume.n_events == processor.counts.received == processor.fire().events == 2


# -- masked arrays ---------------------------------------------------------------------------------


def test_no_mask_of_events_is_ignored():
    masked = np.ma.array(as_records(packet()), mask=[0, 1, 0, 0, 0])
    for name, events in (
        ("t", tuple(masked[field] for field in "txyp")),
        ("p", (T, X, Y, np.ma.array(P))),  # one that masks nothing
        ("y", (5, 1, np.ma.masked, 1)),
        ("events", masked),
        ("events", SimpleNamespace(numpy=lambda: masked)),
    ):
        advice = "pass `.compressed()` of each column, or `.data` to use every event"
        message = f"`{name}` must not be a masked array, whose mask would be ignored; {advice}"
        assert_refused(events, TypeError, message)


def test_no_mask_of_any_other_array_is_ignored():
    model = random_model()
    for name, take, shape in (
        (
            "fc2.bias",
            lambda bias: thesis_model(
                model.config, model.weights | {"fc2.bias": bias}, model.classes
            ),
            10,
        ),
        ("volume", CompiledClassifier(model), model.config.shape),
        ("mask", lambda mask: PixelFilter((34, 34), mask=mask), (34, 34)),
        (
            "log_frames",
            lambda frames: simulate(frames, [0, 1], np.random.default_rng(0)),
            (2, 3, 3),
        ),
    ):
        with pytest.raises(
            TypeError,
            match=rf"^`{name}` must not be a masked array, .*; pass `\.filled\(value\)`, or",
        ):
            take(np.ma.masked_all(shape))
