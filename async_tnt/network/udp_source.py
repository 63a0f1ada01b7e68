"""Events from the network as a source of packets, for `stream` and for `astream`."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import selectors
import socket
import struct
import sys
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .datagrams import Decoder
from .url import checked_timeout, parse_udp_url, resolve

ROOM = 1 << 16  # more than any datagram: none is ever cut off
BATCH_BYTES = 1 << 18
_SO_MEMINFO = 55  # Linux 4.12 and newer: nine u32, the last one counts drops
_MEMINFO = struct.Struct("=9I")

log = logging.getLogger("async_tnt.network")


@dataclass(frozen=True)
class NetworkCounts:
    """What has come so far."""

    datagrams: int
    bytes: int
    events: int
    """Handed on."""
    malformed: int
    """Left out: cut off, off the sensor, polarity or time impossible."""
    late: int
    """Handed on, but older than one before: the network or the sender changed their order."""
    lost: int | None
    """Datagrams that the system threw away, mostly because its buffer was full; None where it does not say."""


class UdpSource:
    """Listens for datagrams of events.

    Iterating (`for` or `async for`) yields packets: structured arrays of `EVENT_DTYPE`, never empty, each of all
    datagrams that were waiting. It ends when `close` is called, from any thread, or after `timeout_s` of silence.
    Outside data never raises: what is no event is counted, see `counts`.

    Parameters
    ----------
    address, port : what to listen at; this machine alone by default. Anybody who reaches the port can send. Port 0
        takes a free one: read `port`.
    format : one of `async_tnt.network.EVENT_BYTES`.
    sensor : (width, height) in pixels; events beyond it are malformed. None: all are handed on.
    buffer_bytes : asked of the system for datagrams that wait. If it gives less, `advice` says so, and so does the
        log `async_tnt.network`.
    timeout_s : silence, in seconds, after which iterating ends; None waits for ever.
    max_datagrams : of one packet.

    Raises
    ------
    OSError : the address is not this machine's, or taken.
    ValueError : a setting out of range.

    Examples
    --------
    >>> from async_tnt import EVENT_DTYPE
    >>> from async_tnt.network import UdpSender
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
    ) -> None:
        if not 0 <= port < 1 << 16:
            raise ValueError(f"`port` must be in [0, 65535], got {port}")
        if not 1 <= buffer_bytes < 1 << 30:
            raise ValueError(f"`buffer_bytes` must be in [1, 2**30), got {buffer_bytes}")
        if max_datagrams < 1:
            raise ValueError(f"`max_datagrams` must be at least 1, got {max_datagrams}")
        self.timeout_s = None if timeout_s is None else checked_timeout(timeout_s)
        self.max_datagrams = max_datagrams
        self._decoder = Decoder(format, sensor)
        self._memory = memoryview(bytearray(BATCH_BYTES))
        self._datagrams = self._bytes = self._events = self._malformed = self._late = 0
        self._newest_us = -1
        self._started_ns = time.monotonic_ns()
        self._lost: int | None = None
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Future]] = set()
        self._closed = False
        family, where = resolve(address, port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind(where)
            self.buffer_bytes = _ask_for_buffer(self._socket, buffer_bytes)
            self._wake_out, self._wake_in = socket.socketpair()  # lets `close` end a wait in another thread
            self._selector = selectors.DefaultSelector()
            self._selector.register(self._socket, selectors.EVENT_READ, "datagram")
            self._selector.register(self._wake_out, selectors.EVENT_READ, "close")
        except OSError as error:
            self._socket.close()
            raise OSError(error.errno, error.strerror, f"udp://{address}:{port}") from None
        self.address, self.port = self._socket.getsockname()[:2]
        self.advice: str | None = None
        if self.buffer_bytes < buffer_bytes:
            self.advice = (
                f"the system gives {self.buffer_bytes:,} bytes for waiting datagrams of the {buffer_bytes:,} asked "
                f"for; bursts may be lost (Linux: sudo sysctl net.core.rmem_max={buffer_bytes})"
            )
            log.warning("%s", self.advice)

    @property
    def format(self) -> str:
        return self._decoder.format

    @property
    def sensor(self) -> tuple[int, int] | None:
        return self._decoder.sensor

    @property
    def closed(self) -> bool:
        return self._closed

    @property
    def counts(self) -> NetworkCounts:
        """Counts up to now; `lost` is asked of the system at this moment."""
        self._read_lost()
        return NetworkCounts(self._datagrams, self._bytes, self._events, self._malformed, self._late, self._lost)

    def __repr__(self) -> str:
        state = "closed" if self._closed else "open"
        return f"UdpSource(udp://{self.address}:{self.port}?format={self.format}, {state}, {self.counts})"

    # -- packets -----------------------------------------------------------------------------------------

    def receive(self, timeout_s: float | None = None) -> np.ndarray | None:
        """The next packet; None if none came within `timeout_s` (None: wait for ever) or the source was closed."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._closed:
            events = self._drain()
            if events is not None:
                return events
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0:
                return None
            self._wait(left)
        return None

    def __iter__(self) -> Iterator[np.ndarray]:
        while (events := self.receive(self.timeout_s)) is not None:
            yield events

    async def __aiter__(self) -> AsyncIterator[np.ndarray]:
        """Cancelling the task that waits here closes the source."""
        try:
            while not self._closed:
                events = self._drain()
                if events is None:
                    if not await self._readable():
                        return
                    continue
                yield events
                await asyncio.sleep(0)  # a sender that never pauses must not keep other tasks from running
        except asyncio.CancelledError:
            self.close()
            raise

    async def _readable(self) -> bool:
        """Whether a datagram came before silence or the end."""
        loop = asyncio.get_running_loop()
        came: asyncio.Future[bool] = loop.create_future()
        descriptor = self._socket.fileno()
        try:
            loop.add_reader(descriptor, _settle, came, True)
        except NotImplementedError:  # Windows' default loop watches no sockets
            return await self._readable_by_thread()
        entry = (loop, came)
        self._waiting.add(entry)
        try:
            return await asyncio.wait_for(came, self.timeout_s)
        except TimeoutError:
            return False
        finally:
            self._waiting.discard(entry)
            loop.remove_reader(descriptor)
            if self._closed:
                self._socket.close()

    async def _readable_by_thread(self) -> bool:
        return await asyncio.to_thread(self._wait, self.timeout_s)

    def _wait(self, timeout_s: float | None) -> bool:
        """Wait for a datagram, for `close`, or so long; returns whether a datagram came."""
        return any(key.data == "datagram" for key, _ in self._selector.select(timeout_s)) and not self._closed

    def _drain(self) -> np.ndarray | None:
        """All that waits, up to the limits, as one packet; None if there is no event in it."""
        size = self._decoder.event_bytes
        memory, filled, n_datagrams = self._memory, 0, 0
        lengths, arrivals = [], []
        receive_into = self._socket.recv_into
        clock = time.monotonic_ns if self.format == "spif" else None
        try:
            while n_datagrams < self.max_datagrams and filled + ROOM <= BATCH_BYTES:
                n = receive_into(memory[filled:])
                n_datagrams += 1
                self._bytes += n
                n_whole = n // size * size  # the next one goes where whole events end
                self._malformed += n_whole != n
                filled += n_whole
                if clock:
                    lengths.append(n_whole // size)
                    arrivals.append((clock() - self._started_ns) // 1000)
        except BlockingIOError:
            pass
        except OSError as error:
            if self._socket.fileno() == -1 or error.errno == errno.EBADF:
                return None
            # Windows tells here of a datagram too long, or of an answer of ours that was refused: none of ours
        self._datagrams += n_datagrams
        if not filled:
            return None
        arrival_us = np.repeat(np.array(arrivals, np.int64), lengths) if clock else 0
        events, malformed = self._decoder.decode(memory[:filled], arrival_us)
        self._malformed += malformed
        if not len(events):
            return None
        self._events += len(events)
        t = np.ascontiguousarray(events["t"])
        if t[0] < self._newest_us or (t[1:] < t[:-1]).any():
            newest = np.maximum.accumulate(np.concatenate(([self._newest_us], t)))
            self._late += int((t < newest[:-1]).sum())
            self._newest_us = int(newest[-1])
        else:
            self._newest_us = int(t[-1])
        return events

    # -- the end -----------------------------------------------------------------------------------------

    def _read_lost(self) -> None:
        if self._closed or not sys.platform.startswith("linux"):
            return
        try:
            info = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        except OSError:
            return
        if len(info) == _MEMINFO.size:
            dropped = _MEMINFO.unpack(info)[8]
            before = self._lost or 0
            self._lost = before + (dropped - before) % (1 << 32)  # the system's counter has 32 bits

    def close(self) -> None:
        """Stop listening and end every iteration, from any thread; counts stay. Twice does no harm."""
        if self._closed:
            return
        self._read_lost()
        self._closed = True
        for loop, came in list(self._waiting):
            if not loop.is_closed():
                loop.call_soon_threadsafe(_settle, came, False)
        self._wake_in.close()  # the other end becomes readable
        if not self._waiting:  # an event loop must let go of a socket before its number is given to another one
            self._socket.close()

    def __enter__(self) -> UdpSource:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    async def __aenter__(self) -> UdpSource:
        return self

    async def __aexit__(self, *error: Any) -> None:
        self.close()

    def __del__(self) -> None:
        if hasattr(self, "_wake_in"):
            self.close()
            self._socket.close()
            self._wake_out.close()
        if hasattr(self, "_selector"):
            self._selector.close()


def open_udp(url: str, sensor: tuple[int, int] | None = None, **settings: Any) -> UdpSource:
    """A `UdpSource` of `udp://HOST:PORT[?format=...&timeout_s=...]`; `settings` are its keyword arguments.

    Raises
    ------
    ValueError : not such a URL; the message says what is wrong.
    OSError : the address is not this machine's, or taken.
    """
    host, port, format, timeout_s = parse_udp_url(url)
    return UdpSource(host, port, format, sensor, **{"timeout_s": timeout_s, **settings})


def _settle(came: asyncio.Future, value: bool) -> None:
    if not came.done():
        came.set_result(value)


def _ask_for_buffer(sock: socket.socket, n_bytes: int) -> int:
    """Ask for room for waiting datagrams; returns what there is."""
    with_overhead = 2 if sys.platform.startswith("linux") else 1  # Linux doubles what it is asked, and says the double
    before = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if before < n_bytes * with_overhead:
        with contextlib.suppress(OSError):  # BSD and macOS refuse what Linux cuts down
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, n_bytes)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // with_overhead
