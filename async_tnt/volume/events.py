"""The decoding of events: any accepted form becomes four checked, contiguous columns.

Numba compiles separately for read-only, strided and unaligned arrays, and compiled code does not
check bounds. So every packet is brought into one form here, once, and refused here if it is
invalid. Nothing is checked again after this.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numba import NumbaError

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.volume.records import (
    BAD,
    KIND,
    MAX_TIME_US,
    check_columns,
    find_late,
    load_records,
)
from async_tnt.volume.event_forms import fields_of_records, named_columns

EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
"""The type in which this package writes events: t in microseconds; x, y in pixels from the top
left; p is 1 for ON, 0 for OFF."""
ANY_SENSOR = (1 << 16, 1 << 16)
"""A sensor with every pixel that uint16 can hold."""

LARGER_CAMERA = "; `PixelFilter` cuts a part out of a larger camera's image"
"""The end of a message about an event beyond the sensor."""

Late = Literal["accept", "drop", "raise"]
LATE_POLICIES = get_args(Late)


class Columns(NamedTuple):
    """Checked events in contiguous columns. Only the first `n` entries of each are valid.

    The columns may be memory of the decoder, which its next call overwrites.
    """

    t: np.ndarray  # int64, microseconds, in [0, 2**62)
    x: np.ndarray  # uint16, in [0, sensor width)
    y: np.ndarray  # uint16, in [0, sensor height)
    p: np.ndarray  # uint8, 0 or 1
    n: int


_T = np.dtype(np.int64)
_XY = np.dtype(np.uint16)
_P = np.dtype(np.uint8)


def empty_columns(n: int) -> Columns:
    """New columns with room for `n` events; none of them is valid yet."""
    return Columns(np.empty(n, _T), np.empty(n, _XY), np.empty(n, _XY), np.empty(n, _P), 0)


# a module's name is found faster than an attribute of NumPy
_ARRAY = np.ndarray
# No other subclasses of arrays are taken, because compiled code would not see the mask of a masked
# array.
_RECORDS = (np.ndarray, np.memmap, np.recarray)
_NO_EVENTS = empty_columns(0)
# It makes the same tuple as Columns(...), without a call of Python code.
_new_tuple = tuple.__new__

FIRST_CAPACITY = 1024
"""Number of events that a decoder has room for, until it gets a larger packet."""


class EventDecoder:
    """Turns packets of one sensor into `Columns`, reusing its memory from packet to packet.

    Parameters
    ----------
    sensor : (width, height) in pixels, at most 2**15 each.
    late : what to do with an event older than the newest event so far: `accept` it, `drop` and
        count it, or `raise`.
    advice : the end of the message about an event beyond the sensor.

    Attributes
    ----------
    first_us : time of the first event of the packet that was decoded last; MAX_TIME_US if that
        packet had no events.
    newest_us : the newest time so far, where `late` is not `accept`.
    n_dropped : how many late events were dropped.
    """

    def __init__(self, sensor: tuple[int, int], late: Late = "accept", advice: str = "") -> None:
        if late not in LATE_POLICIES:
            rule = f"must be one of {', '.join(LATE_POLICIES)}"
            raise ParameterValueError("late", rule, short(late))
        self.sensor = sensor
        self.late: Late = late
        self._prepare()
        self._advice = advice
        self.reset()
        self._scratch = empty_columns(FIRST_CAPACITY)
        # the type of the last records, its names, and its layout as `load_records` reads it
        self._dtype: np.dtype | None = None
        self._names: tuple[str, ...] | None = None
        self._layout: np.ndarray | None = None

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._prepare()  # perhaps in another process

    def _prepare(self) -> None:
        """Compile the kernels, so that no packet waits for that."""
        prepare(load_records, check_columns)
        if self.late != "accept":
            prepare(find_late)

    def reset(self) -> None:
        """Forget the newest time and the count of dropped events."""
        self.first_us = MAX_TIME_US
        self.newest_us = -1
        self.n_dropped = 0

    def decode(self, events: Any, apply_policy: bool = True) -> Columns:
        """The events of a packet as checked columns.

        Parameters
        ----------
        events : a packet in any accepted form.
        apply_policy : whether late events are treated as `late` says. False: the caller calls the
            method `apply_policy` afterwards.

        Returns
        -------
        Columns, valid until the next call.

        Raises
        ------
        ValueError, TypeError : the packet breaks a rule; the message names field, rule, value and
            event. None of its events are used then.
        """
        columns = None
        if type(events) is tuple:
            columns = self._checked_as_they_are(events)
        elif type(events) in _RECORDS:
            columns = self._decode_records(events)
        if columns is None:
            columns = _decode_any(events, self.sensor, self._advice)
            self.first_us = int(columns.t[0]) if columns.n else MAX_TIME_US
        if apply_policy and self.late != "accept":
            return self.apply_policy(columns)
        return columns

    def decode_one(self, t: int, x: int, y: int, p: int, apply_policy: bool = True) -> Columns:
        """Do what `decode` does, for one event. It is quick for Python integers."""
        width, height = self.sensor
        try:
            # `p * 1` makes an integer of a bool
            is_plain = type(t) is type(x) is type(y) is type(p * 1) is int
            is_valid = (
                is_plain
                and 0 <= t < MAX_TIME_US
                and 0 <= x < width
                and 0 <= y < height
                and -1 <= p <= 1
            )
        except TypeError:
            is_valid = False
        if not is_valid or (apply_policy and self.late != "accept"):
            return self.decode(([t], [x], [y], [p]), apply_policy)
        column_t, column_x, column_y, column_p, _ = self._scratch
        column_t[0] = t
        column_x[0] = x
        column_y[0] = y
        column_p[0] = p > 0
        self.first_us = t
        return _new_tuple(Columns, (column_t, column_x, column_y, column_p, 1))

    def _decode_records(self, events: np.ndarray) -> Columns | None:
        """The columns of packed records of whole numbers, by the fast path.

        None if the records need a closer look.
        """
        dtype = events.dtype
        # the names are compared, too: fields can be renamed in place
        if dtype is not self._dtype or dtype.names is not self._names:
            self._dtype = dtype
            self._names = dtype.names
            self._layout = _record_layout(dtype)
        if self._layout is None or events.ndim == 0:
            return None
        n = len(events)
        if n == 0:
            if events.ndim != 1:
                return None
            self.first_us = MAX_TIME_US
            return _NO_EVENTS
        if n > len(self._scratch.t):
            self._scratch = empty_columns(2 * n)
        t, x, y, p, _ = self._scratch
        width, height = self.sensor
        try:
            raw = np.frombuffer(events, np.uint8)
        except ValueError:  # the memory is not contiguous
            return None
        first_us = load_records.call(raw, self._layout, n, width, height, t, x, y, p)
        if first_us == BAD:
            return None
        self.first_us = first_us
        return _new_tuple(Columns, (t, x, y, p, n))

    def _checked_as_they_are(self, events: tuple[Any, ...]) -> Columns | None:
        """Columns that already have the right form, without a copy; None for all others."""
        if len(events) != 4:
            return None
        t, x, y, p = events
        if not (type(t) is type(x) is type(y) is type(p) is _ARRAY):
            return None
        # All four types are compared here. Numba's dispatch should refuse a column of the other
        # byte order, but it once took such a column, an empty one.
        if t.dtype is not _T or x.dtype is not _XY or y.dtype is not _XY or p.dtype is not _P:
            return None
        width, height = self.sensor
        try:
            first_us = check_columns.checked(t, x, y, p, width, height)
        except (TypeError, NumbaError):  # the kernel is not compiled for such an array
            return None
        if first_us == BAD:
            return None
        self.first_us = first_us
        return _new_tuple(Columns, (t, x, y, p, len(t)))

    def apply_policy(self, columns: Columns) -> Columns:
        """Checked columns without their late events, which are counted.

        Raises
        ------
        ValueError : an event is late, and the policy `late` is "raise".
        """
        if not columns.n or self.late == "accept":
            return columns
        t = columns.t[: columns.n]
        is_late = np.empty(t.size, np.bool_)
        n_late, newest_us = find_late.call(t, self.newest_us, is_late)
        if n_late and self.late == "raise":
            i = int(np.argmax(is_late))
            newest = max(self.newest_us, int(t[:i].max(initial=-1)))
            place = f" at event {i}" if t.size > 1 else ""
            raise ValueError(
                f'`t` must not run backwards (late="raise"), got {t[i]} after {newest}{place}; '
                'late="accept" takes such events, late="drop" drops and counts them'
            )
        self.newest_us = newest_us
        self.n_dropped += n_late
        if not n_late:
            return columns
        is_kept = ~is_late
        n = columns.n
        x = columns.x[:n][is_kept]
        y = columns.y[:n][is_kept]
        p = columns.p[:n][is_kept]
        return Columns(t[is_kept], x, y, p, n - n_late)


def _decode_any(events: Any, sensor: tuple[int, int], advice: str = "") -> Columns:
    """Any accepted form of events as checked columns."""
    columns = named_columns(events)
    if columns is None:
        return _NO_EVENTS
    return checked_columns(*columns, sensor, advice)


def checked_columns(
    t: Any, x: Any, y: Any, p: Any, sensor: tuple[int, int], advice: str = ""
) -> Columns:
    """Checked `Columns`, made from four columns of any integer type.

    Parameters
    ----------
    t, x, y, p : columns: arrays, or values that NumPy can make arrays of.
    sensor : (width, height) in pixels.
    advice : the end of the message about an event beyond the sensor.

    Raises
    ------
    ValueError, TypeError : a column is invalid; the message names the first invalid event.
    """
    columns = {"t": np.asarray(t), "x": np.asarray(x), "y": np.asarray(y), "p": np.asarray(p)}
    for field, column in columns.items():
        if column.ndim != 1:
            raise ValueError(f"`{field}` must have one dimension, got shape {column.shape}")
        _check_type(field, column)
    sizes = [column.size for column in columns.values()]
    if len(set(sizes)) != 1:
        raise ValueError(f"t, x, y and p must have equal lengths, got {', '.join(map(str, sizes))}")
    if sizes[0] == 0:
        return _NO_EVENTS

    width, height = sensor
    _check_range("t", columns["t"], MAX_TIME_US, "2**62) microseconds")
    _check_range("x", columns["x"], width, f"{width})", advice)
    _check_range("y", columns["y"], height, f"{height})", advice)
    _check_polarity(columns["p"])

    return Columns(
        _compiled_form(columns["t"], _T),
        _compiled_form(columns["x"], _XY),
        _compiled_form(columns["y"], _XY),
        _compiled_form(columns["p"] == 1, _P),
        sizes[0],
    )


def _compiled_form(column: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """A column in the one form that kernels are compiled for; copied if it has another one."""
    return np.require(column, dtype, ["C_CONTIGUOUS", "ALIGNED", "WRITEABLE"])


def as_events(events: Any, sensor: tuple[int, int]) -> np.ndarray:
    """Any accepted form of events as a new structured array of `EVENT_DTYPE`, checked."""
    columns = _decode_any(events, sensor)
    return structured(columns[:4], columns.n)


def structured(
    columns: Sequence[np.ndarray], n: int | None = None, dtype: np.dtype = EVENT_DTYPE
) -> np.ndarray:
    """A new structured array of the columns t, x, y, p. Nothing is checked.

    n : number of events to take, from the first event on; by default all events.
    """
    events = np.empty(len(columns[0]) if n is None else n, dtype)
    for name, column in zip("txyp", columns, strict=True):
        events[name] = column[:n]
    return events


def _check_type(field: str, column: np.ndarray) -> None:
    """Refuse a column that does not hold whole numbers."""
    kind = column.dtype.kind
    if kind in ("iub" if field == "p" else "iu"):
        return

    # An invalid value has a message of its own, which comes before one about the column's type.
    if kind == "f" and not np.isfinite(column).all():
        i = int(np.argmin(np.isfinite(column)))
        raise ValueError(f"`{field}` must be a whole number, got {column[i]} at event {i}")
    if kind == "O":
        for i, value in enumerate(column):
            if type(value) is int and not -(1 << 63) <= value < 1 << 63:
                raise ValueError(f"`{field}` must fit in int64, got {short(value)} at event {i}")

    got = str(column.dtype)
    if column.size:
        value = column[0]
        is_printed = isinstance(value, (str, np.generic))
        example = str(value)[:40] if is_printed else type(value).__name__
        got += f" ({example} at event 0)"
    if field == "t" and kind in "fmM":
        raise TypeError(
            f"`t` must be integer microseconds, got {got}; its unit is unknown: "
            "convert seconds with np.rint(t * 1e6).astype('int64')"
        )
    raise TypeError(f"`{field}` must be whole numbers, got {got}")


def _check_range(
    field: str, column: np.ndarray, end: int, written_end: str, advice: str = ""
) -> None:
    """Refuse numbers outside of [0, end).

    written_end : the end of the interval and its unit, for the message.
    advice : the end of the message about a number at or above `end`.
    """
    is_outside = column >= end
    if column.dtype.kind == "i":
        is_outside |= column < 0
    if not is_outside.any():
        return
    i = int(np.argmax(is_outside))
    hint = advice if column[i] >= end else ""
    raise ValueError(f"`{field}` must be in [0, {written_end}, got {column[i]} at event {i}{hint}")


def _check_polarity(polarity: np.ndarray) -> None:
    """Raise a ValueError unless all polarities are 0 or 1, or all are -1 or +1."""
    is_off = polarity == 0
    allowed = is_off | (polarity == 1)
    # A column that cannot hold -1 needs no comparison with it.
    if polarity.dtype.kind == "i" and not is_off.any():
        allowed |= polarity == -1
    if allowed.all():
        return
    i = int(np.argmin(allowed))
    mixed = " beside 0 in the same packet" if polarity[i] == -1 else ""
    raise ValueError(f"`p` must be 0 or 1, or -1 or +1, got {polarity[i]}{mixed} at event {i}")


def _record_layout(dtype: np.dtype) -> np.ndarray | None:
    """Offsets and kinds of t, x, y and p, and the size of a record, for `load_records`.

    None if `load_records` cannot read such records.
    """
    names = fields_of_records(dtype)
    if names is None or dtype.fields is None:
        return None
    layout: list[int] = []
    for field, name in zip("txyp", names, strict=True):
        number, offset = dtype.fields[name][:2]
        kind = KIND.get(number.str[1:])
        # the kernel would take a polarity of 2**64 - 1 for -1
        refused_type = "u8" if field == "p" else "b1"
        if kind is None or number.str[0] == ">" or number.str[1:] == refused_type:
            return None
        layout += [offset, kind]
    return np.array([*layout, dtype.itemsize], np.int64)
