"""Event Stream files (`.es`), version 2, with DVS or ATIS events; of ATIS events, those of changing light.

    "Event Stream", version (3 bytes), type (1: DVS, 2: ATIS), width, height (2 bytes each, little-endian)
    then, each event: time since the one before, and polarity, in a byte; x, y in two bytes each
        DVS    bits 7-1 time, bit 0 polarity;  0xFF: 127 us pass;  0xFE: nothing
        ATIS   bits 7-2 time, bits 1-0 what (0: OFF, 2: ON, 1 and 3: an exposure);  0xFC + n: 63 n us pass

The format counts y from the bottom; here it counts from the top, as everywhere.

References
----------
Marcireau, event_stream: the format's specification, version 2.0.0.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from async_tnt.events import structured
from async_tnt.kernels.es import ATIS, DVS, ES_TYPES, decode_es
from async_tnt.kernels.jit import compile_only
from async_tnt.sources.files.source import BLOCK_EVENTS, CorruptData, Source, block_columns

MAGIC = b"Event Stream"
HEADER_BYTES = 20


class EsSource(Source):
    """The events of an Event Stream file."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            header = file.read(HEADER_BYTES)
        if not header.startswith(MAGIC) or len(header) < HEADER_BYTES:
            raise ValueError(f"{path}: expected the {HEADER_BYTES} bytes of an Event Stream header, got {header!r}")
        if header[12] != 2 or header[15] not in (DVS, ATIS):
            raise ValueError(
                f"{path}: expected Event Stream version 2 with DVS (1) or ATIS (2) events, "
                f"got version {header[12]}.{header[13]}.{header[14]} with type {header[15]}"
            )
        self.path = path
        self._kind = header[15]
        self.sensor = int.from_bytes(header[16:18], "little"), int.from_bytes(header[18:20], "little")
        if 0 in self.sensor:
            raise ValueError(f"{path}: a sensor must have at least one pixel a side, got {self.sensor}")

    def blocks(self) -> Iterator[np.ndarray]:
        compile_only(decode_es, *ES_TYPES)
        assert self.sensor is not None  # for mypy: the header has it
        width, height = self.sensor
        columns = block_columns()
        time, place, rest = 0, HEADER_BYTES, b""
        with self.path.open("rb") as file:
            file.seek(HEADER_BYTES)
            while chunk := file.read(BLOCK_EVENTS):
                data = rest + chunk
                n, done, time, is_off = decode_es(
                    np.frombuffer(data, np.uint8), time, self._kind, width, height, *columns
                )
                if n:
                    yield structured(columns, n)
                place += done
                if is_off:
                    raise CorruptData(f"the event at byte {place} is off the {width} x {height} sensor")
                rest = data[done:]
        if rest:
            raise CorruptData(f"the file ends {len(rest)} bytes into the event at byte {place}, which has 5")
