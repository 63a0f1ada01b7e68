"""Decoding: events in any accepted form become four checked, contiguous columns.

Nothing is checked again after this. Numba compiles separately for read-only, strided and unaligned
arrays and never checks bounds, so packets are brought into one form here, once, and rejected here
if they are invalid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numba import NumbaError

from async_tnt.base.checks import short
from async_tnt.kernels.jit import compile_only
from async_tnt.kernels.volume.records import (
    BAD,
    CHECK_TYPES,
    KIND,
    LOAD_TYPES,
    MAX_TIME_US,
    check_columns,
    find_late,
    load_records,
)
from async_tnt.volume.event_forms import NAMES, named_columns

EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
"""How this package writes events: t in microseconds, x, y in pixels from the top left, p 1 = ON, 0
= OFF."""
ANY_SENSOR = (1 << 16, 1 << 16)
"""Every pixel that uint16 can hold."""

LARGER_CAMERA = "; `PixelFilter` cuts a part out of a larger camera's image"
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


def empty_columns(n: int) -> Columns:
    """Room for n events, none of them set."""
    t, x, y, p = (np.empty(n, dtype) for dtype in _DTYPES)
    return Columns(t, x, y, p, 0)


_T, _XY, _P = map(np.dtype, (np.int64, np.uint16, np.uint8))
_DTYPES = (_T, _XY, _XY, _P)
_ARRAY = np.ndarray
# no other subclass: compiled code would not see a mask
_RECORDS = (np.ndarray, np.memmap, np.recarray)
_NO_EVENTS = empty_columns(0)
_new_tuple = tuple.__new__  # what Columns(...) does, without a call of Python code


class EventDecoder:
    """Turns packets of one sensor into `Columns`, reusing its memory from packet to packet.

    Parameters
    ----------
    sensor : (width, height) in pixels, 2**15 at most.
    late : what to do with an event older than the newest seen: `accept` it, `drop` and count it, or
        `raise`.
    advice : ends the message about an event beyond the sensor.

    Attributes
    ----------
    first_us : time of the first event of the packet that was decoded last; MAX_TIME_US if it had
        none.
    newest_us, n_dropped : the newest time, and how many events were dropped, under another policy
        than `accept`.
    """

    def __init__(self, sensor: tuple[int, int], late: Late = "accept", advice: str = "") -> None:
        if late not in LATE_POLICIES:
            raise ValueError(f"`late` must be one of {', '.join(LATE_POLICIES)}, got {short(late)}")
        _compile()
        self.sensor = sensor
        self.late, self._advice = late, advice
        self.reset()
        self._scratch = empty_columns(1024)
        self._dtype: np.dtype | None = None
        self._names: tuple[str, ...] | None = None
        self._layout: np.ndarray | None = None

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        _compile()  # perhaps in another process

    def reset(self) -> None:
        """Forget the newest time and the count of dropped events."""
        self.first_us = MAX_TIME_US
        self.newest_us = -1
        self.n_dropped = 0

    def decode(self, events: Any, apply_policy: bool = True) -> Columns:
        """Check a packet.

        Parameters
        ----------
        events : in any accepted form.
        apply_policy : treat late events as `late` says; else leave that to `apply_policy`.

        Returns
        -------
        Columns, valid until the next call.

        Raises
        ------
        ValueError, TypeError : the packet breaks a rule; the message names field, rule, value and
            event. Then none of its events are used.
        """
        columns = None
        if type(events) is tuple:
            columns = self._checked_as_they_are(events)
        elif type(events) in _RECORDS:
            columns = self._decode_records(events)
        if columns is None:
            columns = _decode_any(events, self.sensor, self._advice)
            self.first_us = int(columns.t[0]) if columns.n else MAX_TIME_US
        return self.apply_policy(columns) if apply_policy and self.late != "accept" else columns

    def decode_one(self, t: int, x: int, y: int, p: int, apply_policy: bool = True) -> Columns:
        """`decode` for one event; quick for Python integers."""
        width, height = self.sensor
        try:
            is_plain = type(t) is type(x) is type(y) is type(p * 1) is int
            valid = (
                is_plain
                and 0 <= t < MAX_TIME_US
                and 0 <= x < width
                and 0 <= y < height
                and -1 <= p <= 1
            )
        except TypeError:
            valid = False
        if not valid or (apply_policy and self.late != "accept"):
            return self.decode(([t], [x], [y], [p]), apply_policy)
        column_t, column_x, column_y, column_p, _ = self._scratch
        column_t[0], column_x[0], column_y[0], column_p[0] = t, x, y, p > 0
        self.first_us = t
        return _new_tuple(Columns, (column_t, column_x, column_y, column_p, 1))

    def _decode_records(self, events: np.ndarray) -> Columns | None:
        """Packed records of whole numbers, by the fast path; None if they need a closer look."""
        dtype = events.dtype
        # fields can be renamed in place
        if dtype is not self._dtype or dtype.names is not self._names:
            self._dtype, self._names = dtype, dtype.names
            self._layout = _record_layout(dtype)
        if self._layout is None or events.ndim == 0:
            return None
        n = len(events)
        if n == 0 and events.ndim == 1:
            self.first_us = MAX_TIME_US
            return _NO_EVENTS
        if n == 0:
            return None
        if n > len(self._scratch.t):
            self._scratch = empty_columns(2 * n)
        t, x, y, p, _ = self._scratch
        width, height = self.sensor
        try:
            raw = np.frombuffer(events, np.uint8)
        except ValueError:  # not contiguous
            return None
        first_us = load_records(raw, self._layout, n, width, height, t, x, y, p)
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
        # all four: Numba's dispatch should refuse the other byte order, but once took an empty
        # column of it
        if t.dtype is not _T or x.dtype is not _XY or y.dtype is not _XY or p.dtype is not _P:
            return None
        width, height = self.sensor
        try:
            first_us = check_columns(t, x, y, p, width, height)
        except (TypeError, NumbaError):  # not one-dimensional, contiguous, aligned, writeable
            return None
        if first_us == BAD:
            return None
        self.first_us = first_us
        return _new_tuple(Columns, (t, x, y, p, len(t)))

    def apply_policy(self, columns: Columns) -> Columns:
        """Checked columns without late events, which are counted; with `raise`, a ValueError at the
        first one."""
        if not columns.n or self.late == "accept":
            return columns
        t = columns.t[: columns.n]
        late = np.empty(t.size, np.bool_)
        n_late, newest_us = find_late(t, self.newest_us, late)
        if n_late and self.late == "raise":
            i = int(np.argmax(late))
            newest = max(self.newest_us, int(t[:i].max(initial=-1)))
            at = f" at event {i}" if t.size > 1 else ""
            raise ValueError(
                f'`t` must not run backwards (late="raise"), got {t[i]} after {newest}{at}; '
                'late="accept" takes such events, late="drop" drops and counts them'
            )
        self.newest_us = newest_us
        self.n_dropped += n_late
        if not n_late:
            return columns
        t, x, y, p = (column[: columns.n][~late] for column in columns[:4])
        return Columns(t, x, y, p, t.size)


def _compile() -> None:
    """Compile what decodes packets, and nothing else for whatever arguments."""
    compile_only(check_columns, *CHECK_TYPES)
    compile_only(load_records, *LOAD_TYPES)


def _decode_any(events: Any, sensor: tuple[int, int], advice: str = "") -> Columns:
    columns = named_columns(events)
    return _NO_EVENTS if columns is None else checked_columns(*columns, sensor, advice)


def checked_columns(
    t: Any, x: Any, y: Any, p: Any, sensor: tuple[int, int], advice: str = ""
) -> Columns:
    """Four columns of any integer type as `Columns`, or an error that names the first invalid
    event."""
    columns = dict(zip(NAMES, map(np.asarray, (t, x, y, p)), strict=True))
    for field, column in columns.items():
        if column.ndim != 1:
            raise ValueError(f"`{field}` must have one dimension, got shape {column.shape}")
        _check_type(field, column)
    sizes = [column.size for column in columns.values()]
    if len(set(sizes)) != 1:
        raise ValueError(f"t, x, y and p must have equal lengths, got {', '.join(map(str, sizes))}")
    if sizes[0] == 0:
        return _NO_EVENTS
    _check_range("t", columns["t"], MAX_TIME_US, "2**62) microseconds")
    for field, side in zip("xy", sensor, strict=True):
        _check_range(field, columns[field], side, f"{side})", advice)
    polarity = columns["p"]
    off = polarity == 0
    allowed = off | (polarity == 1)
    if polarity.dtype.kind == "i" and not off.any():
        allowed |= polarity == -1
    if not allowed.all():
        i = int(np.argmin(allowed))
        mixed = " beside 0 in the same packet" if polarity[i] == -1 else ""
        raise ValueError(f"`p` must be 0 or 1, or -1 or +1, got {polarity[i]}{mixed} at event {i}")
    columns["p"] = polarity == 1
    # C-contiguous, aligned and writeable (what is not is copied): one compiled version
    typed = zip(columns.values(), _DTYPES, strict=True)
    t, x, y, p = (np.require(column, dtype, ["C", "A", "W"]) for column, dtype in typed)
    return Columns(t, x, y, p, t.size)


def as_events(events: Any, sensor: tuple[int, int]) -> np.ndarray:
    """Any accepted form of events as a new structured array of `EVENT_DTYPE`, checked."""
    columns = _decode_any(events, sensor)
    return structured(columns[:4], columns.n)


def structured(
    columns: Sequence[np.ndarray], n: int | None = None, dtype: np.dtype = EVENT_DTYPE
) -> np.ndarray:
    """The first `n` events of columns t, x, y, p, by default all, as a new structured array;
    nothing is checked."""
    events = np.empty(len(columns[0]) if n is None else n, dtype)
    for name, column in zip("txyp", columns, strict=True):
        events[name] = column[:n]
    return events


def _check_type(field: str, column: np.ndarray) -> None:
    kind = column.dtype.kind
    if kind in ("iub" if field == "p" else "iu"):
        return
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
        got += f" ({str(value)[:40] if isinstance(value, (str, np.generic)) else type(value).__name__} at event 0)"
    if field == "t" and kind in "fmM":
        raise TypeError(
            f"`t` must be integer microseconds, got {got}; its unit is unknown: "
            "convert seconds with np.rint(t * 1e6).astype('int64')"
        )
    raise TypeError(f"`{field}` must be whole numbers, got {got}")


def _check_range(field: str, column: np.ndarray, end: int, rule: str, advice: str = "") -> None:
    bad = column >= end
    if column.dtype.kind == "i":
        bad |= column < 0
    if bad.any():
        i = int(np.argmax(bad))
        advice = advice if column[i] >= end else ""
        raise ValueError(f"`{field}` must be in [0, {rule}, got {column[i]} at event {i}{advice}")


def _record_layout(dtype: np.dtype) -> np.ndarray | None:
    """Offsets and kinds for `load_records`; None for records it cannot read."""
    if dtype.names is None or dtype.fields is None:
        return None
    layout = []
    for field, names in NAMES.items():
        found = [name for name in names if name in dtype.names]
        if len(found) != 1:
            return None
        number, offset = dtype.fields[found[0]][:2]
        kind = KIND.get(number.str[1:])
        # the kernel would take a polarity of 2**64 - 1 for -1
        refused = "u8" if field == "p" else "b1"
        if kind is None or number.str[0] == ">" or number.str[1:] == refused:
            return None
        layout += [offset, kind]
    return np.array([*layout, dtype.itemsize], np.int64)
