"""The system's side of a socket: room for datagrams that wait, and how many found none."""

from __future__ import annotations

import contextlib
import socket
import struct
import sys

_SO_MEMINFO = 55  # Linux 4.12 and newer: nine u32, the last one counts drops
_MEMINFO = struct.Struct("=9I")


def ask_for_buffer(sock: socket.socket, n_bytes: int) -> int:
    """Ask for room for waiting datagrams; returns what there is, in bytes."""
    with_overhead = 2 if sys.platform.startswith("linux") else 1  # Linux doubles what it is asked, and says the double
    before = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if before < n_bytes * with_overhead:
        with contextlib.suppress(OSError):  # BSD and macOS refuse what Linux cuts down
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, n_bytes)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // with_overhead


def buffer_advice(n_bytes: int, wanted_bytes: int) -> str | None:
    """What to tell a user who got less than was asked for; None if it was enough."""
    if n_bytes >= wanted_bytes:
        return None
    return (
        f"the system gives {n_bytes:,} bytes for waiting datagrams of the {wanted_bytes:,} asked for; bursts may be "
        f"lost (Linux: sudo sysctl net.core.rmem_max={wanted_bytes})"
    )


class LostDatagrams:
    """How many datagrams the system threw away at one socket. None until it said so, and where it never does."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._lost: int | None = None

    def read(self) -> int | None:
        """Ask the system now; of a closed socket, what it said last."""
        if not sys.platform.startswith("linux"):
            return None
        try:
            info = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        except OSError:  # closed, or an older system
            return self._lost
        if len(info) == _MEMINFO.size:
            before = self._lost or 0
            self._lost = before + (_MEMINFO.unpack(info)[8] - before) % (1 << 32)  # the system's counter has 32 bits
        return self._lost
