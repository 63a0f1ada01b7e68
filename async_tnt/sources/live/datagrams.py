"""Events as bytes in datagrams, in the formats of other projects. Little-endian; a datagram holds
whole events.

| format            | bytes | one event                                                                         |
| ----------------- | ----- |
--------------------------------------------------------------------------------- |
| `t64_x16_y16_on8` | 13    | t u64, x u16, y u16, on u8 (faery)                                                |
| `t32_x16_y15_on1` | 8     | t u32 (low half of t), x u16, then u16: y in bits 15..1, on in bit 0 (faery)      |
| `spif`            | 4     | u32: 1 in bit 31, x in 30..16, on in 15, y in 14..0; no time (spiffer, AEStream)  |
| `spif_t32`        | 8     | the same with 0 in bit 31, then t u32 (AEStream's with timestamps)                |

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

from async_tnt.kernels.jit import compile_only
from async_tnt.kernels.sources.clock import NO_LIMIT
from async_tnt.kernels.sources.datagrams import ARGUMENTS, SPIF, SPIF_T32, T32, T64, decode_events
from async_tnt.sources.live.clock import Clock
from async_tnt.volume.config import MAX_SIDE
from async_tnt.volume.events import EVENT_DTYPE, as_events
from async_tnt.volume.sensor import checked_sensor

EVENT_BYTES = {"t64_x16_y16_on8": 13, "t32_x16_y15_on1": 8, "spif": 4, "spif_t32": 8}
"""Format -> bytes of one event."""

_ABSENT = 1 << 31  # SPIF: no time follows
_KIND = {"t64_x16_y16_on8": T64, "t32_x16_y15_on1": T32, "spif": SPIF, "spif_t32": SPIF_T32}


def checked_format(format: str) -> str:
    """`format` itself, or ValueError."""
    if format not in EVENT_BYTES:
        raise ValueError(f"`format` must be one of {', '.join(EVENT_BYTES)}, got {format!r}")
    return format


def encode(events: Any, format: str = "t64_x16_y16_on8") -> bytes:
    """Events as the payload of one datagram.

    Parameters
    ----------
    events : in any form that `async_tnt.volume.event_forms` lists.
    format : one of `EVENT_BYTES`. Those with 32 bits of time keep the low ones: the receiver
        unwraps.

    Raises
    ------
    ValueError, TypeError : unknown format, or invalid events.

    Examples
    --------
    >>> event = np.array([(258, 3, 4, 1)], EVENT_DTYPE)
    >>> encode(event).hex(" "), encode(event, "spif").hex(" ")
    ('02 01 00 00 00 00 00 00 03 00 04 00 01', '04 80 03 80')
    """
    checked_format(format)
    own = as_events(events, (MAX_SIDE, MAX_SIDE))
    if format == "t64_x16_y16_on8":  # our own records, bit for bit
        return own.tobytes()
    t, x, y, p = (own[field].astype("<u4") for field in "txyp")  # of t the low half
    if format == "t32_x16_y15_on1":
        words = np.column_stack([t, y << 17 | p << 16 | x])
    elif format == "spif":
        words = _ABSENT | x << 16 | p << 15 | y
    else:
        words = np.column_stack([x << 16 | p << 15 | y, t])
    return words.astype("<u4", copy=False).tobytes()


class Decoder:
    """Decodes the bytes of one stream to events. Invalid bytes never raise; they are counted.

    Times of 32 bits are unwrapped: each is assumed to lie within 2**31 us (36 minutes) of the
    newest event before it, so that the result does not depend on how the stream was cut. Events of
    `spif`, which has no time, get the time of arrival.

    Parameters
    ----------
    format : one of `EVENT_BYTES`.
    sensor : (width, height) in pixels; events beyond it are malformed. None: whatever the format
        can hold.
    max_jump_s : of the stream's `Clock`.

    Attributes
    ----------
    malformed : events left out so far: cut off, off the sensor, a polarity beyond 1, a time outside
        [0, 2**62) us, or one that jumps.
    off_sensor : events left out because they lie off the sensor.
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
        compile_only(decode_events, *ARGUMENTS)
        self.event_bytes = EVENT_BYTES[format]
        self.sensor = sensor = None if sensor is None else checked_sensor(sensor)
        self.malformed = self.off_sensor = 0
        self._kind = _KIND[format]
        self._width, self._height = sensor or (1 << 16, 1 << 16)
        self._max_jump_us = NO_LIMIT if format == "spif" else self.clock.max_jump_us

    def decode(self, data: bytes | bytearray | memoryview, arrival_us: int = 0) -> np.ndarray:
        """The events of a datagram, as `EVENT_DTYPE` in new memory.

        Parameters
        ----------
        data : bytes. What is left after the last whole event counts as one malformed event.
        arrival_us : microseconds on the receiver's clock: for `spif` the time of its events.
        """
        n, rest = divmod(len(data), self.event_bytes)
        self.malformed += rest > 0
        return self.decode_datagrams(np.frombuffer(data, np.uint8), [n], [arrival_us])

    def decode_datagrams(
        self, raw: np.ndarray, ends: Sequence[int], arrivals: Sequence[int]
    ) -> np.ndarray:
        """The events of several datagrams of whole events, end to end in `raw`, as `EVENT_DTYPE` in
        new memory.

        Parameters
        ----------
        raw : uint8, the bytes.
        ends : where each ends, in events.
        arrivals : when each came, in microseconds.
        """
        n = ends[-1] if ends else 0
        events = np.empty(n, EVENT_DTYPE)
        n_good, n_off_sensor = decode_events(
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
        self.malformed += n - n_good
        self.off_sensor += n_off_sensor
        return events if n_good == n else events[:n_good]
