"""Events from the network: `open_udp` and `UdpSource` listen, `UdpSender` in `udp_sender` sends."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import threading
import time
from array import array
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.checks import positive_int, whole_number
from async_tnt.sources.datagrams import Decoder
from async_tnt.sources.udp_socket import (
    Waiter,
    ask_for_buffer,
    checked_timeout,
    lost_datagrams,
    parse_udp_url,
    resolve,
)

ROOM = 1 << 16  # more than any datagram: none is ever cut off
BATCH_BYTES = 1 << 18
WARN_AFTER = 1000  # malformed events without a single good one, after which a warning names possible reasons
MOST_DATAGRAMS = 1 << 14  # of one packet, as these may be empty

log = logging.getLogger("async_tnt.sources")


@dataclass(frozen=True)
class NetworkCounts:
    """What a `UdpSource` has received so far."""

    datagrams: int
    """Datagrams received."""
    bytes: int
    """Bytes of these."""
    events: int
    """Events handed on."""
    malformed: int
    """Left out: cut off, off the sensor, an impossible polarity or time, a time that jumps."""
    late: int
    """Handed on, but older than one before: the network or the sender reordered them."""
    lost: int | None
    """Datagrams that the system dropped, mostly because its buffer was full; None where it does not report it."""
    jumped: int = 0
    """How many of `malformed` have a time that jumps, see `Clock`."""
    off_sensor: int = 0
    """How many of `malformed` lie off the sensor."""
    clock_restarts: int = 0
    """How often the sender's clock moved back; times continue, see `Clock`."""

    def summary(self) -> str:
        """One line for people.

        Examples
        --------
        >>> NetworkCounts(12, 15_600, 1_199, malformed=1, late=0, lost=None, jumped=1).summary()
        '12 datagrams, 1,199 events (1 malformed, 1 of them time jumps, 0 out of order, datagrams lost: unknown)'
        """
        lost = "unknown" if self.lost is None else f"{self.lost:,}"
        of_them = f"{self.jumped:,} of them time jumps, " if self.jumped else ""
        of_them += f"{self.off_sensor:,} of them off the sensor, " if self.off_sensor else ""
        restarts = f", clock restarts: {self.clock_restarts:,}" if self.clock_restarts else ""
        return (
            f"{self.datagrams:,} datagrams, {self.events:,} events ({self.malformed:,} malformed, {of_them}"
            f"{self.late:,} out of order, datagrams lost: {lost}{restarts})"
        )


class UdpSource:
    """Listens for datagrams of events.

    Iterating (`for` or `async for`) yields packets: structured arrays of `EVENT_DTYPE`, never empty, each of all
    datagrams that were waiting, or of the one that ended a wait. It ends when `close` is called, from any thread, or
    after `timeout_s` of silence. Invalid events never raise; they are dropped, see `counts`. One thread or one task
    iterates at a time.

    Parameters
    ----------
    address, port : where to listen; by default only this machine can send. Port 0 picks a free one: read `port`.
    format : one of `async_tnt.sources.EVENT_BYTES`.
    sensor : (width, height) in pixels; events beyond it are malformed. None: all are handed on.
    buffer_bytes : receive buffer to ask the system for; `advice` and the log `async_tnt.sources` warn if it is smaller.
    timeout_s : silence, in seconds, after which iterating ends; None waits forever.
    max_datagrams : in one packet, at most.
    max_jump_s : of the stream's `Clock`, which drops events whose time jumps, and continues the times of a sender that
        starts again. None: every time is trusted.
    spin_us : how long to poll before sleeping, in microseconds. Waking up a thread is most of the latency; polling
        avoids it and keeps a core busy.

    Raises
    ------
    OSError : the address is not this machine's, or taken.
    ValueError : a setting out of range.

    Examples
    --------
    >>> from async_tnt import EVENT_DTYPE
    >>> from async_tnt.sources import UdpSender
    >>> with UdpSource(port=0, timeout_s=1) as source, UdpSender(port=source.port) as sender:
    ...     sender.send(np.array([(258, 3, 4, 1)], EVENT_DTYPE))
    ...     next(iter(source)).tolist(), source.counts.events
    ([(258, 3, 4, 1)], 1)
    """

    def __init__(
        self,
        address: str = "127.0.0.1",
        port: int = 3333,
        format: str = "t64_x16_y16_on8",
        sensor: tuple[int, int] | None = None,
        *,
        buffer_bytes: int = 1 << 22,
        timeout_s: float | None = None,
        max_datagrams: int = 64,
        max_jump_s: float | None = 10.0,
        spin_us: float = 0.0,
    ) -> None:
        port = whole_number("port", port, 0, 1 << 16)
        buffer_bytes = whole_number("buffer_bytes", buffer_bytes, 1, 1 << 30, "in [1, 2**30)")
        if not 0 <= spin_us <= 1e6:
            raise ValueError(f"`spin_us` must be in [0, 1,000,000] microseconds, got {spin_us}")
        self.timeout_s = None if timeout_s is None else checked_timeout(timeout_s)
        self.max_datagrams = positive_int("max_datagrams", max_datagrams)
        self.spin_us = spin_us
        self._decoder = Decoder(format, sensor, max_jump_s)
        self._memory = memoryview(bytearray(BATCH_BYTES))
        room = bytes(8 * min(max_datagrams, MOST_DATAGRAMS))
        self._ends, self._arrivals = array("q", room), array("q", room)
        # the decoder's views of the three; writing a number through NumPy takes four times as long
        self._raw = np.frombuffer(self._memory, np.uint8)
        self._ends_seen = np.frombuffer(self._ends, np.int64)
        self._arrivals_seen = np.frombuffer(self._arrivals, np.int64)
        self._datagrams = self._bytes = self._events = self._cut = 0
        self._started_ns = time.monotonic_ns()
        self._closed = self._has_warned = False
        # Held while a thread reads or waits, so that `close` does not free the socket's number meanwhile: the system
        # may give it to another socket. Re-entrant: a signal handler may close, too.
        self._reading = threading.RLock()
        family, where = resolve(address, port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind(where)
            self.buffer_bytes, self.advice = ask_for_buffer(self._socket, buffer_bytes)
            self._waiter = Waiter(self._socket)
        except OSError as error:
            self._socket.close()
            raise OSError(error.errno, error.strerror, f"udp://{address}:{port}") from None
        self._lost: int | None = None
        self.address, self.port = self._socket.getsockname()[:2]
        if self.advice:
            log.warning("%s", self.advice)

    @property
    def format(self) -> str:
        """The datagrams' format, one of `async_tnt.sources.EVENT_BYTES`."""
        return self._decoder.format

    @property
    def sensor(self) -> tuple[int, int] | None:
        """(width, height) in pixels; None: events of any pixel are handed on."""
        return self._decoder.sensor

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    @property
    def counts(self) -> NetworkCounts:
        """Counts up to now."""
        decoder, clock = self._decoder, self._decoder.clock
        return NetworkCounts(
            self._datagrams,
            self._bytes,
            self._events,
            self._cut + decoder.malformed,
            clock.late,
            self._read_lost(),
            clock.jumped,
            decoder.off_sensor,
            clock.restarts,
        )

    def _read_lost(self) -> int | None:
        """The system's count; once the socket is closed, the last one."""
        lost = lost_datagrams(self._socket)
        self._lost = self._lost if lost is None else lost
        return self._lost

    def summary(self) -> str:
        """The counts so far, in one line for people."""
        return self.counts.summary()

    def __repr__(self) -> str:
        state = "closed" if self._closed else "open"
        return f"UdpSource(udp://{self.address}:{self.port}?format={self.format}, {state}, {self.counts})"

    # -- packets -----------------------------------------------------------------------------------------

    def receive(self, timeout_s: float | None = None) -> np.ndarray | None:
        """The next packet; None if none came within `timeout_s` (None: wait forever) or the source was closed."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        spin_ns = round(self.spin_us * 1000)
        most = MOST_DATAGRAMS
        with self._reading:
            while not self._closed:
                events = self._drain(most)
                if events is not None:
                    return events
                if spin_ns:
                    spin_until = time.monotonic_ns() + spin_ns
                    while time.monotonic_ns() < spin_until and not self._closed:
                        if (events := self._drain(1)) is not None:
                            return events
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._waiter.wait(left)
                # The datagram that ended the sleep is handed over alone: asking for more takes as long as a plain
                # `recv`, once its data have left the processor's caches. The next call reads all the others.
                most = 1
        return None

    def __iter__(self) -> Iterator[np.ndarray]:
        while (events := self.receive(self.timeout_s)) is not None:
            yield events

    async def __aiter__(self) -> AsyncIterator[np.ndarray]:
        """Cancelling the task that waits here closes the source."""
        try:
            while not self._closed:
                with self._reading:
                    events = self._drain(MOST_DATAGRAMS)
                if events is None:
                    if self._closed or not await self._waiter.wait_in_task(self.timeout_s, self._wait):
                        return
                    continue
                yield events
                await asyncio.sleep(0)  # a sender that never pauses must not keep other tasks from running
        except asyncio.CancelledError:
            self.close()
            raise
        finally:
            if self._closed:
                self._release()

    def _wait(self, timeout_s: float | None) -> None:
        with self._reading:
            if not self._closed:
                self._waiter.wait(timeout_s)

    def _drain(self, most: int) -> np.ndarray | None:
        """All waiting datagrams, up to the limits, as one packet; None if there is no event in it."""
        size = self._decoder.event_bytes
        memory, filled, n_datagrams, started_ns = self._memory, 0, 0, self._started_ns
        ends, arrivals, most = self._ends, self._arrivals, min(most, self.max_datagrams, len(self._ends))
        receive_into, clock = self._socket.recv_into, time.monotonic_ns
        try:
            while n_datagrams < most and filled + ROOM <= BATCH_BYTES:
                n = receive_into(memory[filled:])
                self._bytes += n
                n_whole = n // size  # the next one goes where whole events end
                self._cut += n_whole * size != n
                filled += n_whole * size
                ends[n_datagrams] = filled // size
                arrivals[n_datagrams] = (clock() - started_ns) // 1000
                n_datagrams += 1
        except BlockingIOError:
            pass
        except OSError as error:
            if self._socket.fileno() == -1 or error.errno == errno.EBADF:
                return None
            # Windows also reports a datagram that was too long, and an answer that was refused
        if not n_datagrams:
            return None
        events = self._decoder.decode_datagrams(self._raw, self._ends_seen, self._arrivals_seen, n_datagrams)
        self._datagrams += n_datagrams
        self._events += len(events)
        if not self._events and not self._has_warned and self._decoder.malformed >= WARN_AFTER:
            self._has_warned = True
            log.warning("udp://%s:%s: %s", self.address, self.port, self._why_no_events())
        return events if len(events) else None

    def _why_no_events(self) -> str:
        """Possible reasons why all events so far are malformed."""
        decoder = self._decoder
        others = decoder.malformed - decoder.off_sensor
        reasons = []
        if decoder.off_sensor and decoder.sensor is not None:
            width, height = decoder.sensor
            reasons.append(f"{decoder.off_sensor:,} lie off {width}x{height} pixels: is the camera larger?")
        if others:
            reasons.append(f"{others:,} are not valid {decoder.format}: does the sender use another (?format=...)?")
        return f"none of the first {decoder.malformed:,} events can be used; {' '.join(reasons)}"

    # -- the end -----------------------------------------------------------------------------------------

    def close(self) -> None:
        """Stop listening and end every iteration, from any thread; counts stay. May be called again."""
        if self._closed:
            return
        self._read_lost()
        self._closed = True
        self._waiter.wake()
        if not self._waiter.in_task:  # otherwise the task does it, once its event loop has let go of the socket
            self._release()

    def _release(self) -> None:
        with self._reading:  # a thread that waited has been woken
            self._socket.close()
            self._waiter.close()

    def __enter__(self) -> UdpSource:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    async def __aenter__(self) -> UdpSource:
        return self

    async def __aexit__(self, *error: Any) -> None:
        self.close()

    def __del__(self) -> None:
        if hasattr(self, "_waiter"):
            self.close()
            self._release()


def open_udp(url: str, sensor: tuple[int, int] | None = None, **settings: Any) -> UdpSource:
    """A `UdpSource` of a `url`, udp://HOST:PORT[?format=...&timeout_s=...]; `sensor` and `settings` are its arguments.

    Raises
    ------
    ValueError : not such a URL; the message says what is wrong.
    OSError : the address is not this machine's, or taken.
    """
    host, port, format, timeout_s = parse_udp_url(url)
    return UdpSource(host, port, format, sensor, **{"timeout_s": timeout_s, **settings})
