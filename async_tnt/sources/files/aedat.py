"""AEDAT files (`.aedat`) of jAER, version 2.0, and of cAER, version 3.1.

Version 4 is another format, which `read_aedat4` of `library_readers.py` reads.

All begin with lines of text: `#!AER-DAT2.0` or `#!AER-DAT3.1`, then lines that begin with `#`, each
ended by \\r\\n.

2.0   After the header: events, big-endian, an address and a time in microseconds of 32 bits each.
      The meaning of an address depends on the camera, which `# AEChip:` names. A file that names no
      camera comes from a DVS128, or from a part of the sensor of a DVS128.

          DVS128   bit 0: 0 is ON; 1-7: x; 8-14: y; 15: not a pixel
          DAVIS    bit 10: not a pixel; 11: polarity; 12-21: x; 22-30: y; 31: of a frame

      Addresses count x from the right and y from the bottom (jAER, DavisBaseCamera and DVS128):
      both are mirrored here. If a file names no camera, its addresses are read as addresses of a
      DVS128, and are not mirrored. But if the caller states the size of a DAVIS, they are read
      as addresses of this DAVIS, as v2e writes them. The clock wraps after 71.6 minutes; times are
      unwrapped.

3.1   The header ends with `#!END-HEADER` and has a line such as `#Source 1: DVS128`. After it:
      packets, little-endian, a header of 28 bytes and then events. The header has

          16 bits each   type, source
          32 bits each   size of an event, place of the time in it, overflows of the clock,
                         capacity, events, valid events

      and type 1 has pixels' events:

          32 bits        0: valid; 1: polarity; 2-16: y; 17-31: x
          31 bits        time, to which each overflow adds 2**31 us

References
----------
iniVation, AEDAT file formats: versions 2.0 and 3.1.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from async_tnt.kernels.sources.evt import unwrap_times
from async_tnt.sources.files.source import (
    BLOCK_EVENTS,
    CorruptData,
    ReadOptions,
    Source,
    is_text,
    valid_events,
)
from async_tnt.volume.sensor import Sensor

SENSORS: dict[str, Sensor] = {
    "DVS128": (128, 128),
    "TMPDIFF128": (128, 128),
    "DAVIS128": (128, 128),
    "DAVIS208": (208, 192),
    "DAVIS240": (240, 180),
    "DAVIS346": (346, 260),
    "DAVIS640": (640, 480),
}
"""Name of a camera, in capitals, without the letter of a version -> its pixels."""
DAVIS_SIZES = {
    size: name
    for name, size in SENSORS.items()
    if name.startswith("DAVIS") and size != SENSORS["DVS128"]
}
"""(width, height) -> the DAVIS with this sensor; a sensor of 128x128 belongs to a DVS128."""

EVENT_BYTES = 8
"""Bytes of a pixel's event, in both versions."""

PACKET_HEADER_BYTES = 28
"""Bytes of the header of a packet, in version 3.1."""

POLARITY_PACKET = 1
"""Type of the packets that hold pixels' events, in version 3.1."""

MAX_LINE_BYTES = 1 << 16
"""Bytes of the longest line of a header."""

MAX_LINES = 4096
"""Lines of the longest header."""

PERIOD_US = 1 << 32
"""Microseconds after which the clock of version 2.0 wraps."""


class Aedat2Source(Source):
    """The pixels' events of an AEDAT 2.0 file."""

    format = "AEDAT 2.0"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        camera, self._start = _read_header(path, rb"#\s*AEChip:\s*(\S+)", None)
        self.sensor = SENSORS.get(camera)
        if not camera:
            camera = DAVIS_SIZES.get(options.sensor, "") if options.sensor else ""
            self.sensor_hint = (
                f"addresses are read as those of a {camera or 'DVS128'}, as the header names no "
                "other camera; if it is of a DAVIS, a header line such as `# AEChip: DAVIS346` or "
                "its size as {sensor} says so"
            )
        self._davis: Sensor | None = SENSORS[camera] if camera.startswith("DAVIS") else None

    def blocks(self) -> Iterator[np.ndarray]:
        newest_us = np.int64(-1)
        with self.path.open("rb") as file:
            file.seek(self._start)
            while data := file.read(BLOCK_EVENTS * EVENT_BYTES):
                address, t = _pairs(data, ">u4")
                newest_us = np.int64(unwrap_times(t, newest_us, np.int64(PERIOD_US)))
                x, y, p, is_pixel = self._pixels(address)
                # no problem can be found: unwrapped times and polarities of one bit are valid
                events, _ = valid_events(t[is_pixel], x[is_pixel], y[is_pixel], p[is_pixel])
                yield events
                n_left = len(data) % EVENT_BYTES
                if n_left:
                    raise CorruptData(
                        f"the file ends {n_left} bytes into an event, which has {EVENT_BYTES}"
                    )

    def _pixels(self, address: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The columns x, y and p of these addresses, and whether each is the address of a pixel.

        In an address of another camera, x or y is below 0.
        """
        if self._davis is not None:
            width, height = self._davis
            x = width - 1 - (address >> 12 & 0x3FF)
            y = height - 1 - (address >> 22 & 0x1FF)
            polarity = address >> 11 & 1
            is_pixel = address & 0x8000_0400 == 0
            return x, y, polarity, is_pixel
        # Without a named camera, x and y are not mirrored. n ^ 0x7F is 127 - n, and n ^ 0 is n.
        mirror = 0 if self.sensor is None else 0x7F
        x = np.where(address >> 16 == 0, (address >> 1 & 0x7F) ^ mirror, -1)
        y = (address >> 8 & 0x7F) ^ mirror
        polarity = 1 - (address & 1)
        is_pixel = address & 0x8000 == 0
        return x, y, polarity, is_pixel


class Aedat3Source(Source):
    """The pixels' events of an AEDAT 3.1 file, of all its sources."""

    format = "AEDAT 3.1"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        camera, self._start = _read_header(path, rb"#\s*Source\s+\d+:\s*(\S+)", b"#!END-HEADER")
        self.sensor = SENSORS.get(camera)

    def blocks(self) -> Iterator[np.ndarray]:
        with self.path.open("rb") as file:
            file.seek(self._start)
            while True:
                place = file.tell()
                head = file.read(PACKET_HEADER_BYTES)
                if not head:
                    return
                if len(head) < PACKET_HEADER_BYTES:
                    raise CorruptData(
                        f"the file ends {len(head)} bytes into the header of a packet, which has "
                        f"{PACKET_HEADER_BYTES}"
                    )
                kind, _, size, time_at, n_overflows, _, n_events, _ = struct.unpack("<2h6i", head)
                has_pixels = kind == POLARITY_PACKET
                # In an event of a pixel, the time lies at byte 4.
                is_damaged = min(kind, size, n_overflows, n_events) < 0
                if is_damaged or (has_pixels and (size, time_at) != (EVENT_BYTES, 4)):
                    raise CorruptData(
                        f"the packet at byte {place} has no valid header: type {kind}, {n_events} "
                        f"events of {size} bytes, time at byte {time_at}, {n_overflows} overflows"
                    )
                if has_pixels:
                    yield from _polarity_events(file, n_events, n_overflows)
                else:
                    _skip(file, n_events * size)


def _pairs(data: bytes, word: str) -> tuple[np.ndarray, np.ndarray]:
    """The first and the second word of each event, int64; bytes after the last event are ignored.

    Parameters
    ----------
    word : type of a word, of 32 bits.
    """
    n_events = len(data) // EVENT_BYTES
    words = np.frombuffer(data, word, 2 * n_events).astype(np.int64).reshape(-1, 2)
    return words[:, 0], np.ascontiguousarray(words[:, 1])


def _skip(file: BinaryIO, n_bytes: int) -> None:
    """Skip the events of a packet.

    Raises
    ------
    CorruptData : the file ends before the events do.
    """
    start = file.tell()
    end = file.seek(0, 2)
    if start + n_bytes > end:
        raise CorruptData(f"the file ends {end - start} bytes into a packet, which has {n_bytes}")
    file.seek(start + n_bytes)


def _polarity_events(file: BinaryIO, n_events: int, n_overflows: int) -> Iterator[np.ndarray]:
    """The valid events of one packet, block by block."""
    while n_events:
        place = file.tell()
        n = min(n_events, BLOCK_EVENTS)
        data = file.read(n * EVENT_BYTES)
        word, t = _pairs(data, "<u4")
        is_valid = word & 1 == 1
        word = word[is_valid]
        t = t[is_valid]
        t = np.where(t >> 31 == 0, t + (n_overflows << 31), -1)  # a negative time is not valid
        x = word >> 17
        y = word >> 2 & 0x7FFF
        polarity = word >> 1 & 1
        events, problem = valid_events(t, x, y, polarity)
        yield events
        if problem:
            raise CorruptData(f"in the packet around byte {place}: {problem}")
        if len(data) < n * EVENT_BYTES:
            n_left = n_events - len(data) // EVENT_BYTES
            raise CorruptData(f"the file ends within a packet, which has {n_left} more events")
        n_events -= n


def _read_header(path: Path, camera_line: bytes, end: bytes | None) -> tuple[str, int]:
    """The camera that the header names, and the bytes of the header.

    Parameters
    ----------
    camera_line : regular expression of the lines that name a camera.
    end : beginning of the header's last line; None: the header ends where lines no longer begin
        with #.

    Returns
    -------
    A key of `SENSORS`, or "" if the header names no camera; and the number of bytes.
    """
    names: list[str] = []
    with path.open("rb") as file:
        for _ in range(MAX_LINES):
            place = file.tell()
            line = file.readline(MAX_LINE_BYTES)
            if end is None and not _is_comment(line):
                return _camera(path, names), place
            match = re.match(camera_line, line)
            if match is not None:
                names.append(match[1].decode("ascii", "replace"))
            if end is not None and line.startswith(end):
                return _camera(path, names), file.tell()
            # the file ends, or this line is too long for a header
            if end is not None and not line.endswith(b"\n"):
                break
    how = f" by {end.decode()}" if end else ""
    raise ValueError(f"{path}: the header must end within {MAX_LINES} lines{how}")


def _is_comment(line: bytes) -> bool:
    """Whether a line is a comment.

    Events follow the comments without a mark between them, and their first byte may be a #.
    """
    return line.startswith(b"#") and line.endswith(b"\n") and is_text(line.rstrip(b"\r\n"))


def _camera(path: Path, names: list[str]) -> str:
    """The key of `SENSORS` that the first of these names contains; "" if there are no names.

    A name may be as long as `eu.seebetter.ini.chips.davis.DAVIS240C`. Only the part after its last
    dot is searched. Names that contain no key are skipped.

    Raises
    ------
    ValueError : there are names, but none of them contains a key.
    """
    cameras = []
    for name in names:
        last_part = name.rpartition(".")[2].upper()
        cameras += [camera for camera in SENSORS if camera in last_part]
    if names and not cameras:
        raise ValueError(
            f"{path}: the camera must be one of {', '.join(SENSORS)}, got {', '.join(names)[:80]!r}"
        )
    return cameras[0] if cameras else ""
