"""Events as bytes in datagrams, in the formats of other projects.

Numbers are little-endian, and a datagram holds whole events.

    format            bytes  one event
    t64_x16_y16_on8   13     t u64, x u16, y u16, on u8 (faery)
    t32_x16_y15_on1   8      t u32 (the low half of t), x u16, then u16: y in bits 15 to 1, on in
                             bit 0 (faery)
    spif              4      u32: 1 in bit 31, x in bits 30 to 16, on in bit 15, y in bits 14 to 0;
                             no time (spiffer, AEStream)
    spif_t32          8      the same with 0 in bit 31, then t u32 (AEStream with timestamps)

References
----------
faery, https://github.com/aestream/faery (udp_encoder.py); spif,
https://github.com/SpiNNakerManchester/spif (spiffer/README.md); AEStream,
https://github.com/aestream/aestream (dvs_to_udp.cpp).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.sources.clock import NO_LIMIT
from async_tnt.kernels.sources.datagrams import SPIF, SPIF_T32, T32, T64, decode_events
from async_tnt.sources.live.clock import Clock
from async_tnt.volume.config import MAX_SIDE
from async_tnt.volume.events import ANY_SENSOR, EVENT_DTYPE, as_events
from async_tnt.volume.sensor import checked_sensor

EVENT_BYTES = {"t64_x16_y16_on8": 13, "t32_x16_y15_on1": 8, "spif": 4, "spif_t32": 8}
"""Format -> bytes of one event."""

_ABSENT = 1 << 31
"""Bit in a word of SPIF that says that no time follows."""

_KIND = {"t64_x16_y16_on8": T64, "t32_x16_y15_on1": T32, "spif": SPIF, "spif_t32": SPIF_T32}
"""Format -> its number in the kernel."""


def checked_format(format: str) -> str:
    """The name `format` itself, if there is such a format.

    Raises
    ------
    ParameterValueError : there is no such format.
    """
    if format not in EVENT_BYTES:
        rule = f"must be one of {', '.join(EVENT_BYTES)}"
        raise ParameterValueError("format", rule, repr(format))
    return format


def encode(events: Any, format: str = "t64_x16_y16_on8") -> bytes:
    """Events as the payload of one datagram.

    Parameters
    ----------
    events : in any form that `async_tnt.volume.event_forms` lists.
    format : `t64_x16_y16_on8`, `t32_x16_y15_on1`, `spif` or `spif_t32`; docs/reference.md describes
        them. Two have only the low 32 bits of the time: the receiver unwraps it.

    Raises
    ------
    ValueError, TypeError : unknown format, or invalid events.

    Examples
    --------
    >>> event = np.array([(258, 3, 4, 1)], EVENT_DTYPE)
    >>> encode(event).hex(" ")
    '02 01 00 00 00 00 00 00 03 00 04 00 01'
    >>> encode(event, "spif").hex(" ")
    '04 80 03 80'
    """
    checked_format(format)
    records = as_events(events, (MAX_SIDE, MAX_SIDE))
    if format == "t64_x16_y16_on8":  # the records of EVENT_DTYPE, bit for bit
        return records.tobytes()
    t = records["t"].astype("<u4")  # the low half
    x = records["x"].astype("<u4")
    y = records["y"].astype("<u4")
    p = records["p"].astype("<u4")
    if format == "t32_x16_y15_on1":
        words = np.column_stack([t, y << 17 | p << 16 | x])
    elif format == "spif":
        words = _ABSENT | x << 16 | p << 15 | y
    else:
        words = np.column_stack([x << 16 | p << 15 | y, t])
    return words.astype("<u4", copy=False).tobytes()


class Decoder:
    """A decoder of the bytes of one stream. Invalid bytes never raise; they are counted.

    Times of 32 bits are unwrapped: each is assumed to lie within 2**31 us (36 minutes) of the
    newest event before it, so that the result does not depend on how the stream was cut. Events of
    `spif`, which has no time, get the time of arrival.

    Parameters
    ----------
    format : one of `EVENT_BYTES`.
    sensor : (width, height) in pixels; events beyond it are malformed. None: whatever the format
        can hold.
    max_jump_s : parameter of the stream's `Clock`.

    Attributes
    ----------
    malformed : number of events left out so far: cut off, off the sensor, with a polarity beyond 1,
        or with a time that jumps or lies outside [0, 2**62) us.
    off_sensor : number of events left out because they lie off the sensor.
    clock : the `Clock`; `clock.jumped` counts the events that it drops.
    event_bytes : bytes of one event.
    """

    def __init__(
        self,
        format: str = "t64_x16_y16_on8",
        sensor: tuple[int, int] | None = None,
        max_jump_s: float | None = None,
    ) -> None:
        self.format = checked_format(format)
        self.clock = Clock(max_jump_s)
        prepare(decode_events)
        self.event_bytes = EVENT_BYTES[format]
        self.sensor = None if sensor is None else checked_sensor(sensor)
        self.malformed = 0
        self.off_sensor = 0
        self._kind = _KIND[format]
        self._width, self._height = self.sensor or ANY_SENSOR
        self._max_jump_us = NO_LIMIT if format == "spif" else self.clock.max_jump_us

    def decode(self, data: bytes | bytearray | memoryview, arrival_us: int = 0) -> np.ndarray:
        """The events of a datagram, as `EVENT_DTYPE` in new memory.

        Parameters
        ----------
        data : the bytes. What is left after the last whole event counts as one malformed event.
        arrival_us : microseconds on the receiver's clock. For `spif`, this is the time of the
            events.
        """
        n, n_bytes_left = divmod(len(data), self.event_bytes)
        if n_bytes_left > 0:
            self.malformed += 1
        return self.decode_datagrams(np.frombuffer(data, np.uint8), [n], [arrival_us])

    def decode_datagrams(
        self, raw: np.ndarray, ends: Sequence[int], arrivals: Sequence[int]
    ) -> np.ndarray:
        """The events of several datagrams of whole events, as `EVENT_DTYPE` in new memory.

        Parameters
        ----------
        raw : uint8, the bytes of all datagrams, end to end.
        ends : end of each datagram, in events from the beginning of `raw`.
        arrivals : time at which each datagram came, in microseconds.
        """
        n = ends[-1] if ends else 0
        events = np.empty(n, EVENT_DTYPE)
        n_valid, n_off_sensor = decode_events.checked(
            raw,
            self._kind,
            np.array(ends, np.int64),
            np.array(arrivals, np.int64),
            len(ends),
            self._width,
            self._height,
            self._max_jump_us,
            self.clock.state,
            np.frombuffer(events, np.uint8),
        )
        self.malformed += n - n_valid
        self.off_sensor += n_off_sensor
        return events if n_valid == n else events[:n_valid]
