"""Prophesee's files: RAW (`.raw`) in EVT2, EVT2.1 and EVT3, and DAT (`.dat`).

Both begin with a header, lines that begin with `% `. After the header, a RAW file has words, which
`kernels/sources/evt.py` decodes. A DAT file has two bytes there: the type of its events (0x00 and
0x0C: pixels) and the size of one event, 8. Then its events follow, little-endian:

    32 bits    t, in microseconds
    32 bits    version 2: x: 14 bits, y: 14, p: 4
               version 1: x: 9 bits, y: 8, p: 1, unused: 14

DAT's clock of 32 bits wraps after 71.6 minutes; times are unwrapped.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt.kernels.sources.evt import (
    INITIAL,
    UNPLACED,
    decode_evt2,
    decode_evt3,
    decode_evt21,
    unwrap_times,
)
from async_tnt.sources.files.source import (
    BLOCK_EVENTS,
    MAX_SIDE,
    CorruptData,
    ReadOptions,
    Source,
    is_text,
    valid_events,
)
from async_tnt.volume.events import empty_columns, structured
from async_tnt.volume.sensor import Sensor

MAX_HEADER_BYTES = 1 << 16
"""Bytes at the beginning of a file in which its header is looked for."""

CHUNK_BYTES = 1 << 18
"""Bytes of a RAW file that are read together."""


@dataclass(frozen=True)
class EvtVersion:
    """A version of the EVT format.

    Parameters
    ----------
    decode : the kernel that decodes its words.
    word : type of a word, as the kernel takes it.
    n_bytes : bytes of the smallest part that can be decoded: a word, or a pair of words.
    """

    decode: Callable[..., tuple[int, int]]
    word: np.dtype
    n_bytes: int


EVT_VERSIONS = {
    "2": EvtVersion(decode_evt2, np.dtype("<u4"), 4),
    "2.1": EvtVersion(decode_evt21, np.dtype("<u4"), 8),
    "3": EvtVersion(decode_evt3, np.dtype("<u2"), 2),
}
"""Version as `% evt` states it, without ".0" -> how it is read."""

EVT_NAMES = {"evt2": "2", "evt21": "2.1", "evt3": "3"}
"""Name in a line `% format` -> version."""

DAT_EVENT_BYTES = 8
"""Bytes of an event in a DAT file."""

DAT_PERIOD_US = 1 << 32
"""Microseconds after which a DAT file's clock wraps."""

DAT_SIDE = 1 << 14
"""Pixels of the longest side that version 2 of DAT can state."""

DAT_PIXEL_EVENTS = (0x00, 0x0C)
"""Types of events in a DAT file that come from pixels."""

DAT_FIELDS = {"2": ((0, 14), (14, 14), (28, 4)), "1": ((0, 9), (9, 8), (17, 1))}
"""Version of DAT -> first bit and number of bits of x, of y and of p in an event's second word."""

_SIDE = re.compile(r"\d{1,5}")


class Header:
    """The header of a RAW or DAT file.

    Attributes
    ----------
    fields : keyword in lower case -> the rest of its line.
    format : the format that a line such as `% format EVT3;height=720;width=1280` names, in lower
        case; "" without one.
    options : name -> value of the options in that line, in lower case.
    length : bytes of the header.
    sensor : (width, height), from geometry, format or Width and Height; None without them.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.fields: dict[str, str] = {}
        self.length = 0
        self._read_lines()
        self.format, *options = self.fields.get("format", "").lower().split(";")
        pairs = (option.partition("=") for option in options)
        self.options = {name.strip(): value.strip() for name, _, value in pairs}
        self.sensor = self._sensor()

    @property
    def t0_us(self) -> int:
        """The time in microseconds that faery subtracted from all times when it wrote the file.

        It is 0 if the header does not state it.
        """
        t0 = self.fields.get("t0", "0")
        if not t0.isdecimal() or len(t0) > 18:
            raise ValueError(f"{self.path}: `% t0` must be whole microseconds, got {t0[:40]!r}")
        return int(t0)

    def _read_lines(self) -> None:
        """Fill `fields` and `length`."""
        with self.path.open("rb") as file:
            data = file.read(MAX_HEADER_BYTES)
        # The first event may begin with a %, but its bytes are hardly a line of text.
        while data.startswith(b"% ", self.length):
            end = data.find(b"\n", self.length)
            line = data[self.length : end if end >= 0 else len(data)].rstrip(b"\r")
            if not is_text(line):
                break
            if end < 0:
                # A line that goes on behind the bytes that were read belongs to no header.
                if len(data) < MAX_HEADER_BYTES:
                    beginning = line.decode(errors="replace")[:80]
                    raise ValueError(
                        f"{self.path}: the file ends inside its header, in {beginning!r}"
                    )
                break
            self.length = end + 1
            keyword, _, value = line[2:].decode(errors="replace").strip().partition(" ")
            if keyword.lower() == "end":
                break
            self.fields[keyword.lower()] = value.strip()

    def _sensor(self) -> Sensor | None:
        """The sensor's sides (width, height); None if the header does not state both."""
        sides = self._sides()
        if sides is None:
            return None
        are_numbers = len(sides) == 2 and all(_SIDE.fullmatch(side) for side in sides)
        if not are_numbers or not all(1 <= int(side) <= MAX_SIDE for side in sides):
            raise ValueError(
                f"{self.path}: the header's sensor must be two sizes in pixels, got "
                f"{'x'.join(sides)!r}"
            )
        return int(sides[0]), int(sides[1])

    def _sides(self) -> list[str] | None:
        """The words for the sensor's sides; None without them."""
        if "geometry" in self.fields:
            return self.fields["geometry"].lower().split("x")
        for words in (self.options, self.fields):
            if "width" in words and "height" in words:
                return [words["width"], words["height"]]
        return None


class EvtSource(Source):
    """The events of a RAW file; triggers and other words are skipped."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        header = Header(path)
        version = EVT_NAMES.get(header.format) or header.fields.get("evt", "").removesuffix(".0")
        if version not in EVT_VERSIONS:
            got = header.fields.get("format") or header.fields.get("evt")
            raise ValueError(
                f"{path}: the header must say `% evt` 2.0, 2.1 or 3.0, or `% format` EVT2, EVT21 "
                f"or EVT3; got {got!r}"
            )
        self.path = path
        self.sensor = header.sensor
        self.format = f"EVT {version}"
        self._version = EVT_VERSIONS[version]
        self._start = header.length
        self._t0_us = header.t0_us
        # The IMX636 and older sensors send the upper half of a 64-bit word first. The header calls
        # this order `legacy`.
        endianness = header.options.get("endianness", "little" if header.format else "legacy")
        self._halves_swapped = version == "2.1" and endianness != "legacy"
        if version == "2.1" and endianness not in ("legacy", "little"):
            raise ValueError(f"{path}: `endianness` must be little or legacy, got {endianness!r}")

    def blocks(self) -> Iterator[np.ndarray]:
        version = self._version
        size = version.n_bytes
        state = np.array(INITIAL, np.int64)
        columns = empty_columns(BLOCK_EVENTS)[:4]
        n_events = 0
        with self.path.open("rb") as file:
            file.seek(self._start)
            place = self._start
            while chunk := file.read(CHUNK_BYTES):
                n_whole_bytes = len(chunk) - len(chunk) % size
                n_words = n_whole_bytes // version.word.itemsize
                words = np.frombuffer(chunk, version.word, n_words)
                if self._halves_swapped:
                    words = np.ascontiguousarray(words.reshape(-1, 2)[:, ::-1]).ravel()
                for events in decoded_words(words, version.decode, state, columns):
                    n_events += len(events)
                    events["t"] += self._t0_us
                    yield events
                place += len(chunk)
                if len(chunk) % size:
                    raise CorruptData(
                        f"the file ends at byte {place}, {len(chunk) % size} bytes into a word of "
                        f"{size}"
                    )
        refuse_unplaced(state, n_events)


def decoded_words(
    words: np.ndarray,
    decode: Callable[..., tuple[int, int]],
    state: np.ndarray,
    columns: Sequence[np.ndarray],
) -> Iterator[np.ndarray]:
    """The events of EVT words, in arrays of at most the columns' length.

    Parameters
    ----------
    decode : one of the kernels in `kernels/sources/evt.py`.
    state : state of the decoder; `INITIAL` before the first words; updated in place.
    columns : t, x, y, p, for the kernel to write to.
    """
    n_done = 0
    while n_done < len(words):
        n, n_done = decode(words, n_done, state, *columns)
        if n:
            yield structured(columns, n)


def refuse_unplaced(state: np.ndarray, n_events: int) -> None:
    """Refuse words of events without a time or a row, if no event has both.

    Raises
    ------
    CorruptData : there were events, but none with a time and a row.
    """
    if state[UNPLACED] and n_events == 0:
        raise CorruptData(
            f"{state[UNPLACED]} words of events have no time or no row: no TIME_HIGH or ADDR_Y "
            "before"
        )


def dat_header(sensor: Sensor) -> bytes:
    """The first bytes of a DAT file of version 2, up to its first event."""
    width, height = sensor
    lines = ("Data file containing CD events", "Version 2", f"Height {height}", f"Width {width}")
    text = "".join(f"% {line}\n" for line in lines)
    return text.encode() + bytes([DAT_PIXEL_EVENTS[-1], DAT_EVENT_BYTES])


def dat_records(events: np.ndarray, t0_us: int) -> bytes:
    """The bytes of events in a DAT file of version 2.

    Parameters
    ----------
    events : structured array of `EVENT_DTYPE`; x and y below `DAT_SIDE`.
    t0_us : time at which the file's times begin, in microseconds.

    Raises
    ------
    ValueError : a time is before `t0_us`, or 71.6 minutes or more after it. The format cannot
        state such a time.
    """
    t = events["t"] - t0_us
    is_outside = (t < 0) | (t >= DAT_PERIOD_US)
    if is_outside.any():
        i = int(is_outside.argmax())
        end_us = t0_us + DAT_PERIOD_US
        raise ValueError(
            f"`t` must be in [{t0_us}, {end_us}) for a DAT file, got {t[i] + t0_us} at event {i}"
        )
    words = np.empty((len(events), 2), "<u4")
    words[:, 0] = t
    x = events["x"].astype(np.uint32)
    y = events["y"].astype(np.uint32)
    p = events["p"].astype(np.uint32)
    words[:, 1] = x | y << 14 | p << 28
    return words.tobytes()


class DatSource(Source):
    """The events of a DAT file."""

    format = "DAT"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        header = Header(path)
        version = header.fields.get("version", "2")
        if version not in DAT_FIELDS:
            raise ValueError(f"{path}: the header's Version must be 1 or 2, got {version!r}")
        with path.open("rb") as file:
            file.seek(header.length)
            type_and_size = file.read(2)
        if (
            len(type_and_size) < 2
            or type_and_size[0] not in DAT_PIXEL_EVENTS
            or type_and_size[1] != DAT_EVENT_BYTES
        ):
            raise ValueError(
                f"{path}: after the header there must be a type of events, 0 or 12, and their "
                f"size, 8; got {list(type_and_size)}"
            )
        self.path = path
        self.sensor = header.sensor
        self._fields = DAT_FIELDS[version]
        self._start = header.length + 2
        self._t0_us = header.t0_us

    def blocks(self) -> Iterator[np.ndarray]:
        newest_us = np.int64(-1)
        n_read = 0
        with self.path.open("rb") as file:
            file.seek(self._start)
            while chunk := file.read(BLOCK_EVENTS * DAT_EVENT_BYTES):
                n_events = len(chunk) // DAT_EVENT_BYTES
                words = np.frombuffer(chunk, "<u4", 2 * n_events).reshape(-1, 2)
                t = words[:, 0].astype(np.int64)
                newest_us = np.int64(unwrap_times(t, newest_us, np.int64(DAT_PERIOD_US)))
                pixels = words[:, 1]
                x, y, p = [(pixels >> first) & ((1 << bits) - 1) for first, bits in self._fields]
                events, problem = valid_events(t + self._t0_us, x, y, p)
                yield events
                n_read += len(events)
                if problem:
                    raise CorruptData(
                        f"event {n_read} (byte {self._start + n_read * DAT_EVENT_BYTES}): {problem}"
                    )
                n_left = len(chunk) % DAT_EVENT_BYTES
                if n_left:
                    raise CorruptData(
                        f"the file ends {n_left} bytes into event {n_read}, which has "
                        f"{DAT_EVENT_BYTES}"
                    )
