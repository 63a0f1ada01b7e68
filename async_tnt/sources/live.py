"""Sources that send while one listens, by name: `udp://HOST:PORT`, `camera`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol


class LiveSource(Protocol):
    """What a camera or a network stream is to the program: packets until it is closed, and what was counted."""

    @property
    def sensor(self) -> tuple[int, int] | None:
        """(width, height) in pixels, where it is known."""

    def __iter__(self) -> Iterator[Any]:
        """Packets of events, in any form that `as_events` takes; ends after `close`."""

    def close(self) -> None:
        """Stop, from any thread; counts stay. Twice does no harm."""

    def summary(self) -> str:
        """What was counted so far, in one line for people."""


def is_live(name: str) -> bool:
    """Whether `name` is of a live source rather than of a file.

    Examples
    --------
    >>> is_live("udp://127.0.0.1:3333"), is_live("camera"), is_live("camera:davis346"), is_live("a.bin")
    (True, True, True, False)
    """
    return "://" in name or name == "camera" or name.startswith("camera:")


def open_live(name: str, sensor: tuple[int, int] | None = None) -> LiveSource:
    """Open `udp://HOST:PORT[?format=...]`, or `camera[:KIND[:SERIAL]]`, see docs/guide.md.

    Parameters
    ----------
    sensor : (width, height) that is expected; events off it are left out and counted.

    Raises
    ------
    ValueError : no such kind of source; the message says what is wrong.
    OSError : the address is taken, or no camera is there.
    ImportError : a camera without the extra `cameras`.
    """
    if name.startswith("camera"):
        from async_tnt.sources.camera_opening import open_camera

        return open_camera(name)
    from async_tnt.sources.udp import open_udp

    return open_udp(name, sensor)
