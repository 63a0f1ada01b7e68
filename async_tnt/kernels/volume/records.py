"""Events from a packed record array into four checked columns, in one pass per column.

Every camera library packs its records differently, often unaligned, and Numba would compile these
loops again for each. So they read raw bytes: one compiled version serves every layout.
"""

import numpy as np
from numba import types
from numba.extending import intrinsic

from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.lock import LARGE, release_gil, take_gil

# how a number is stored (rows of a layout: offset, kind for t, x, y, p)
I8, U8, I16, U16, I32, U32, I64 = range(7)
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
MAX_TIME_US = 1 << 62  # so that start + window never overflows
BAD = -1  # instead of a time
RAW_TYPE = types.Array(types.uint8, 1, "C", readonly=True)  # writeable ones pass for read-only
COLUMN_TYPES = (types.int64[::1], types.uint16[::1], types.uint16[::1], types.uint8[::1])
# the arguments of `check_columns` and `load_records`
CHECK_TYPES = (*COLUMN_TYPES, types.int64, types.int64)
LOAD_TYPES = (RAW_TYPE, types.int64[::1], *(types.int64,) * 3, *COLUMN_TYPES)


@intrinsic
def load(typingctx, raw, offset, number):
    """The number of type `number` that starts at byte `offset` of `raw`, at any alignment,
    little-endian."""
    value_type = number.instance_type

    def codegen(context, builder, signature, args):
        value = builder.load(_pointer(context, builder, signature, args, value_type))
        value.align = 1
        return value

    if not isinstance(offset, types.Integer):
        return None
    return value_type(raw, offset, number), codegen


@intrinsic
def store(typingctx, raw, offset, value, number):
    """Write `value` as the type `number`, little-endian, from byte `offset` of `raw` on, at any
    alignment."""
    value_type = number.instance_type

    def codegen(context, builder, signature, args):
        stored = context.cast(builder, args[2], signature.args[2], value_type)
        builder.store(stored, _pointer(context, builder, signature, args, value_type)).align = 1
        return context.get_dummy_value()

    return types.void(raw, offset, value, number), codegen


def _pointer(context, builder, signature, args, value_type):
    """To the number of this type at byte args[1] of the array args[0]."""
    array = context.make_array(signature.args[0])(context, builder, args[0])
    return builder.bitcast(
        builder.gep(array.data, [args[1]]), context.get_value_type(value_type).as_pointer()
    )


@inlined
def _load_kind(raw, offset, kind):
    if kind == U16:
        return np.int64(load(raw, offset, np.uint16))
    if kind == I64:  # a uint64 beyond int64 turns negative, which no field allows
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


@compiled
def load_records(raw, layout, n, sensor_w, sensor_h, t, x, y, p):
    """Copy n records into columns and check them.

    Parameters
    ----------
    raw : uint8, shape (n * layout[8],). The records' bytes; only read.
    layout : int64, shape (9,). Byte offset and kind of t, of x, of y, of p, then the record's size.
    t, x, y, p : int64, uint16, uint16, uint8, shape (at least n,). Overwritten; p becomes 0 or 1.

    Returns
    -------
    int : the time of the first event, or BAD if any number breaks its rule (the caller finds out
        which).
    """
    if raw.size != n * layout[8]:  # more than one dimension
        return BAD
    lock = release_gil(n >= LARGE)
    is_loaded = _load(raw, layout, n, sensor_w, sensor_h, t, x, y, p)
    is_fine = is_loaded and _in_range(t, x, y, p, n, sensor_w, sensor_h)
    take_gil(lock)
    return t[0] if is_fine else BAD


@inlined
def _load(raw, layout, n, sensor_w, sensor_h, t, x, y, p):
    """The columns, unchecked; False if a number does not fit its column."""
    size = layout[8]
    kind_t, kind_x, kind_y, kind_p = layout[1], layout[3], layout[5], layout[7]
    if (
        kind_t == I64
        and kind_x in (U16, I16)
        and kind_y in (U16, I16)
        and kind_p in (U8, I8, U16, I16)
    ):
        # What most libraries deliver, without branches inside the loops. Read as unsigned, a
        # negative pixel is too large (sensors end at 2**15), and polarity -1 is 255.
        at_t, at_x, at_y, at_p = layout[0], layout[2], layout[4], layout[6]
        if kind_p in (U8, I8):
            for i in range(n):
                t[i], x[i], y[i] = _load_time_and_place(raw, i * size, at_t, at_x, at_y)
                p[i] = load(raw, i * size + at_p, np.uint8)
        else:
            for i in range(n):
                t[i], x[i], y[i] = _load_time_and_place(raw, i * size, at_t, at_x, at_y)
                polarity = load(raw, i * size + at_p, np.uint16)
                p[i] = polarity if polarity <= 2 else (255 if polarity == 0xFFFF else 2)
        return kind_p in (U8, U16) or _unsign(p, n)
    return _load_any(raw, layout, n, sensor_w, sensor_h, t, x, y, p) and _unsign(p, n)


@inlined
def _load_time_and_place(raw, record, at_t, at_x, at_y):
    return (
        load(raw, record + at_t, np.int64),
        load(raw, record + at_x, np.uint16),
        load(raw, record + at_y, np.uint16),
    )


@compiled
def _in_range(t, x, y, p, n, sensor_w, sensor_h):
    """Whether all columns are within their limits. Smallest and largest stay in the column's type
    and so in full vector registers, where counting offenders would widen every number to 64
    bits."""
    t_min = t_max = t[0]
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
    """Polarity -1 (here 255) and +1 become 0 and 1; False if there are also zeros, or other
    numbers."""
    largest = p[0]
    for i in range(n):
        largest = max(largest, p[i])
    if largest <= 1:  # nothing to do, found in the column's type, without widening
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
    """Records of any kinds of numbers; False if one does not fit its column, which narrowing would
    hide."""
    size = layout[8]
    fits = True
    for i in range(n):
        t[i] = _load_kind(raw, i * size + layout[0], layout[1])
        x_i = _load_kind(raw, i * size + layout[2], layout[3])
        y_i = _load_kind(raw, i * size + layout[4], layout[5])
        p_i = _load_kind(raw, i * size + layout[6], layout[7])
        fits &= (
            (x_i >= 0) & (x_i < sensor_w) & (y_i >= 0) & (y_i < sensor_h) & (p_i >= -1) & (p_i <= 1)
        )
        x[i] = x_i
        y[i] = y_i
        p[i] = p_i & 255
    return fits


@compiled
def check_columns(t, x, y, p, sensor_w, sensor_h):
    """The time of the first event, MAX_TIME_US if there is none; BAD if any number breaks its rule,
    lengths differ, or a column is not aligned (the one thing that Numba's check of its arguments
    lets pass). Columns as `load_records` makes them."""
    if x.size != t.size or y.size != t.size or p.size != t.size:
        return BAD
    if (t.ctypes.data % 8 != 0) | (x.ctypes.data % 2 != 0) | (y.ctypes.data % 2 != 0):
        return BAD
    if t.size == 0:
        return MAX_TIME_US
    first_us = t[0]
    return first_us if _in_range(t, x, y, p, t.size, sensor_w, sensor_h) else BAD


@compiled
def find_late(t, newest_us, late):
    """Mark events older than the newest before them. Returns how many, and the newest time then.

    Parameters
    ----------
    t : int64, shape (n,).
    newest_us : int. Newest time before these events.
    late : bool, shape (n,). Overwritten.
    """
    n_late = 0
    for i in range(t.size):
        late[i] = t[i] < newest_us
        n_late += late[i]
        newest_us = max(newest_us, t[i])
    return n_late, newest_us
