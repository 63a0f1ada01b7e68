"""udp://HOST:PORT[?format=...&timeout_s=...]"""

from __future__ import annotations

import math
import socket
from typing import NamedTuple
from urllib.parse import parse_qsl, urlsplit

from async_tnt.sources.datagrams import checked_format


class UdpUrl(NamedTuple):
    """The parts of such a URL."""

    host: str
    port: int
    format: str
    timeout_s: float | None


def parse_udp_url(url: str) -> UdpUrl:
    """Take a URL apart.

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
    except ValueError as error:  # a port that is no number or beyond 65535, an open bracket
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
