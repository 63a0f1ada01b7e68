"""Prophesee's DAT files (`.dat`): eight bytes an event, after a header.

    byte 0 and 1 after the header    type of events (0x00 and 0x0C: pixels), size of one: 8
    then, little-endian              t: 32 bits of microseconds
                                     version 2: x: 14 bits, y: 14, p: 4;  version 1: x: 9, y: 8, p: 1, unused: 14

The clock of 32 bits starts anew after 71.6 minutes; times are unwrapped.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from async_tnt.sources.files.damage import Damage
from async_tnt.sources.files.prophesee_header import PropheseeHeader
from async_tnt.sources.files.source import BLOCK_EVENTS, Source, packed
from async_tnt.sources.files.time_wraps import unwrapped

EVENT_BYTES = 8
PERIOD_US = 1 << 32
PIXEL_EVENTS = (0x00, 0x0C)
FIELDS = {"2": ((0, 14), (14, 14), (28, 4)), "1": ((0, 9), (9, 8), (17, 1))}  # x, y, p: first bit, bits


class DatSource(Source):
    """The events of a DAT file.

    Raises
    ------
    ValueError : unknown version, other than pixel events, or a file that ends before the first event.
    """

    def __init__(self, path: Path) -> None:
        header = PropheseeHeader(path)
        version = header.fields.get("version", "2")
        if version not in FIELDS:
            raise ValueError(f"{path}: the header's Version must be 1 or 2, got {version!r}")
        with path.open("rb") as file:
            file.seek(header.length)
            kind = file.read(2)
        if len(kind) < 2 or kind[0] not in PIXEL_EVENTS or kind[1] != EVENT_BYTES:
            raise ValueError(
                f"{path}: after the header there must be a type of events, 0 or 12, and their size, 8; got {list(kind)}"
            )
        self.path = path
        self.sensor = header.sensor
        self._fields = FIELDS[version]
        self._start = header.length + 2
        self._t0_us = header.t0_us

    def blocks(self) -> Iterator[np.ndarray]:
        time = -1
        n_read = 0
        with self.path.open("rb") as file:
            file.seek(self._start)
            while chunk := file.read(BLOCK_EVENTS * EVENT_BYTES):
                words = np.frombuffer(chunk, "<u4", len(chunk) // EVENT_BYTES * 2).reshape(-1, 2)
                t, time = unwrapped(words[:, 0], time, PERIOD_US)
                x, y, p = (words[:, 1] >> first & (1 << bits) - 1 for first, bits in self._fields)
                events, problem = packed(t + self._t0_us, x, y, p)
                yield events
                n_read += len(events)
                if problem is not None:
                    raise Damage(f"event {n_read} (byte {self._start + n_read * EVENT_BYTES}): {problem}")
                if len(chunk) % EVENT_BYTES:
                    raise Damage(f"the file ends {len(chunk) % EVENT_BYTES} bytes into event {n_read}, which has 8")


def open_dat(path: Path) -> Source:
    """Open a DAT file of Prophesee's."""
    return DatSource(path)
