"""Bytes of datagrams to events: one pass that takes apart, checks and unwraps, and
`clock.repair_times`."""

import numpy as np
from numba import int64, uint8

from async_tnt.kernels.jit import compiled
from async_tnt.kernels.sources.clock import NEWEST, repair_times
from async_tnt.kernels.volume.records import RAW_TYPE, load, store

T64, T32, SPIF, SPIF_T32 = range(4)
RECORD_BYTES = 13  # of EVENT_DTYPE
ARGUMENTS = (
    RAW_TYPE,
    int64,
    int64[::1],
    int64[::1],
    int64,
    int64,
    int64,
    int64,
    int64[::1],
    uint8[::1],
)


@compiled
def decode_events(raw, format, ends, arrivals, n_datagrams, width, height, max_jump, clock, out):
    """The good events of some datagrams, in order.

    Times of 32 bits: t = newest + the signed 32-bit difference of `time` and the low half of
    newest; the first one as it is.

    Parameters
    ----------
    raw : uint8. Datagrams of whole events, end to end.
    format : T64, T32, SPIF or SPIF_T32.
    ends : int64, shape (at least n_datagrams,). Where each ends, in events.
    arrivals : int64, as `ends`. When each came, microseconds on any clock.
    width, height : events at x >= width or y >= height are off the sensor.
    max_jump, clock : as for `repair_times`. `clock` is updated in place.
    out : uint8, shape (at least 13 * ends[n_datagrams - 1],). Records of `EVENT_DTYPE`; updated in
        place.

    Returns
    -------
    n_out, n_off_sensor : int.
    """
    n_out = first = n_off_sensor = 0
    size = 13 if format == T64 else 4 if format == SPIF else 8
    for k in range(n_datagrams):
        newest = clock[NEWEST]
        start = record = RECORD_BYTES * n_out
        for i in range(first, ends[k]):
            at = i * size
            good = True
            if format == T64:
                t = load(raw, at, np.int64)
                x, y = (
                    np.int64(load(raw, at + 8, np.uint16)),
                    np.int64(load(raw, at + 10, np.uint16)),
                )
                p = np.int64(load(raw, at + 12, np.uint8))
                good = p <= 1
            else:
                word = np.int64(load(raw, at, np.uint32))
                low = word
                if format == T32:
                    second = np.int64(load(raw, at + 4, np.uint32))
                    x, y, p = second & 0xFFFF, second >> 17, second >> 16 & 1
                else:
                    x, y, p = word >> 16 & 0x7FFF, word & 0x7FFF, word >> 15 & 1
                    good = (word >> 31 == 1) == (format == SPIF)
                    if format == SPIF_T32:
                        low = np.int64(load(raw, at + 4, np.uint32))
                if format == SPIF:
                    t = arrivals[k]
                elif newest < 0:
                    t = low
                else:
                    t = newest + ((low - newest + 0x80000000) & 0xFFFFFFFF) - 0x80000000
            if not good:
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
