"""Ports for the tests: a free one, and knowing when somebody listens there."""

from __future__ import annotations

import socket
import time

import numpy as np

from async_tnt.sources.udp_sender import UdpSender


def free_port(kind=socket.SOCK_DGRAM) -> int:
    """One of this machine alone that nobody listens at."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for_listener(port: int, patience_s: float = 60.0) -> None:
    """Until somebody listens for datagrams there. Who listens gets an empty one.

    To try and bind the port would tell, too, but now and then take it away from the one who is about to.
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
    raise TimeoutError(f"nobody listens at port {port} after {patience_s} s")


def send_in_parts(port: int, events: np.ndarray, n_parts: int = 40, pause_s: float = 0.002) -> None:
    """Send once somebody listens: what comes before is lost."""
    wait_for_listener(port)
    with UdpSender(port=port) as sender:
        for part in np.array_split(events, n_parts):
            sender.send(part)
            time.sleep(pause_s)
