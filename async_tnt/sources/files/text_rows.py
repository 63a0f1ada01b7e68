"""Files of text with an event per row, block by block: what UZH text and CSV share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from async_tnt.events import EVENT_DTYPE
from async_tnt.kernels.jit import compile_only
from async_tnt.kernels.text import ODD, ROW_TYPES, P, T, X, Y, parse_rows
from async_tnt.sources.files.damage import Damage
from async_tnt.sources.files.source import BLOCK_EVENTS, Sensor, Source

CHUNK_BYTES = 1 << 20
MAX_ROW_BYTES = 1 << 16
COMMENTS = ("#", "%")


class RowSource(Source):
    """Rows of text.

    Parameters
    ----------
    path : the file.
    start, line : where the first row is: its byte, and its number of line, counted from 1.
    roles : what each column is (see `text_kernel`).
    separator : the character between columns, or BLANKS.
    decimals : 6 where times are seconds, 0 where they are microseconds.
    expected : how a row should look, for messages.
    """

    def __init__(
        self,
        path: Path,
        start: int,
        line: int,
        roles: Sequence[int],
        separator: int,
        decimals: int,
        expected: str,
        sensor: Sensor | None = None,
    ) -> None:
        self.path = path
        self.sensor = sensor
        self._start = start
        self._line = line
        self._roles = np.array(roles, np.int64)
        self._separator = separator
        self._decimals = decimals
        self._expected = expected
        compile_only(parse_rows, *ROW_TYPES)

    def blocks(self) -> Iterator[np.ndarray]:
        t, x, y, p = (np.empty(BLOCK_EVENTS, EVENT_DTYPE[name]) for name in ("t", "x", "y", "p"))
        seen = np.zeros(2, np.int64)
        line = self._line
        for text, is_whole in self._chunks():
            data = np.frombuffer(text, np.uint8)
            pos = 0
            while pos < len(text):
                n, stop, status = parse_rows(
                    data, pos, len(text), self._roles, self._separator, self._decimals, seen, t, x, y, p
                )
                if n and not is_whole and status != ODD and stop == len(text) and self._may_be_cut():
                    status = ODD  # the last number of the file may have lost its last digits
                    n -= 1
                    stop = text.rstrip().rfind(b"\n") + 1
                if n:
                    events = np.empty(n, EVENT_DTYPE)
                    events["t"], events["x"], events["y"], events["p"] = t[:n], x[:n], y[:n], p[:n]
                    yield events
                if status == ODD:
                    line += text.count(b"\n", 0, stop)
                    row = text[stop : stop + 200].split(b"\n")[0].decode("utf-8", "backslashreplace").strip()
                    cut = "" if is_whole or text.find(b"\n", stop) < len(text) - 1 else ", and the file ends there"
                    raise Damage(f"line {line}: expected {self._expected}, got {row[:80]!r}{cut}")
                pos = stop
            line += text.count(b"\n")

    def _may_be_cut(self) -> bool:
        return int(self._roles[-1]) in (T, X, Y)

    def _chunks(self) -> Iterator[tuple[bytes, bool]]:
        """Whole rows, and whether the last of them came with its line end (the file's last may not)."""
        with self.path.open("rb") as file:
            file.seek(self._start)
            rest = b""
            while chunk := file.read(CHUNK_BYTES):
                end = chunk.rfind(b"\n") + 1
                if end:
                    yield rest + chunk[:end], True
                    rest = chunk[end:]
                else:
                    rest += chunk
                if len(rest) > MAX_ROW_BYTES:
                    break  # no row: what follows is no text
            if rest:
                yield rest[:MAX_ROW_BYTES] + b"\n", False


def first_row(path: Path) -> str:
    """The first line that is neither empty nor a comment; "" if there is none in the first 64 KiB."""
    return next((row[0] for row in head_rows(path) if not row[0].startswith(COMMENTS)), "")


def head_rows(path: Path) -> list[tuple[str, int, int, int]]:
    """The lines in the first 64 KiB of a file that are not empty: text, its first byte, its end, line from 1."""
    with path.open("rb") as file:
        start = file.read(MAX_ROW_BYTES)
    is_binary = b"\0" in start
    if is_binary:
        raise ValueError(f"{path}: expected text, got bytes that are none: {start[:16]!r}")
    rows = []
    pos = 3 if start.startswith(b"\xef\xbb\xbf") else 0  # a byte order mark
    for line, raw in enumerate(start[pos:].split(b"\n"), 1):
        text = raw.decode("utf-8", "backslashreplace").strip(" \r")
        if text.strip():
            rows.append((text, pos, pos + len(raw), line))
        pos += len(raw) + 1
    return rows


ROLES = {"t": T, "x": X, "y": Y, "p": P}
