"""Send events over UDP: packets cut into datagrams."""

from __future__ import annotations

import socket
from typing import Any

import numpy as np

from async_tnt.checks import whole_number
from async_tnt.sources.datagrams import EVENT_BYTES, MAX_DATAGRAM_BYTES, checked_format, encode
from async_tnt.sources.udp_socket import resolve

PACKET_EVENTS = 100  # 1300 bytes of the longest format: fits Ethernet's 1500 with all headers


class UdpSender:
    """Sends events to one address, whether or not a program listens.

    Parameters
    ----------
    address, port : of the receiver.
    format : one of `async_tnt.sources.EVENT_BYTES`.
    packet_events : events of one datagram, at most.

    Attributes
    ----------
    events, datagrams, bytes : sent so far.
    refused : datagrams that the other machine or this one refused, mostly because no program listens.

    Raises
    ------
    ValueError : unknown format, or more events than a datagram can hold.
    OSError : no such host.
    """

    def __init__(
        self,
        address: str = "127.0.0.1",
        port: int = 3333,
        format: str = "t64_x16_y16_on8",
        *,
        packet_events: int = PACKET_EVENTS,
    ) -> None:
        most = MAX_DATAGRAM_BYTES // EVENT_BYTES[checked_format(format)]
        self.packet_events = whole_number("packet_events", packet_events, 1, most + 1, f"in [1, {most}] for {format}")
        port = whole_number("port", port, 1, 1 << 16)
        self.format = format
        self.events = self.datagrams = self.bytes = self.refused = 0
        family, where = resolve(address, port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.connect(where)  # so that a refusal is reported
        except OSError as error:
            self._socket.close()
            raise OSError(error.errno, error.strerror, f"udp://{address}:{port}") from None

    def send(self, events: np.ndarray) -> None:
        """Send `events`, a structured array, in as many datagrams as it needs.

        Raises
        ------
        ValueError : a coordinate too large for the format.
        """
        data = memoryview(encode(events, self.format))
        size = EVENT_BYTES[self.format]
        step = self.packet_events * size
        for first in range(0, len(data), step):
            datagram = data[first : first + step]
            if self._try_to_send(datagram):
                self.datagrams += 1
                self.bytes += len(datagram)
                self.events += len(datagram) // size

    def _try_to_send(self, datagram: memoryview) -> bool:
        for _ in range(2):
            try:
                self._socket.send(datagram)
                return True
            except ConnectionRefusedError:  # an earlier one was; this one has not gone out yet: try again
                self.refused += 1
            except OSError:  # the network is down, or its queue is full
                self.refused += 1
                break
        return False

    def close(self) -> None:
        """Close the socket. May be called again."""
        self._socket.close()

    def __enter__(self) -> UdpSender:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()
