"""Text with an event per row: UZH's layout (`.txt`) and CSV (`.csv`, `.tsv`, `.txt`).

UZH    t x y p between blanks, t in seconds; before them, optionally, a line with the sensor's
       `width height` 240 180
       0.003811000 96 133 0
       Seconds become microseconds, to the nearest one.
CSV    commas, semicolons or tabs between the columns, t in whole microseconds; a header says which
       column is which (t|ts|timestamp, x, y, p|on|polarity|pol; others are skipped), without one
       they are t, x, y, p Metavision's has the sensor instead of a header, and other columns:
       %geometry:1280,720
       96,133,0,3811

Columns without a header that are seen to be in another order are refused, unless the caller states
it. Polarity is 0/1, -1/+1 or, in CSV, False/True. Lines that begin with # or % are comments.
NumPy's `loadtxt` reads the rows, as float64: whole numbers below 2**53 are exact.

References
----------
Mueggler, Rebecq, Gallego, Delbruck, Scaramuzza 2017, The Event-Camera Dataset and Simulator, IJRR
36(2): events.txt.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from async_tnt.sources.files.source import CorruptData, ReadOptions, Source, valid_blocks
from async_tnt.volume.event_forms import NAMES, Four, likely_order, the_name
from async_tnt.volume.sensor import Sensor

CHUNK_BYTES = 1 << 18
FIRST_BYTES = 1 << 12
"""Bytes of rows among which the first event is looked for, before all of them are read."""
ORDER_ROWS = 1_000
"""The first rows of a file, by which the order of its columns is judged."""
MAX_ROW_BYTES = 1 << 16
COMMENTS = ("#", "%")
SEPARATORS = ",;\t"
UZH_ORDER = "txyp"
CSV_ORDER = "txyp"
METAVISION_ORDER = "xypt"
"""The order of columns in a CSV file with a line `%geometry:WIDTH,HEIGHT`."""
MAX_SIDE = 1 << 16
"""Pixels of the longest side that a file may state."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_WORD = re.compile("true|false", re.IGNORECASE)
_GEOMETRY = re.compile(r"%\s*geometry\s*:\s*(.*)", re.IGNORECASE)
_NO_EVENT = re.compile(rb"^[ \t\r]*(?:[#%].*)?$", re.MULTILINE)


@dataclass
class TextSource(Source):
    """Rows of text.

    Parameters
    ----------
    start, line : the first row: where it begins, in bytes, and its line number, counted from 1.
    columns : what each column is: t, x, y, p, or "" where it is skipped.
    separator : the character between columns; None: any number of spaces and tabs.
    unit_us : of t, in microseconds.
    expected : what a row looks like, for messages.
    """

    format = "rows of text"

    path: Path
    start: int
    line: int
    columns: Sequence[str]
    separator: str | None
    unit_us: float
    expected: str
    sensor: Sensor | None = None

    def blocks(self) -> Iterator[np.ndarray]:
        return valid_blocks(self._parsed(CHUNK_BYTES))

    def check_first(self) -> None:
        for block in valid_blocks(self._parsed(FIRST_BYTES)):
            if len(block):
                return

    def _parsed(self, chunk_bytes: int) -> Iterator[Four]:
        """Columns of whole numbers, part by part."""
        line = self.line
        for text, is_whole in self._chunks(chunk_bytes):
            rows = _NO_EVENT.sub(b"", text).decode("utf-8", "backslashreplace").split("\n")
            # the last number of the file may have lost its last digits, a polarity has one
            whole = is_whole or self.columns[-1] in ("", "p") or not rows[-2]
            n = len(rows) if whole else len(rows) - 2
            columns = self._columns(rows[:n])
            if columns is None:
                n = bisect_left(range(n), True, key=lambda k: self._columns(rows[: k + 1]) is None)
                columns = self._columns(rows[:n])
            if columns is not None:
                yield columns
            if n < len(rows):
                cut = "" if is_whole or n < len(rows) - 2 else ", and the file ends there"
                raise CorruptData(
                    f"line {line + n}: expected {self.expected}, got {rows[n].strip()[:80]!r}{cut}"
                )
            line += len(rows) - 1

    def _columns(self, rows: list[str]) -> Four | None:
        """Rows as columns t, x, y, p of whole numbers; None where they are not."""
        if not any(rows):
            empty = np.zeros(0, np.int64)
            return empty, empty, empty, empty
        row = np.dtype(
            [
                (name or f"skipped {i}", "f8" if name else "U1")
                for i, name in enumerate(self.columns)
            ]
        )
        # calling a function for each polarity is slow: only where some may be words
        words: Any = {self.columns.index("p"): _polarity} if _WORD.search("\n".join(rows)) else None
        try:
            table = np.loadtxt(
                rows,
                row,
                comments=None,
                delimiter=self.separator,
                converters=words,
                encoding="utf-8",
                ndmin=1,
            )
        except ValueError:
            return None
        t = np.rint(table["t"] * self.unit_us) if self.unit_us != 1.0 else table["t"]
        columns = t, table["x"], table["y"], table["p"]
        if not all(
            ((column == np.rint(column)) & (np.abs(column) < 1 << 53)).all() for column in columns
        ):
            return None
        t, x, y, p = (column.astype(np.int64) for column in columns)
        return t, x, y, p

    def _chunks(self, chunk_bytes: int) -> Iterator[tuple[bytes, bool]]:
        """Whole rows, and whether the last of them has a line end (the file's last may not; here it
        gets one)."""
        with self.path.open("rb") as file:
            file.seek(self.start)
            rest, line = b"", self.line
            while chunk := file.read(chunk_bytes):
                if len(rest) > MAX_ROW_BYTES:
                    got = f"got {rest[:80].decode('utf-8', 'backslashreplace')!r} and more than {MAX_ROW_BYTES:,} bytes"
                    raise CorruptData(f"line {line}: expected {self.expected}, {got}")
                end = chunk.rfind(b"\n") + 1
                if end:
                    line += chunk.count(b"\n")
                    yield rest + chunk[:end], True
                    rest = b""
                rest += chunk[end:]
            if rest:
                yield rest + b"\n", False


def _polarity(word: str) -> float:
    """A polarity as a number or as False or True."""
    names = {"false": 0.0, "true": 1.0}
    return names[word.lower()] if word.lower() in names else float(word)


class _Row(NamedTuple):
    """A line of text, where it begins and ends, in bytes, and its number, from 1."""

    text: str
    start: int
    end: int
    line: int

    @property
    def is_comment(self) -> bool:
        return self.text.startswith(COMMENTS)


def _first_rows(path: Path) -> list[_Row]:
    """The lines in the first 64 KiB of a file that are not empty."""
    with path.open("rb") as file:
        start = file.read(MAX_ROW_BYTES)
    if b"\0" in start:
        raise ValueError(f"{path}: expected text, got bytes that are not: {start[:16]!r}")
    rows = []
    pos = 3 if start.startswith(b"\xef\xbb\xbf") else 0  # a byte order mark
    for line, raw in enumerate(start[pos:].split(b"\n"), 1):
        text = raw.decode("utf-8", "backslashreplace").strip(" \r")
        if text.strip():
            rows.append(_Row(text, pos, pos + len(raw), line))
        pos += len(raw) + 1
    return rows


def open_txt(path: Path, options: ReadOptions) -> Source:
    """Open a `.txt` file: CSV if there are commas or semicolons between the columns, else UZH's
    layout."""
    first = next((row.text for row in _first_rows(path) if not row.is_comment), "")
    return open_csv(path, options) if "," in first or ";" in first else open_uzh_text(path, options)


def open_uzh_text(path: Path, options: ReadOptions) -> Source:
    """Open a text file in UZH's layout; whole numbers as times are refused: they may be seconds or
    microseconds."""
    all_rows = _first_rows(path)
    order = options.columns or UZH_ORDER
    expected = f"`{' '.join(order)}`, t in seconds"
    sensor = _geometry(path, all_rows)
    rows = [row for row in all_rows if not row.is_comment]
    start = 0
    line = 1
    if rows:
        text, start, end, line = rows[0]
        columns = text.split()
        if len(columns) == 2 and all(column.isdecimal() for column in columns):
            sensor = _checked_sides(path, columns, text)
            if len(rows) == 1 and path.stat().st_size == end:
                raise ValueError(
                    f"{path}: the file ends in its first line, {text!r}: no events, and perhaps no "
                    "sensor"
                )
            start = end  # a line end, which the first row may begin with
            rows = rows[1:]
        elif not columns or not _NUMBER.fullmatch(columns[0]) or len(columns) > 4:
            raise ValueError(
                f"{path}: expected {expected}, or first `width height`, got {text[:80]!r} at line "
                f"{line}"
            )
        _refuse_whole_times(path, rows, order.index("t"))
    return TextSource(path, start, line, tuple(order), None, 1e6, expected, sensor)


def _refuse_whole_times(path: Path, rows: list[_Row], column: int) -> None:
    """Refuse a file in which the times of all rows, in this column, are whole numbers."""
    times = [words[column] for row in rows if len(words := row.text.split()) > column]
    whole = [float(time) for time in times if _NUMBER.fullmatch(time) and float(time).is_integer()]
    if len(whole) == len(times) > 1 and any(whole):
        raise ValueError(
            f"{path}: times must be seconds with decimals, got whole numbers ({times[0]}, "
            f"{times[1]}, ...); "
            "if they are microseconds, write t,x,y,p with commas: CSV's times are microseconds"
        )


def open_csv(path: Path, options: ReadOptions) -> Source:
    """Open a CSV file; without a header, it must have four columns."""
    rows = _first_rows(path)
    sensor = _geometry(path, rows)
    first = next((row for row in rows if not row.is_comment), None)
    if first is None:
        _, start, _, line = rows[-1] if rows else _Row("", 0, 0, 1)
        return TextSource(
            path, start, line, tuple(CSV_ORDER), ",", 1.0, ",".join(CSV_ORDER), sensor
        )
    text, start, end, line = first
    separator, columns = _split(text)
    if len(columns) < 4:
        raise ValueError(
            f"{path}: expected at least four columns with commas, semicolons or tabs between them, "
            f"got {text[:80]!r} at line {line}"
        )
    comments = [
        _names_in(row.text.lstrip("".join(COMMENTS)), len(columns))
        for row in rows[: rows.index(first)]
    ]
    header = next(filter(_is_header, reversed(comments)), None)  # a comment may be one: `# x,y,p,t`
    if header is None and any(
        re.search("[A-Za-z]", c) and not _NUMBER.fullmatch(c) for c in columns[:2]
    ):
        header = columns
        if not _is_header(header):
            wanted = ", ".join("|".join(names) for names in NAMES.values())
            raise ValueError(
                f"{path}: the header must name {wanted}; got {text[:80]!r} at line {line}"
            )
        if len(rows) == 1 and path.stat().st_size == end:
            raise ValueError(f"{path}: the file ends in its header, {text[:80]!r}")
        start = end  # a line end, which the first row may begin with
    if header is None:
        if len(columns) != 4:
            raise ValueError(
                f"{path}: without a header there must be four columns t, x, y, p, got "
                f"{len(columns)} in "
                f"{text[:80]!r} at line {line}; with one, further columns are skipped"
            )
        header = list(_order_without_header(path, rows, separator, options, sensor))
    roles = [""] * len(header)
    for field in "txyp":
        try:
            roles[header.index(the_name(field, header, "the header"))] = field
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    expected = separator.join(header) + ", t in whole microseconds"
    return TextSource(path, start, line, roles, separator, 1.0, expected, sensor)


def _order_without_header(
    path: Path, rows: list[_Row], separator: str, options: ReadOptions, sensor: Sensor | None
) -> str:
    """The order of four columns: as the caller states it, or as the format has it, if the numbers
    look like that.

    Raises
    ------
    ValueError : they look like another order.
    """
    usual = CSV_ORDER if sensor is None else METAVISION_ORDER
    order = options.columns or usual
    table = _numbers(rows, separator)
    likely = order if table is None else likely_order(table, order)
    if likely == order:
        return order
    raise ValueError(
        f"{path}: the columns are not {order!r}; they look like {likely!r}: state their order with "
        "`columns`, or "
        "write a header"
    )


def _numbers(rows: list[_Row], separator: str) -> np.ndarray | None:
    """The first rows as numbers in shape (N, 4); None if one of them is something else."""
    events = [row.text for row in rows if not row.is_comment]
    if len(events) > 1:
        events.pop()  # it may be cut off
    try:
        words = [
            [word.strip(" \r\"'") for word in text.split(separator)] for text in events[:ORDER_ROWS]
        ]
        table = np.array([[_polarity(word) for word in row] for row in words])
    except ValueError:  # not a number, or rows of different lengths
        return None
    return table if table.ndim == 2 and table.shape[1] == 4 else None


def _geometry(path: Path, rows: list[_Row]) -> Sensor | None:
    """The sensor in a line `%geometry:WIDTH,HEIGHT` before the first row; None without one."""
    for row in rows:
        if not row.is_comment:
            return None
        if found := _GEOMETRY.fullmatch(row.text):
            return _checked_sides(path, found[1].split(","), row.text)
    return None


def _checked_sides(path: Path, words: list[str], text: str) -> Sensor:
    """Two words as (width, height); a ValueError that quotes the text if they are not sides of a
    sensor."""
    sides = [int(word) for word in words if word.strip().isdecimal() and len(word) < 20]
    if len(words) != 2 or len(sides) != 2 or not all(1 <= side <= MAX_SIDE for side in sides):
        raise ValueError(
            f"{path}: a sensor must have 1 to {MAX_SIDE} pixels a side, got {text[:80]!r}"
        )
    return sides[0], sides[1]


def _split(text: str) -> tuple[str, list[str]]:
    """The separator that a row has most of, and its columns in lower case."""
    separator = max(SEPARATORS, key=text.count)
    return separator, [column.strip(" \r\"'").lower() for column in text.split(separator)]


def _names_in(comment: str, n_columns: int) -> list[str]:
    """The columns that a comment may name, with the separators of rows or with blanks: `# x,y,p,t`,
    `# x y p t`."""
    by_blanks = comment.lower().split()
    return by_blanks if len(by_blanks) == n_columns else _split(comment)[1]


def _is_header(columns: list[str]) -> bool:
    """Whether all of t, x, y and p are named."""
    return all(set(columns).intersection(names) for names in NAMES.values())
