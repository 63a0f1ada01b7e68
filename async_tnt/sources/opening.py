"""Open any source: a recording, a camera or a stream from the network by its name, or an array."""

from __future__ import annotations

import os
from typing import Any

import numpy as np


def is_live(name: str) -> bool:
    """Whether `name` is a camera or a network stream rather than a file.

    Examples
    --------
    >>> [is_live(name) for name in ("udp://127.0.0.1:3333", "camera:davis346", "a.bin")]
    [True, True, False]
    """
    return "://" in name or name == "camera" or name.startswith("camera:")


def open_source(
    source: str | os.PathLike[str] | np.ndarray, sensor: tuple[int, int] | None = None
) -> Any:
    """Packets of events from a file, a camera, the network or memory.

    The packets can be given to `stream` and `Processor.push`.

    Parameters
    ----------
    source : path of a recording (see docs/reference.md), `camera[:KIND[:SERIAL]]` (docs/guide.md),
        `udp://HOST:PORT[?format=...]`, or a structured array of events.
    sensor : (width, height) of sources that do not state it. Events off it are left out and
        counted.

    Returns
    -------
    Iterable of packets: a `Recording`; a `Camera` or a `UdpSource`, which must be closed; or a list
    with the array.

    Raises
    ------
    ValueError : `source` is not the name of a source, or the file is damaged; the message says
        which of the two.
    OSError : the file is missing, the address is taken, or no camera is connected.
    ImportError : `source` is a camera, and the extra `cameras` is not installed.

    Example
    -------
    >>> from async_tnt import EVENT_DTYPE
    >>> open_source(np.array([(5, 3, 4, 1)], EVENT_DTYPE))[0].tolist()
    [(5, 3, 4, 1)]
    """
    if isinstance(source, np.ndarray):
        return [source]
    if not isinstance(source, str) or not is_live(source):
        from async_tnt.sources.files.recording import open_recording

        return open_recording(source, sensor=sensor)
    if source.startswith("camera"):
        from async_tnt.sources.live.cameras import open_camera

        return open_camera(source)
    from async_tnt.sources.live.udp import open_udp

    return open_udp(source, sensor)
