"""Events from the bytes of datagrams, in one pass that decodes, checks and unwraps times.

Then `clock.repair_times` drops events whose times jump.
"""

import numpy as np
from numba import int64, uint8

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.sources.clock import NEWEST, repair_times
from async_tnt.kernels.volume.records import RAW, load, store

# The formats of datagrams, which `async_tnt.sources.live.datagrams` describes.
T64 = 0
T32 = 1
SPIF = 2
SPIF_T32 = 3
RECORD_BYTES = 13
"""Bytes of a record of EVENT_DTYPE."""


# Ten parameters: Numba takes arrays faster one by one than in a tuple.
@entry_point(
    RAW,
    int64,
    int64[::1],
    int64[::1],
    int64,
    int64,
    int64,
    int64,
    int64[::1],
    uint8[::1],
    calls=(repair_times,),
)
def decode_events(raw, format, ends, arrivals, n_datagrams, width, height, max_jump, clock, out):
    """The good events of some datagrams, in order.

    Times of 32 bits are unwrapped: t = newest + the signed 32-bit difference of the time and the
    low half of newest. The first time stays as it is.

    Parameters
    ----------
    raw : uint8. Datagrams of whole events, end to end.
    format : T64, T32, SPIF or SPIF_T32.
    ends : int64, shape (at least n_datagrams,). Where each datagram ends, in events.
    arrivals : int64, like `ends`. When each datagram came, in microseconds on any clock.
    n_datagrams : int.
    width, height : int. Events at x >= width or y >= height are off the sensor.
    max_jump, clock : see `repair_times`. `clock` is updated in place.
    out : uint8, shape (at least RECORD_BYTES * ends[n_datagrams - 1],). Records of `EVENT_DTYPE`.
        Updated in place.

    Returns
    -------
    n_out, n_off_sensor : int. Events written, and events dropped because they are off the sensor.
    """
    if format == T64:
        size = 13
    elif format == SPIF:
        size = 4
    else:
        size = 8

    n_out = 0
    n_off_sensor = 0
    first = 0
    for k in range(n_datagrams):
        newest = clock[NEWEST]  # time of the newest event read so far, this datagram's included
        start = RECORD_BYTES * n_out
        record = start
        for i in range(first, ends[k]):
            place = i * size
            is_good = True
            if format == T64:
                t = load(raw, place, np.int64)
                x = np.int64(load(raw, place + 8, np.uint16))
                y = np.int64(load(raw, place + 10, np.uint16))
                p = np.int64(load(raw, place + 12, np.uint8))
                is_good = p <= 1
            else:
                word = np.int64(load(raw, place, np.uint32))
                low_half = word
                if format == T32:
                    # A word of time; then x (16 bits), p (1), y (15), from the lowest bit on.
                    second = np.int64(load(raw, place + 4, np.uint32))
                    x = second & 0xFFFF
                    y = second >> 17
                    p = second >> 16 & 1
                else:
                    # y (15 bits), p (1), x (15), and a bit that says that no word of time follows.
                    x = word >> 16 & 0x7FFF
                    y = word & 0x7FFF
                    p = word >> 15 & 1
                    is_good = (word >> 31 == 1) == (format == SPIF)
                    if format == SPIF_T32:
                        low_half = np.int64(load(raw, place + 4, np.uint32))
                t = arrivals[k] if format == SPIF else _unwrapped(newest, low_half)
            if not is_good:
                continue
            if x >= width or y >= height:
                n_off_sensor += 1
                continue

            newest = max(newest, t)
            store(out, record, t, np.int64)
            store(out, record + 8, x, np.uint16)
            store(out, record + 10, y, np.uint16)
            store(out, record + 12, p, np.uint8)
            record += RECORD_BYTES

        n_good = (record - start) // RECORD_BYTES
        n_out += repair_times(out, start, n_good, RECORD_BYTES, 0, arrivals[k], max_jump, clock)
        first = ends[k]
    return n_out, n_off_sensor


@inlined
def _unwrapped(newest, low_half):
    """The time nearest to `newest` that has this `low_half`.

    It is `low_half` itself before the first event, when `newest` is negative.
    """
    if newest < 0:
        return low_half
    return newest + ((low_half - newest + 0x80000000) & 0xFFFFFFFF) - 0x80000000
