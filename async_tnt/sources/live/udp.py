"""Events from the network: `open_udp` and `UdpSource` listen for datagrams."""

from __future__ import annotations

import contextlib
import errno
import logging
import selectors
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from async_tnt.base.checks import ParameterValueError, whole_number
from async_tnt.sources.live.datagrams import Decoder

ROOM = 1 << 16
"""Bytes of memory for the next datagram. No datagram is larger, so none is ever cut off."""

BATCH_BYTES = 1 << 18
"""Bytes of memory for the datagrams that are read together."""

MAX_DATAGRAMS = 64
"""The most datagrams in one packet."""

WARN_AFTER = 1000
"""Number of malformed events, without a single good one, after which a warning names possible
reasons."""

LONGEST_S = 1e6
"""Seconds of the longest wait, because the system sleeps for no longer than some weeks."""

log = logging.getLogger("async_tnt.sources")


@dataclass(frozen=True)
class NetworkCounts:
    """What a `UdpSource` has received so far, in numbers."""

    datagrams: int
    """Datagrams received."""
    bytes: int
    """Bytes of all datagrams received."""
    events: int
    """Events handed on."""
    malformed: int
    """Events left out: cut off, off the sensor, with an impossible polarity or time, or with a time
    that jumps."""
    late: int
    """Events handed on that are older than an event before them: the network or the sender has
    changed their order."""
    jumped: int = 0
    """Malformed events with a time that jumps, see `Clock`."""
    off_sensor: int = 0
    """Malformed events off the sensor."""
    clock_restarts: int = 0
    """Times that the sender's clock moved back; times continue, see `Clock`."""


class UdpSource(contextlib.AbstractContextManager["UdpSource"]):
    """A listener for datagrams of events.

    Iterating yields packets: structured arrays of `EVENT_DTYPE`, never empty. A packet has the
    events of the datagrams that were waiting, 64 at most, or of the datagram that ended a wait.
    Iterating ends when `close` is called, from any thread, or after `timeout_s` without a valid
    event. Invalid events never raise; they are dropped, see `counts`. One thread iterates at a
    time; asyncio reads the source through a `BackgroundReader`.

    Parameters
    ----------
    address, port : where to listen; by default only this machine can send. With port 0 the system
        chooses a free port: the attribute `port` has its number.
    format : `t64_x16_y16_on8`, `t32_x16_y15_on1`, `spif` or `spif_t32`, see `encode`.
    sensor : (width, height) in pixels; events beyond it are malformed. None: all are handed on.
    buffer_bytes : bytes of the receive buffer to ask the system for; the attribute of this name has
        what the system gives.
    timeout_s : seconds without a valid event, below 1e6, after which iterating ends; None waits
        forever.
    max_jump_s : parameter of the stream's `Clock`, which drops events whose time jumps, and
        continues the times of a sender that starts again. None: every time is trusted.

    Raises
    ------
    OSError : the address is not this machine's, or taken.
    ParameterValueError : a setting is out of range.

    Examples
    --------
    >>> from async_tnt import EVENT_DTYPE
    >>> from async_tnt.sources import encode
    >>> sender = socket.socket(type=socket.SOCK_DGRAM)
    >>> data = encode(np.array([(258, 3, 4, 1)], EVENT_DTYPE))
    >>> with sender, UdpSource(port=0, timeout_s=1) as source:
    ...     _ = sender.sendto(data, (source.address, source.port))
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
        max_jump_s: float | None = 10.0,
    ) -> None:
        port = whole_number("port", port, 0, 1 << 16)
        buffer_bytes = whole_number("buffer_bytes", buffer_bytes, 1, 1 << 30, "in [1, 2**30)")
        if timeout_s is not None and not 0 < timeout_s < LONGEST_S:
            rule = f"must be a positive number of seconds below {LONGEST_S:g}"
            raise ParameterValueError("timeout_s", rule, timeout_s)
        self.timeout_s = timeout_s
        self.format = format
        self.sensor = sensor
        # The socket comes before the decoder, which may have to be compiled. So the error of an
        # address that is taken comes at once.
        self._socket = _bound_socket(address, port)
        try:
            self._decoder = Decoder(format, sensor, max_jump_s)
        except BaseException:
            self._socket.close()
            raise
        self._memory = memoryview(bytearray(BATCH_BYTES))
        self._raw = np.frombuffer(self._memory, np.uint8)  # the decoder's view of the memory
        self._datagrams = 0
        self._bytes = 0
        self._events = 0
        self._cut = 0  # number of datagrams that ended within an event
        self._started_ns = time.monotonic_ns()
        self._closed = False
        self._has_warned = False
        # Held while a thread reads or waits, so that `close` does not free the socket's number
        # meanwhile: the system may give it to another socket. Re-entrant: a signal handler may
        # close, too.
        self._reading = threading.RLock()
        self.address, self.port = self._socket.getsockname()[:2]
        with contextlib.suppress(OSError):  # BSD and macOS refuse a size that Linux reduces
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
        factor = 2 if sys.platform.startswith("linux") else 1  # Linux doubles what is asked for
        self.buffer_bytes = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // factor
        # `_wake_out` becomes readable when `_wake_in` is closed
        self._wake_out, self._wake_in = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._selector.register(self._wake_out, selectors.EVENT_READ)

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    @property
    def counts(self) -> NetworkCounts:
        """The counts so far."""
        decoder = self._decoder
        return NetworkCounts(
            datagrams=self._datagrams,
            bytes=self._bytes,
            events=self._events,
            malformed=self._cut + decoder.malformed,
            late=decoder.clock.late,
            jumped=decoder.clock.jumped,
            off_sensor=decoder.off_sensor,
            clock_restarts=decoder.clock.restarts,
        )

    @property
    def name(self) -> str:
        """The address of the source, udp://HOST:PORT, with the port that it got."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        return f"udp://{host}:{self.port}"

    def summary(self) -> str:
        """The counts so far, in one line for people."""
        counts = self.counts
        kinds = f"{counts.jumped:,} of them time jumps, " if counts.jumped else ""
        kinds += f"{counts.off_sensor:,} of them off the sensor, " if counts.off_sensor else ""
        restarts = f", clock restarts: {counts.clock_restarts:,}" if counts.clock_restarts else ""
        return (
            f"{counts.datagrams:,} datagrams, {counts.events:,} events ({counts.malformed:,} "
            f"malformed, {kinds}{counts.late:,} out of order{restarts})"
        )

    def __repr__(self) -> str:
        state = "closed" if self._closed else "open"
        url = f"udp://{self.address}:{self.port}?format={self.format}"
        return f"UdpSource({url}, {state}, {self.counts})"

    # -- packets -----------------------------------------------------------------------------------

    def receive(self, timeout_s: float | None = None) -> np.ndarray | None:
        """The next packet; None if none came in time, or the source was closed.

        Parameters
        ----------
        timeout_s : seconds to wait; None: forever.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        n_most = MAX_DATAGRAMS
        with self._reading:
            while not self._closed:
                events = self._drain(n_most)
                if events is not None:
                    return events
                left_s = None if deadline is None else deadline - time.monotonic()
                if left_s is not None and left_s <= 0:
                    return None
                with contextlib.suppress(OSError, ValueError):  # a signal handler closed the source
                    self._selector.select(left_s)
                # After a sleep, one call of `recv` is made, and its datagram is handed over alone.
                # A second call would only find that no datagram waits, but it would take as long as
                # the first, because what `recv` needs has left the processor's caches. If others
                # wait, the next call of `receive` reads them.
                n_most = 1
        return None

    def __iter__(self) -> Iterator[np.ndarray]:
        events = self.receive(self.timeout_s)
        while events is not None:
            yield events
            events = self.receive(self.timeout_s)

    def _drain(self, n_most: int) -> np.ndarray | None:
        """Up to `n_most` waiting datagrams as one packet; None if there is no event in it."""
        size = self._decoder.event_bytes
        memory = self._memory
        receive_into = self._socket.recv_into
        now_ns = time.monotonic_ns
        ends: list[int] = []
        arrivals: list[int] = []
        filled = 0
        try:
            while len(ends) < n_most and filled + ROOM <= BATCH_BYTES:
                n = receive_into(memory[filled:])
                self._bytes += n
                n_whole = n // size
                if n_whole * size != n:
                    self._cut += 1
                filled += n_whole * size  # the next datagram goes behind the last whole event
                ends.append(filled // size)
                arrivals.append((now_ns() - self._started_ns) // 1000)
        except BlockingIOError:
            pass
        except OSError as error:
            if self._socket.fileno() == -1 or error.errno == errno.EBADF:
                return None
            # Windows also reports a datagram that was too long, or an answer that was refused. The
            # source goes on then.
        if not ends:
            return None
        events = self._decoder.decode_datagrams(self._raw, ends, arrivals)
        self._datagrams += len(ends)
        self._events += len(events)
        if not self._events and not self._has_warned and self._decoder.malformed >= WARN_AFTER:
            self._warn()
        return events if len(events) else None

    def _warn(self) -> None:
        """Log why no event may be usable, once."""
        self._has_warned = True
        log.warning(
            "udp://%s:%s: none of the first %s events can be used, %s of them lie off the sensor; "
            "does the sender use another format than %s (?format=...), or a larger camera?",
            self.address,
            self.port,
            self._decoder.malformed,
            self._decoder.off_sensor,
            self.format,
        )

    # -- the end -----------------------------------------------------------------------------------

    def close(self) -> None:
        """Stop listening and end every iteration, from any thread; counts stay.

        May be called again.
        """
        self._closed = True
        self._wake_in.close()
        with self._reading:  # a thread that waited has been woken
            self._selector.close()
            self._socket.close()
            self._wake_out.close()

    def __exit__(self, *error: Any) -> None:
        self.close()


def open_udp(url: str, sensor: tuple[int, int] | None = None) -> UdpSource:
    """Open a `UdpSource` by its URL.

    Parameters
    ----------
    url : udp://HOST:PORT[?format=...&timeout_s=...].
    sensor : (width, height), as for `UdpSource`.

    Raises
    ------
    ValueError : the URL is not such a URL; the message says what is wrong.
    OSError : the address is not this machine's, or taken.
    """
    try:
        parts = urlsplit(url)
        host = parts.hostname
        port = parts.port
        is_plain = parts.path in ("", "/") and "@" not in parts.netloc
        if parts.scheme != "udp" or not host or port is None or not is_plain:
            raise ValueError("expected udp://HOST:PORT, such as udp://127.0.0.1:3333")
        options: dict[str, Any] = dict(parse_qsl(parts.query, keep_blank_values=True))
        unknown = options.keys() - {"format", "timeout_s"}
        if unknown:
            raise ValueError(f"unknown option {min(unknown)!r}, expected format or timeout_s")
        if "timeout_s" in options:
            options["timeout_s"] = float(options["timeout_s"])
        return UdpSource(host, port, sensor=sensor, **options)
    except ValueError as error:
        raise ValueError(f"{url}: {error}") from None


def _bound_socket(address: str, port: int) -> socket.socket:
    """A socket that does not block, bound to an address.

    Raises
    ------
    OSError : there is no such host, or its address cannot be used.
    """
    try:
        addresses = socket.getaddrinfo(address, port, type=socket.SOCK_DGRAM)
        family, _, _, _, socket_address = addresses[0]
    except (OSError, UnicodeError, OverflowError) as error:
        raise OSError(f"{address}:{port}: no such host or port ({error})") from None
    listener = socket.socket(family, socket.SOCK_DGRAM)
    try:
        listener.setblocking(False)
        listener.bind(socket_address)
    except OSError as error:
        listener.close()
        raise OSError(error.errno, error.strerror, f"udp://{address}:{port}") from None
    return listener
