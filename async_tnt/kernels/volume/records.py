"""Events from a packed record array into four checked columns, in one pass per column.

Every camera library packs its records differently, often unaligned, and Numba would compile these
loops again for each. So they read raw bytes: one compiled version serves every layout. The four
columns and the two sides of the sensor are arguments of their own, as in `absorb`.
"""

import numpy as np
from numba import boolean, int64, types, uint8, uint16
from numba.extending import intrinsic

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.lock import LARGE, release_gil, take_gil

# How a number is stored: the kinds of a layout.
I8 = 0
U8 = 1
I16 = 2
U16 = 3
I32 = 4
U32 = 5
I64 = 6
KIND = {
    "i1": I8,
    "u1": U8,
    "b1": U8,
    "i2": I16,
    "u2": U16,
    "i4": I32,
    "u4": U32,
    "i8": I64,
    "u8": I64,
}
"""A field's type in NumPy -> its kind."""

# A layout, int64: byte offset and kind of each field of a record, then the record's size.
T_AT = 0
T_KIND = 1
X_AT = 2
X_KIND = 3
Y_AT = 4
Y_KIND = 5
P_AT = 6
P_KIND = 7
RECORD_SIZE = 8  # bytes

MAX_TIME_US = 1 << 62
"""Times are below this many microseconds, so that start + window never overflows."""
BAD = -1
"""What is returned instead of a time if a number breaks its rule."""
RAW = types.Array(types.uint8, 1, "C", readonly=True)
"""Numba's type of bytes. Numba also accepts arrays that can be written."""
COLUMNS = (int64[::1], uint16[::1], uint16[::1], uint8[::1])
"""Numba's types of the columns t, x, y, p."""


@intrinsic
def load(typingctx, raw, offset, number):
    """The number of type `number`, little-endian, that begins at byte `offset` of `raw`."""
    value_type = number.instance_type

    def codegen(context, builder, signature, args):
        value = builder.load(_pointer(context, builder, signature, args, value_type))
        value.align = 1  # at any alignment
        return value

    if not isinstance(offset, types.Integer):
        return None
    return value_type(raw, offset, number), codegen


@intrinsic
def store(typingctx, raw, offset, value, number):
    """Write `value` as the type `number`, little-endian, from byte `offset` of `raw` on."""
    value_type = number.instance_type

    def codegen(context, builder, signature, args):
        stored = context.cast(builder, args[2], signature.args[2], value_type)
        instruction = builder.store(stored, _pointer(context, builder, signature, args, value_type))
        instruction.align = 1  # at any alignment
        return context.get_dummy_value()

    return types.void(raw, offset, value, number), codegen


def _pointer(context, builder, signature, args, value_type):
    """A pointer to the number of this type at byte args[1] of the array args[0]."""
    array = context.make_array(signature.args[0])(context, builder, args[0])
    byte = builder.gep(array.data, [args[1]])
    return builder.bitcast(byte, context.get_value_type(value_type).as_pointer())


@inlined
def _load_kind(raw, offset, kind):
    """The number of this kind from byte `offset` on, as int64."""
    if kind == U16:
        return np.int64(load(raw, offset, np.uint16))
    if kind == I64:  # a uint64 beyond int64 becomes negative, which no field allows
        return load(raw, offset, np.int64)
    if kind == U8:
        return np.int64(load(raw, offset, np.uint8))
    if kind == I16:
        return np.int64(load(raw, offset, np.int16))
    if kind == I8:
        return np.int64(load(raw, offset, np.int8))
    if kind == U32:
        return np.int64(load(raw, offset, np.uint32))
    return np.int64(load(raw, offset, np.int32))


@entry_point(RAW, int64[::1], int64, int64, int64, *COLUMNS)
def load_records(raw, layout, n, sensor_w, sensor_h, t, x, y, p):
    """Copy n records into columns and check them.

    Parameters
    ----------
    raw : uint8, shape (n * RECORD_SIZE,). The records' bytes; only read.
    layout : int64, shape (9,), see above.
    n : int. Records, at least 1.
    sensor_w, sensor_h : int. Pixels.
    t, x, y, p : int64, uint16, uint16, uint8, shape (at least n,). Overwritten; p becomes 0 or 1.

    Returns
    -------
    int : the time of the first event, or BAD if any number breaks its rule (the caller finds out
        which).
    """
    if raw.size != n * layout[RECORD_SIZE]:  # The array has more than one dimension.
        return BAD
    lock = release_gil(n >= LARGE)
    is_loaded = _load(raw, layout, n, sensor_w, sensor_h, t, x, y, p)
    is_valid = is_loaded and _in_range(t, x, y, p, n, sensor_w, sensor_h)
    take_gil(lock)
    return t[0] if is_valid else BAD


@inlined
def _load(raw, layout, n, sensor_w, sensor_h, t, x, y, p):
    """Copy n records into the columns. Returns False if a number does not fit its column."""
    p_kind = layout[P_KIND]
    has_common_time = layout[T_KIND] == I64
    has_common_place = layout[X_KIND] in (U16, I16) and layout[Y_KIND] in (U16, I16)
    if has_common_time and has_common_place and p_kind in (U8, I8, U16, I16):
        # Most libraries deliver numbers of these kinds. Loops of their own need no branches. Read
        # as unsigned, a negative pixel is too large, because no side of a sensor is longer than
        # 2**15, and polarity -1 is 255.
        size = layout[RECORD_SIZE]
        t_at = layout[T_AT]
        x_at = layout[X_AT]
        y_at = layout[Y_AT]
        p_at = layout[P_AT]
        # Time and place are loaded before either is stored: for all that the compiler knows, a
        # store may change what is loaded after it.
        if p_kind in (U8, I8):
            for i in range(n):
                time = load(raw, i * size + t_at, np.int64)
                column = load(raw, i * size + x_at, np.uint16)
                row = load(raw, i * size + y_at, np.uint16)
                t[i] = time
                x[i] = column
                y[i] = row
                p[i] = load(raw, i * size + p_at, np.uint8)
        else:
            for i in range(n):
                time = load(raw, i * size + t_at, np.int64)
                column = load(raw, i * size + x_at, np.uint16)
                row = load(raw, i * size + y_at, np.uint16)
                t[i] = time
                x[i] = column
                y[i] = row
                p[i] = _in_one_byte(load(raw, i * size + p_at, np.uint16))
        return p_kind in (U8, U16) or _unsign(p, n)
    return _load_any(raw, layout, n, sensor_w, sensor_h, t, x, y, p) and _unsign(p, n)


@inlined
def _in_one_byte(polarity):
    """A polarity of two bytes as one byte: 0, 1, 255 for -1, and 2 for every other number."""
    if polarity <= 2:
        return polarity
    return 255 if polarity == 0xFFFF else 2


@compiled
def _in_range(t, x, y, p, n, sensor_w, sensor_h):
    """Whether all numbers of the columns are within their limits.

    Smallest and largest stay in the column's type and so in full vector registers. To count the
    offenders would widen every number to 64 bits.
    """
    t_min = t[0]
    t_max = t[0]
    x_max = x[0]
    y_max = y[0]
    p_max = p[0]
    for i in range(n):
        t_min = min(t_min, t[i])
        t_max = max(t_max, t[i])
    for i in range(n):
        x_max = max(x_max, x[i])
        y_max = max(y_max, y[i])
    for i in range(n):
        p_max = max(p_max, p[i])
    return (
        (t_min >= 0)
        & (t_max < MAX_TIME_US)
        & (x_max < sensor_w)
        & (y_max < sensor_h)
        & (p_max <= 1)
    )


@compiled
def _unsign(p, n):
    """Write polarity -1 (here 255) and +1 as 0 and 1.

    Returns False if both zeros and -1 occur, or any other number.
    """
    # Usually there is nothing to do. This loop finds it in the column's type, without widening.
    largest = p[0]
    for i in range(n):
        largest = max(largest, p[i])
    if largest <= 1:
        return True

    zeros = 0
    minuses = 0
    ones = 0
    for i in range(n):
        zeros += p[i] == 0
        minuses += p[i] == 255
        ones += p[i] == 1
        p[i] = p[i] == 1
    return zeros + minuses + ones == n and (zeros == 0 or minuses == 0)


@compiled
def _load_any(raw, layout, n, sensor_w, sensor_h, t, x, y, p):
    """Copy records of any kinds of numbers into the columns.

    Returns False if a place is off the sensor or a polarity is not -1, 0 or 1. This is tested
    before the numbers are narrowed, which could make them look valid.
    """
    size = layout[RECORD_SIZE]
    fits = True
    for i in range(n):
        t[i] = _load_kind(raw, i * size + layout[T_AT], layout[T_KIND])
        x_i = _load_kind(raw, i * size + layout[X_AT], layout[X_KIND])
        y_i = _load_kind(raw, i * size + layout[Y_AT], layout[Y_KIND])
        p_i = _load_kind(raw, i * size + layout[P_AT], layout[P_KIND])
        is_on_sensor = (x_i >= 0) & (x_i < sensor_w) & (y_i >= 0) & (y_i < sensor_h)
        fits &= is_on_sensor & (p_i >= -1) & (p_i <= 1)
        x[i] = x_i
        y[i] = y_i
        p[i] = p_i & 255
    return fits


@entry_point(*COLUMNS, int64, int64)
def check_columns(t, x, y, p, sensor_w, sensor_h):
    """Check columns such as `load_records` makes.

    The columns must have one length. Each must be aligned in memory, which Numba does not check
    itself.

    Returns
    -------
    int : the time of the first event; MAX_TIME_US if there is none; BAD if any rule is broken.
    """
    if x.size != t.size or y.size != t.size or p.size != t.size:
        return BAD
    if (t.ctypes.data % 8 != 0) | (x.ctypes.data % 2 != 0) | (y.ctypes.data % 2 != 0):
        return BAD
    if t.size == 0:
        return MAX_TIME_US
    first_us = t[0]
    return first_us if _in_range(t, x, y, p, t.size, sensor_w, sensor_h) else BAD


@entry_point(int64[::1], int64, boolean[::1])
def find_late(t, newest_us, late):
    """Mark each event that is older than the newest one before it.

    Parameters
    ----------
    t : int64, shape (n,).
    newest_us : int. Newest time before these events.
    late : bool, shape (n,). Overwritten.

    Returns
    -------
    n_late, newest_us : int. How many are late, and the newest time after these events.
    """
    n_late = 0
    for i in range(t.size):
        late[i] = t[i] < newest_us
        n_late += late[i]
        newest_us = max(newest_us, t[i])
    return n_late, newest_us
