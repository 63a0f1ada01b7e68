"""Ports for the tests: a free one, and one with a listener."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np

from async_tnt.sources import encode


def free_port(kind=socket.SOCK_DGRAM) -> int:
    """A port of the loopback interface without a listener."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for_listener(port: int, patience_s: float = 60.0) -> None:
    """Wait until a process listens for datagrams at a port; it receives an empty one.

    Binding the port would show a listener, too, but might take the port away from it.
    """
    deadline = time.monotonic() + patience_s
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("127.0.0.1", port))
        probe.settimeout(0.1)
        while time.monotonic() < deadline:
            try:
                probe.send(b"")
                probe.recv(1)
            except TimeoutError:  # it was not refused
                return
            except ConnectionError:
                time.sleep(0.01)
    raise TimeoutError(f"no listener at port {port} after {patience_s} s")


@contextlib.contextmanager
def sent(events: np.ndarray) -> Iterator[int]:
    """A port to which the events are sent once somebody listens.

    The block does not end before all of them have been sent.
    """
    port = free_port()
    sender = threading.Thread(target=send_in_parts, args=(port, events), daemon=True)
    sender.start()
    yield port
    sender.join()


def send_in_parts(port: int, events: np.ndarray, n_parts: int = 40, pause_s: float = 0.002) -> None:
    """Send events once there is a listener: what is sent before is lost."""
    wait_for_listener(port)
    for part in np.array_split(events, n_parts):
        send(port, part)
        time.sleep(pause_s)


def send(
    port: int, events: np.ndarray, format: str = "t64_x16_y16_on8", datagram_events: int = 100
) -> int:
    """Send events in as many datagrams as they need, and return the number of datagrams."""
    firsts = range(0, len(events), datagram_events)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for first in firsts:
            data = encode(events[first : first + datagram_events], format)
            sender.sendto(data, ("127.0.0.1", port))
    return len(firsts)
