"""Prophesee's RAW files (`.raw`) in EVT2, EVT2.1 and EVT3."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numba import uint16, uint32

from async_tnt.events import EVENT_DTYPE
from async_tnt.kernels.evt import HIGH, INITIAL, ODD, UNPLACED, decode_evt2, decode_evt3, decode_evt21, kernel_types
from async_tnt.kernels.jit import compile_only
from async_tnt.sources.files.damage import Damage
from async_tnt.sources.files.prophesee_header import PropheseeHeader
from async_tnt.sources.files.source import BLOCK_EVENTS, Source

CHUNK_BYTES = 1 << 18
VERSIONS: dict[str, tuple[Any, Any, int]] = {  # kernel, type of its words, bytes that belong together
    "2": (decode_evt2, uint32, 4),
    "2.1": (decode_evt21, uint32, 8),
    "3": (decode_evt3, uint16, 2),
}
NAMES = {"evt2": "2", "evt21": "2.1", "evt3": "3"}


class EvtSource(Source):
    """The events of a RAW file; triggers and other words are passed over.

    Raises
    ------
    ValueError : the header names no version, or one that is not known.
    """

    def __init__(self, path: Path) -> None:
        header = PropheseeHeader(path)
        version = NAMES.get(header.format) or header.fields.get("evt", "").removesuffix(".0")
        if version not in VERSIONS:
            raise ValueError(
                f"{path}: the header must say `% evt` 2.0, 2.1 or 3.0, or `% format` EVT2, EVT21 or EVT3; "
                f"got {header.fields.get('format') or header.fields.get('evt')!r}"
            )
        self.path = path
        self.sensor = header.sensor
        self.version = version
        self._start = header.length
        self._t0_us = header.t0_us
        # IMX636 and older send the upper half of a 64-bit word first, which the header calls legacy
        endianness = header.options.get("endianness", "little" if header.format else "legacy")
        self._halves_swapped = version == "2.1" and endianness != "legacy"
        if version == "2.1" and endianness not in ("legacy", "little"):
            raise ValueError(f"{path}: `endianness` must be little or legacy, got {endianness!r}")

    def blocks(self) -> Iterator[np.ndarray]:
        decode, word_type, size = VERSIONS[self.version]
        compile_only(decode, *kernel_types(word_type))
        dtype = np.dtype(str(word_type)).newbyteorder("<")
        state = np.array(INITIAL, np.int64)
        columns: Any = tuple(np.empty(BLOCK_EVENTS, EVENT_DTYPE[name]) for name in ("t", "x", "y", "p"))
        with self.path.open("rb") as file:
            file.seek(self._start)
            place = self._start
            while chunk := file.read(CHUNK_BYTES):
                words = np.frombuffer(chunk, dtype, len(chunk) // size * size // dtype.itemsize)
                if self._halves_swapped:
                    words = np.ascontiguousarray(words.reshape(-1, 2)[:, ::-1]).ravel()
                done, status = 0, None
                while done < len(words) and status != ODD:
                    n, done, status = decode(words, done, state, *columns)
                    if n:
                        events = np.empty(n, EVENT_DTYPE)
                        for name, column in zip(("t", "x", "y", "p"), columns, strict=True):
                            events[name] = column[:n]
                        events["t"] += self._t0_us
                        yield events
                if status == ODD:
                    raise Damage(
                        f"byte {place + done * dtype.itemsize}: a vector of events reaches beyond x = 2047, "
                        "which is as far as the format goes"
                    )
                place += len(chunk)
                if len(chunk) % size:
                    raise Damage(f"the file ends at byte {place}, {len(chunk) % size} bytes into a word of {size}")
        if state[UNPLACED] and state[HIGH] < 0:
            raise Damage(f"no word tells the time of the {state[UNPLACED]} words of events: there is no TIME_HIGH")


def open_evt(path: Path) -> Source:
    """Open a RAW file of Prophesee's: EVT2, EVT2.1 or EVT3."""
    return EvtSource(path)
