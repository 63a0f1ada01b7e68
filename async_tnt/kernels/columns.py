"""Events out of a packed record array into four checked columns, in one pass per column.

Every camera library packs its records in another way, often unaligned, and Numba would compile these loops
anew for each. So they read raw bytes: one compiled version serves every layout.
"""

import numpy as np
from numba import types
from numba.extending import intrinsic

from .jit import compiled, inlined

# how a number is stored (rows of a layout: offset, kind for t, x, y, p)
I8, U8, I16, U16, I32, U32, I64 = range(7)
KIND = {"i1": I8, "u1": U8, "b1": U8, "i2": I16, "u2": U16, "i4": I32, "u4": U32, "i8": I64, "u8": I64}
MAX_TIME_US = 1 << 62  # so that start + window never overflows
FINE, BAD = 0, 1
RAW_TYPE = types.Array(types.uint8, 1, "C", readonly=True)  # writeable ones pass for read-only
COLUMN_TYPES = (types.int64[::1], types.uint16[::1], types.uint16[::1], types.uint8[::1])


@intrinsic
def load(typingctx, raw, offset, number):
    """The number of type `number` that starts at byte `offset` of `raw`, at any alignment, little-endian."""
    value_type = number.instance_type

    def codegen(context, builder, signature, args):
        array = context.make_array(signature.args[0])(context, builder, args[0])
        pointer = builder.gep(array.data, [args[1]])
        pointer = builder.bitcast(pointer, context.get_value_type(value_type).as_pointer())
        value = builder.load(pointer)
        value.align = 1
        return value

    if not isinstance(offset, types.Integer):
        return None
    return value_type(raw, offset, number), codegen


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
    int : FINE, or BAD if any number breaks its rule (who calls finds out which).
    """
    size = layout[8]
    if raw.size != n * size:  # more dimensions than one
        return BAD
    offset, kind = layout[0], layout[1]
    if kind == I64:  # the common kinds have loops of their own, without tests inside
        for i in range(n):
            t[i] = load(raw, i * size + offset, np.int64)
    else:
        for i in range(n):
            t[i] = _load_kind(raw, i * size + offset, kind)
    bad = _load_pixels(raw, layout[2], layout[3], size, n, sensor_w, x)
    bad += _load_pixels(raw, layout[4], layout[5], size, n, sensor_h, y)
    offset, kind = layout[6], layout[7]
    zeros = 0
    minuses = 0
    for i in range(n):
        at = i * size + offset
        value = _load_kind(raw, at, kind) if kind != U8 else np.int64(raw[np.uint64(at)])
        bad += (value < -1) | (value > 1)
        zeros += value == 0
        minuses += value < 0
        p[i] = value > 0
    for i in range(n):
        bad += (t[i] < 0) | (t[i] >= MAX_TIME_US)
    return BAD if bad > 0 or (zeros > 0 and minuses > 0) else FINE


@compiled
def _load_pixels(raw, offset, kind, size, n, end, column):
    """One coordinate; returns how many lie outside [0, end)."""
    bad = 0
    if kind in (U16, I16):  # end is at most 2**15: a negative int16 is too large as uint16
        for i in range(n):
            column[i] = load(raw, i * size + offset, np.uint16)
        for i in range(n):
            bad += column[i] >= end
    else:
        for i in range(n):
            value = _load_kind(raw, i * size + offset, kind)
            bad += (value < 0) | (value >= end)
            column[i] = value
    return bad


@compiled
def check_columns(t, x, y, p, sensor_w, sensor_h):
    """FINE, or BAD if any number breaks its rule, lengths differ, or a column is not aligned (the one thing that
    Numba's own check of its arguments lets pass). Columns as `load_records` makes them."""
    bad = 0
    if x.size != t.size or y.size != t.size or p.size != t.size:
        return BAD
    if (t.ctypes.data % 8 != 0) | (x.ctypes.data % 2 != 0) | (y.ctypes.data % 2 != 0):
        return BAD
    for i in range(t.size):
        bad += (t[i] < 0) | (t[i] >= MAX_TIME_US)
    for i in range(x.size):
        bad += (x[i] >= sensor_w) | (y[i] >= sensor_h)
    for i in range(p.size):
        bad += p[i] > 1
    return BAD if bad > 0 else FINE


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
