"""Events as bytes in datagrams, in the formats that others speak. All little endian; a datagram holds whole events.

| format            | bytes | one event                                                                         |
| ----------------- | ----- | --------------------------------------------------------------------------------- |
| `t64_x16_y16_on8` | 13    | t u64, x u16, y u16, on u8 (faery)                                                |
| `t32_x16_y15_on1` | 8     | t u32 (low half of t), x u16, then u16: y in bits 15..1, on in bit 0 (faery)      |
| `spif`            | 4     | u32: 1 in bit 31, x in 30..16, on in 15, y in 14..0; no time (spiffer, AEStream)  |
| `spif_t32`        | 8     | the same with 0 in bit 31, then t u32 (AEStream's with timestamps)                |

References
----------
faery, https://github.com/aestream/faery (udp_encoder.py); spif, https://github.com/SpiNNakerManchester/spif
(spiffer/README.md); AEStream, https://github.com/aestream/aestream (dvs_to_udp.cpp).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..events import EVENT_DTYPE
from ..kernels.columns import MAX_TIME_US

EVENT_BYTES = {"t64_x16_y16_on8": 13, "t32_x16_y15_on1": 8, "spif": 4, "spif_t32": 8}
"""Format -> bytes of one event."""
MAX_DATAGRAM_BYTES = 65_507
"""What one UDP datagram over IPv4 can hold."""

_PACKED_8 = np.dtype([("t", "<u4"), ("x", "<u2"), ("y_on", "<u2")])
_TIMED_WORD = np.dtype([("word", "<u4"), ("t", "<u4")])
_ABSENT = 1 << 31  # SPIF: no time follows
_MAX_SIDE = {"t64_x16_y16_on8": 1 << 16, "t32_x16_y15_on1": 1 << 15, "spif": 1 << 15, "spif_t32": 1 << 15}


class Decoded(NamedTuple):
    """What some bytes held."""

    events: np.ndarray
    """Structured array of `EVENT_DTYPE`, new memory."""
    malformed: int
    """Events left out: cut off, off the sensor, a polarity beyond 1, a time before 0 or from 2**62 us on."""


def checked_format(format: str) -> str:
    """`format` itself, or ValueError."""
    if format not in EVENT_BYTES:
        raise ValueError(f"`format` must be one of {', '.join(EVENT_BYTES)}, got {format!r}")
    return format


def encode(events: np.ndarray, format: str = "t64_x16_y16_on8") -> bytes:
    """Events as the payload of one datagram.

    Parameters
    ----------
    events : structured array with fields t, x, y, p, such as `EVENT_DTYPE`; see `async_tnt.events.as_events`.
    format : one of `EVENT_BYTES`. Those with 32 bits of time keep the low ones: the receiver unwraps.

    Raises
    ------
    ValueError : unknown format; a coordinate that it has no bits for.

    Examples
    --------
    >>> event = np.array([(258, 3, 4, 1)], EVENT_DTYPE)
    >>> encode(event).hex(" "), encode(event, "spif").hex(" ")
    ('02 01 00 00 00 00 00 00 03 00 04 00 01', '04 80 03 80')
    """
    side = _MAX_SIDE[checked_format(format)]
    for field in ("x", "y"):
        if len(events) and side < 1 << 16 and int(events[field].max()) >= side:
            i = int(np.argmax(events[field] >= side))
            raise ValueError(f"`{field}` must be in [0, {side}) for {format}, got {events[field][i]} at event {i}")
    if format == "t64_x16_y16_on8":  # our own records, bit for bit
        return events.astype(EVENT_DTYPE, copy=False).tobytes()
    if format == "t32_x16_y15_on1":
        packed = np.empty(len(events), _PACKED_8)
        packed["t"] = events["t"] & 0xFFFFFFFF
        packed["x"] = events["x"]
        packed["y_on"] = events["y"] << 1 | events["p"]
        return packed.tobytes()
    word = events["x"].astype("<u4") << 16 | events["p"].astype("<u4") << 15 | events["y"]
    if format == "spif":
        return (word | _ABSENT).astype("<u4").tobytes()
    timed = np.empty(len(events), _TIMED_WORD)
    timed["word"] = word
    timed["t"] = events["t"] & 0xFFFFFFFF
    return timed.tobytes()


class Decoder:
    """Bytes of one stream to events. Never raises, whatever the bytes.

    Times of 32 bits are unwrapped: each is taken to lie within 2**31 us (36 minutes) of the event before it, so what
    comes out does not depend on how the stream was cut. `spif` has no time: its events get the time of arrival.

    Parameters
    ----------
    format : one of `EVENT_BYTES`.
    sensor : (width, height) in pixels; events beyond it are malformed. None: whatever the format can say.
    """

    def __init__(self, format: str = "t64_x16_y16_on8", sensor: tuple[int, int] | None = None) -> None:
        self.format = checked_format(format)
        self.event_bytes = EVENT_BYTES[format]
        self.sensor = sensor
        self._last_us: int | None = None  # of the newest place in the stream, for unwrapping

    def decode(self, data: bytes | bytearray | memoryview, arrival_us: int | np.ndarray = 0) -> Decoded:
        """The events in `data`: a datagram, or several of whole events, end to end.

        Parameters
        ----------
        data : bytes. What is left after the last whole event counts as one malformed event.
        arrival_us : for `spif`: the time of its events, microseconds; one number, or one for each event.
        """
        n, rest = divmod(len(data), self.event_bytes)
        n_cut = int(rest > 0)
        data = memoryview(data)[: n * self.event_bytes]
        if self.format == "t64_x16_y16_on8":
            raw = np.frombuffer(data, EVENT_DTYPE)
            time = raw["t"]
            good = (raw["p"] <= 1) & (time >= 0) & (time < MAX_TIME_US)  # u64 beyond int64 shows as negative
            good &= self._on_sensor(raw["x"], raw["y"])
            events = raw.copy() if good.all() else raw[good]
            return Decoded(events, n_cut + n - len(events))
        events = np.empty(n, EVENT_DTYPE)
        time_32 = None
        good = np.ones(n, bool)
        if self.format == "t32_x16_y15_on1":
            packed = np.frombuffer(data, _PACKED_8)
            events["x"], events["y"], events["p"] = packed["x"], packed["y_on"] >> 1, packed["y_on"] & 1
            time_32 = packed["t"]
        else:
            if self.format == "spif":
                word = np.frombuffer(data, "<u4")
                good = word >= _ABSENT
                events["t"] = arrival_us
            else:
                timed = np.frombuffer(data, _TIMED_WORD)
                word, time_32 = timed["word"], timed["t"]
                good = word < _ABSENT
            events["x"], events["y"], events["p"] = word >> 16 & 0x7FFF, word & 0x7FFF, word >> 15 & 1
        good &= self._on_sensor(events["x"], events["y"])
        if not good.all():
            events = events[good]
            time_32 = None if time_32 is None else time_32[good]
        if time_32 is not None:  # of the good ones only: a malformed event must not lead the others astray
            events["t"] = self._unwrap(time_32)
            if len(events) and int(events["t"].min()) < 0:  # older than the first event, which came near 0
                events = events[events["t"] >= 0]
        return Decoded(events, n_cut + n - len(events))

    def _on_sensor(self, x: np.ndarray, y: np.ndarray) -> np.ndarray | bool:
        return True if self.sensor is None else (x < self.sensor[0]) & (y < self.sensor[1])

    def _unwrap(self, time_32: np.ndarray) -> np.ndarray:
        """t_i = t_(i-1) + the signed 32-bit difference; the first one as it is."""
        if not len(time_32):
            return np.empty(0, np.int64)
        last_us = int(time_32[0]) if self._last_us is None else self._last_us
        steps = np.diff(time_32, prepend=np.uint32(last_us & 0xFFFFFFFF)).view(np.int32)
        t = last_us + np.cumsum(steps, dtype=np.int64)
        self._last_us = int(t[-1])
        return t


def decode(
    data: bytes | bytearray | memoryview,
    format: str = "t64_x16_y16_on8",
    sensor: tuple[int, int] | None = None,
    arrival_us: int = 0,
) -> Decoded:
    """The events of one datagram by itself; see `Decoder`, which goes on from datagram to datagram.

    Examples
    --------
    >>> decode(bytes.fromhex("02 01 00 00 00 00 00 00 03 00 04 00 01 ff")).malformed
    1
    """
    return Decoder(format, sensor).decode(data, arrival_us)
