"""UDP sockets: URLs and addresses, the receive buffer, lost datagrams, and waiting in threads and tasks."""

from __future__ import annotations

import asyncio
import contextlib
import math
import select
import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import NamedTuple
from urllib.parse import parse_qsl, urlsplit

from async_tnt.sources.datagrams import checked_format

LONGEST_S = 86_400.0  # of one wait: `poll` and `select` take no more than some days
_SO_MEMINFO = 55  # Linux 4.12 and newer: nine u32, the last one counts drops
_MEMINFO = struct.Struct("=9I")


class UdpUrl(NamedTuple):
    """udp://HOST:PORT[?format=...&timeout_s=...]"""

    host: str
    """Name or address of a machine."""
    port: int
    """Number of the port."""
    format: str
    """One of `EVENT_BYTES`."""
    timeout_s: float | None
    """Silence, in seconds, that ends the stream; None: waits forever."""


def parse_udp_url(url: str) -> UdpUrl:
    """Parse a `url`.

    Raises
    ------
    ValueError : not `udp://HOST:PORT`, an unknown option, or a wrong value; the message says which.

    Examples
    --------
    >>> parse_udp_url("udp://127.0.0.1:3333?format=spif")
    UdpUrl(host='127.0.0.1', port=3333, format='spif', timeout_s=None)
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:  # not a port number, or an unclosed bracket
        raise ValueError(f"{url}: {error}; expected udp://HOST:PORT") from None
    if parts.scheme != "udp" or not host or port is None or parts.path not in ("", "/") or "@" in parts.netloc:
        raise ValueError(f"{url}: expected udp://HOST:PORT, such as udp://127.0.0.1:3333")
    format, timeout_s = "t64_x16_y16_on8", None
    for name, value in parse_qsl(parts.query, keep_blank_values=True):
        try:
            if name == "format":
                format = checked_format(value)
            elif name == "timeout_s":
                timeout_s = checked_timeout(float(value))
            else:
                raise ValueError(f"unknown option {name!r}, expected format or timeout_s")
        except ValueError as error:
            raise ValueError(f"{url}: {error}") from None
    return UdpUrl(host, port, format, timeout_s)


def checked_timeout(timeout_s: float) -> float:
    if not (math.isfinite(timeout_s) and timeout_s > 0):
        raise ValueError(f"`timeout_s` must be a positive number of seconds, got {timeout_s}")
    return timeout_s


def resolve(host: str, port: int) -> tuple[int, tuple]:
    """Address family and socket address.

    Raises
    ------
    OSError : no such host.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError, OverflowError) as error:
        raise OSError(f"{host}:{port}: no such host or port ({error})") from None
    return family, address


def ask_for_buffer(sock: socket.socket, n_bytes: int) -> tuple[int, str | None]:
    """Ask the system for room for waiting datagrams.

    Returns
    -------
    int : how much there is, in bytes.
    str : advice for the user; None if this is enough.
    """
    with_overhead = 2 if sys.platform.startswith("linux") else 1  # Linux doubles the size asked for, and reports that
    before = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if before < n_bytes * with_overhead:
        with contextlib.suppress(OSError):  # BSD and macOS refuse what Linux cuts down
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, n_bytes)
    available = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // with_overhead
    if available >= n_bytes:
        return available, None
    return available, (
        f"the system gives {available:,} bytes for waiting datagrams of the {n_bytes:,} asked for; bursts may be lost "
        f"(Linux: sudo sysctl net.core.rmem_max={n_bytes})"
    )


def lost_datagrams(sock: socket.socket) -> int | None:
    """How many datagrams the system has dropped at a socket; None if it is closed, and where this is not reported."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        return int(_MEMINFO.unpack(sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[8])
    except (OSError, struct.error):  # closed, or an older system
        return None


class Waiter:
    """Waits for one socket. `wake` ends every wait, now and later, from any thread."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._woken = False
        self._tasks: set[asyncio.Future[bool]] = set()
        self._wake_out, self._wake_in = socket.socketpair()  # one end becomes readable when the other is closed
        self._poll: Callable[[float | None], list[tuple[int, int]]] | None = None
        if hasattr(select, "poll"):  # faster than `selectors`, which looks each event up in a dictionary
            poll = select.poll()
            poll.register(sock, select.POLLIN)
            poll.register(self._wake_out, select.POLLIN)
            self._poll = poll.poll

    def wait(self, timeout_s: float | None) -> None:
        """Sleep until there is something to read, `wake`, or the timeout (None: forever), but a day at most."""
        if timeout_s is not None:
            timeout_s = min(timeout_s, LONGEST_S)
        if self._poll is not None:
            self._poll(None if timeout_s is None else timeout_s * 1e3)
        else:  # Windows
            select.select([self._socket, self._wake_out], [], [], timeout_s)

    async def wait_in_task(self, timeout_s: float | None, wait: Callable[[float | None], None]) -> bool:
        """The same, while other tasks run; False after the timeout or `wake`.

        Parameters
        ----------
        wait : waits in a thread, for event loops that cannot watch sockets: Windows' default one.
        """
        loop = asyncio.get_running_loop()
        came: asyncio.Future[bool] = loop.create_future()
        self._tasks.add(came)  # first of all: a thread that calls `wake` from here on leaves the socket to this task
        try:
            if self._woken:
                return False
            descriptor = self._socket.fileno()
            try:
                loop.add_reader(descriptor, _settle, came, True)
            except NotImplementedError:
                return await self._wait_in_thread(timeout_s, wait)
            try:
                return await asyncio.wait_for(came, timeout_s)
            except TimeoutError:
                return False
            finally:
                loop.remove_reader(descriptor)
        finally:
            self._tasks.discard(came)  # last of all: from here on the socket may be closed

    async def _wait_in_thread(self, timeout_s: float | None, wait: Callable[[float | None], None]) -> bool:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        while left is None or left > 0:
            await asyncio.to_thread(wait, left)
            if self._woken:
                return False
            if select.select([self._socket], [], [], 0)[0]:
                return True
            left = None if deadline is None else deadline - time.monotonic()
        return False

    @property
    def in_task(self) -> bool:
        """Whether an event loop watches the socket, whose number must not be reused before that loop lets go of it."""
        return bool(self._tasks)

    def wake(self) -> None:
        self._woken = True
        for came in list(self._tasks):
            if not came.get_loop().is_closed():
                came.get_loop().call_soon_threadsafe(_settle, came, False)
        self._wake_in.close()

    def close(self) -> None:
        """Release the sockets of `wake`, when no thread or task waits any more."""
        self._wake_in.close()
        self._wake_out.close()


def _settle(came: asyncio.Future[bool], value: bool) -> None:
    if not came.done():
        came.set_result(value)
