"""Text with an event per row: UZH's layout (`.txt`) and CSV (`.csv`, `.tsv`, `.txt`).

UZH    t x y p between blanks, t in seconds. Before the rows there may be a line with the
       sensor's width and height:

           240 180
           0.003811000 96 133 0

       Seconds become microseconds, to the nearest one.

CSV    commas, semicolons or tabs between the columns, t in whole microseconds. A header says which
       column is which (t|ts|timestamp, x, y, p|on|polarity|pol); other columns are skipped. Without
       a header the columns are t, x, y, p. Metavision's CSV has the sensor instead of a header, and
       the order x, y, p, t:

           %geometry:1280,720
           96,133,0,3811

Columns without a header are refused if their numbers look like another order, unless the caller
states the order. Polarity is 0/1, -1/+1 or, in CSV, False/True. Lines that begin with # or % are
comments. NumPy's `loadtxt` reads the rows, as float64: whole numbers below 2**53 are exact.

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

from async_tnt.sources.files.source import (
    MAX_SIDE,
    CorruptData,
    ReadOptions,
    Source,
    valid_blocks,
)
from async_tnt.sources.files.source_error import SourceError
from async_tnt.volume.event_forms import NAMES, Four, likely_order, the_name
from async_tnt.volume.sensor import Sensor

CHUNK_BYTES = 1 << 18
"""Bytes of text that are parsed together."""

FIRST_BYTES = 1 << 12
"""Bytes of text in which the first event is looked for, when a file is opened."""

ORDER_ROWS = 1_000
"""Number of rows, from the first on, by which the order of the columns is judged."""

MAX_ROW_BYTES = 1 << 16
"""Bytes of the longest row. The header and the sensor are looked for in the first `MAX_ROW_BYTES`
bytes of a file."""

COMMENTS = ("#", "%")
"""First characters of lines that are comments."""

SEPARATORS = ",;\t"
"""Characters that may stand between the columns of a CSV file."""

UZH_ORDER = "txyp"
"""Order of the columns in UZH's layout."""

CSV_ORDER = "txyp"
"""Order of the columns in a CSV file without a header."""

METAVISION_ORDER = "xypt"
"""Order of the columns in a CSV file with a line `%geometry:WIDTH,HEIGHT`."""

MAX_WHOLE = 1 << 53
"""Every whole number below this number is exact in float64."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
"""A decimal number."""

_WORD = re.compile("true|false", re.IGNORECASE)
"""A polarity that is written as a word."""

_GEOMETRY = re.compile(r"%\s*geometry\s*:\s*(.*)", re.IGNORECASE)
"""The comment in which Metavision's CSV states the sensor."""

_NO_EVENT = re.compile(rb"^[ \t\r]*(?:[#%].*)?$", re.MULTILINE)
"""A line without an event: a comment, or an empty line."""


@dataclass
class TextSource(Source):
    """The events of a text file with an event per row.

    Parameters
    ----------
    start : byte at which the first row begins.
    line : line number of the first row, counted from 1.
    columns : field of each column: t, x, y, p, or "" for a column that is skipped.
    separator : the character between columns; None: any number of spaces and tabs.
    unit_us : unit of t, in microseconds.
    expected : description of a row, for messages.
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
        return valid_blocks(self._parse(CHUNK_BYTES))

    def check_first(self) -> None:
        for block in valid_blocks(self._parse(FIRST_BYTES)):
            if len(block):
                return

    def _parse(self, chunk_bytes: int) -> Iterator[Four]:
        """Columns of whole numbers, part by part.

        Raises
        ------
        CorruptData : at the first row that is no event.
        """
        line = self.line
        for text, ends_with_line in self._chunks(chunk_bytes):
            rows = _NO_EVENT.sub(b"", text).decode("utf-8", "backslashreplace").split("\n")
            # `text` ends with a line end, so rows[-1] is empty and rows[-2] is the last row. Where
            # the file ends in the middle of this row, the last number may have lost digits. A
            # polarity cannot lose any, as it has one digit.
            needs_line_end = bool(rows[-2]) and self.columns[-1] not in ("", "p")
            is_complete = ends_with_line or not needs_line_end
            n_good = len(rows) if is_complete else len(rows) - 2
            columns = self._columns(rows[:n_good])
            if columns is None:
                # bisection finds the first bad row
                n_good = bisect_left(
                    range(n_good), True, key=lambda k: self._columns(rows[: k + 1]) is None
                )
                columns = self._columns(rows[:n_good])
            if columns is not None:
                yield columns

            if n_good < len(rows):
                is_last = not ends_with_line and n_good >= len(rows) - 2
                end = ", and the file ends there" if is_last else ""
                got = rows[n_good].strip()[:80]
                raise CorruptData(
                    f"line {line + n_good}: expected {self.expected}, got {got!r}{end}"
                )
            line += len(rows) - 1

    def _columns(self, rows: list[str]) -> Four | None:
        """The columns t, x, y, p of some rows; None if one of the rows is no event.

        All four are whole numbers. Times in seconds are first rounded to microseconds.
        """
        if not any(rows):
            empty = np.zeros(0, np.int64)
            return empty, empty, empty, empty

        row_type = [
            (name, "f8") if name else (f"skipped {i}", "U1") for i, name in enumerate(self.columns)
        ]
        converters: Any = None
        # NumPy would call `_polarity` for every row, which is slow. So it does only if some
        # polarities may be words.
        if _WORD.search("\n".join(rows)):
            converters = {self.columns.index("p"): _polarity}
        try:
            table = np.loadtxt(
                rows,
                np.dtype(row_type),
                comments=None,
                delimiter=self.separator,
                converters=converters,
                encoding="utf-8",
                ndmin=1,
            )
        except ValueError:
            return None

        t = table["t"] if self.unit_us == 1.0 else np.rint(table["t"] * self.unit_us)
        columns = (t, table["x"], table["y"], table["p"])
        for column in columns:
            if not ((column == np.rint(column)) & (np.abs(column) < MAX_WHOLE)).all():
                return None
        t, x, y, p = [column.astype(np.int64) for column in columns]
        return t, x, y, p

    def _chunks(self, chunk_bytes: int) -> Iterator[tuple[bytes, bool]]:
        """Whole rows of the file, and whether the last of them ends with a line end in the file.

        The last row of the file may have no line end. Then it gets one here.
        """
        with self.path.open("rb") as file:
            file.seek(self.start)
            rest = b""
            line = self.line
            while chunk := file.read(chunk_bytes):
                if len(rest) > MAX_ROW_BYTES:
                    beginning = rest[:80].decode("utf-8", "backslashreplace")
                    raise CorruptData(
                        f"line {line}: expected {self.expected}, got {beginning!r} and more than "
                        f"{MAX_ROW_BYTES:,} bytes"
                    )
                end = chunk.rfind(b"\n") + 1
                if end:
                    line += chunk.count(b"\n")
                    yield rest + chunk[:end], True
                    rest = b""
                rest += chunk[end:]
            if rest:
                yield rest + b"\n", False


def _polarity(word: str) -> float:
    """The number of a polarity, which may be written as False or True."""
    names = {"false": 0.0, "true": 1.0}
    lower = word.lower()
    return names[lower] if lower in names else float(word)


class _Row(NamedTuple):
    """A line of text that is not empty."""

    text: str
    start: int
    """Byte of the file at which the line begins."""
    end: int
    """Byte of the file at which the line ends, without its line end."""
    line: int
    """Number of the line, from 1."""

    @property
    def is_comment(self) -> bool:
        """Whether the line is a comment."""
        return self.text.startswith(COMMENTS)


def _first_rows(path: Path) -> list[_Row]:
    """The lines in the first 64 KiB of a file that are not empty."""
    with path.open("rb") as file:
        head = file.read(MAX_ROW_BYTES)
    if b"\0" in head:
        raise ValueError(f"{path}: expected text, got bytes that are not: {head[:16]!r}")
    rows = []
    place = 3 if head.startswith(b"\xef\xbb\xbf") else 0  # after a byte order mark
    for line, raw in enumerate(head[place:].split(b"\n"), 1):
        text = raw.decode("utf-8", "backslashreplace").strip(" \r")
        if text.strip():
            rows.append(_Row(text, place, place + len(raw), line))
        place += len(raw) + 1
    return rows


def open_txt(path: Path, options: ReadOptions) -> Source:
    """Open a `.txt` file.

    It is CSV if there are commas or semicolons in its first row, else in UZH's layout.
    """
    events = [row.text for row in _first_rows(path) if not row.is_comment]
    if events and ("," in events[0] or ";" in events[0]):
        return open_csv(path, options)
    return open_uzh_text(path, options)


def open_uzh_text(path: Path, options: ReadOptions) -> Source:
    """Open a text file in UZH's layout.

    Raises
    ------
    ValueError : the file has another layout, or its times are whole numbers, which may be seconds
        or microseconds.
    """
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
                    f"{path}: the file ends in its first line, {text!r}: no events, and perhaps "
                    "no sensor"
                )
            # The row `width height` ends before its line end. The first row of events may begin
            # with a line end, as blank lines are skipped.
            start = end
            rows = rows[1:]
        elif not columns or not _NUMBER.fullmatch(columns[0]) or len(columns) > 4:
            raise ValueError(
                f"{path}: expected {expected}, or first `width height`, got {text[:80]!r} "
                f"at line {line}"
            )
        _refuse_whole_times(path, rows, order.index("t"))
    return TextSource(path, start, line, tuple(order), None, 1e6, expected, sensor)


def _refuse_whole_times(path: Path, rows: list[_Row], column: int) -> None:
    """Refuse a file in which the times of all rows, in this column, are whole numbers."""
    words = [row.text.split() for row in rows]
    times = [row[column] for row in words if len(row) > column]
    numbers = [float(time) for time in times if _NUMBER.fullmatch(time)]
    whole_numbers = [number for number in numbers if number.is_integer()]
    are_all_whole = len(whole_numbers) == len(times)
    # times of 0 say nothing about the unit
    if are_all_whole and len(times) > 1 and any(whole_numbers):
        raise ValueError(
            f"{path}: times must be seconds with decimals, got whole numbers ({times[0]}, "
            f"{times[1]}, ...); if they are microseconds, write t,x,y,p with commas: CSV's times "
            "are microseconds"
        )


def open_csv(path: Path, options: ReadOptions) -> Source:
    """Open a CSV file; without a header, it must have four columns."""
    rows = _first_rows(path)
    sensor = _geometry(path, rows)
    n_comments = 0
    while n_comments < len(rows) and rows[n_comments].is_comment:
        n_comments += 1
    if n_comments == len(rows):  # no event in the first 64 KiB
        last = rows[-1] if rows else _Row("", 0, 0, 1)
        order = options.columns or _usual_order(sensor)
        names = _header_in(rows, len(order)) or list(order)
        return _csv_source(path, last.start, last.line, names, ",", sensor)

    first = rows[n_comments]
    separator, words = _split(first.text)
    if len(words) < 4:
        raise ValueError(
            f"{path}: expected at least four columns with commas, semicolons or tabs between them, "
            f"got {first.text[:80]!r} at line {first.line}"
        )
    start = first.start
    header = _header_in(rows[:n_comments], len(words))
    if header is None and _names_columns(words):
        _check_header(path, words, first)
        if len(rows) == 1 and path.stat().st_size == first.end:
            raise ValueError(f"{path}: the file ends in its header, {first.text[:80]!r}")
        header = words
        # The first row may begin with the header's line end, as blank lines are skipped.
        start = first.end
    if header is None:
        if len(words) != 4:
            raise ValueError(
                f"{path}: without a header there must be four columns t, x, y, p, got {len(words)} "
                f"in {first.text[:80]!r} at line {first.line}; with one, further columns are "
                "skipped"
            )
        header = list(_order_without_header(path, rows, separator, options, sensor))

    return _csv_source(path, start, first.line, header, separator, sensor)


def _csv_source(
    path: Path, start: int, line: int, header: list[str], separator: str, sensor: Sensor | None
) -> Source:
    """The source of rows whose columns the `header` names."""
    roles = _roles(path, header)
    expected = separator.join(header) + ", t in whole microseconds"
    return TextSource(path, start, line, roles, separator, 1.0, expected, sensor)


def _usual_order(sensor: Sensor | None) -> str:
    """The order of four columns without names; only Metavision's CSV states the sensor."""
    return CSV_ORDER if sensor is None else METAVISION_ORDER


def _header_in(comments: list[_Row], n_columns: int) -> list[str] | None:
    """The columns that the last header in these comments names, such as `# x,y,p,t`.

    None if no comment is a header.
    """
    for row in reversed(comments):
        names = _names_in(row.text.lstrip("".join(COMMENTS)), n_columns)
        if _is_header(names):
            return names
    return None


def _names_columns(words: list[str]) -> bool:
    """Whether one of the first two words of a row is a name rather than a number."""
    return any(re.search("[A-Za-z]", word) and not _NUMBER.fullmatch(word) for word in words[:2])


def _check_header(path: Path, names: list[str], row: _Row) -> None:
    """Refuse a header that does not name all of t, x, y and p."""
    if not _is_header(names):
        wanted = ", ".join("|".join(known) for known in NAMES.values())
        raise ValueError(
            f"{path}: the header must name {wanted}; got {row.text[:80]!r} at line {row.line}"
        )


def _roles(path: Path, header: list[str]) -> list[str]:
    """What each column of a header is: t, x, y, p, or "" where it is skipped."""
    roles = [""] * len(header)
    for field in "txyp":
        try:
            name = the_name(field, header, "the header")
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        roles[header.index(name)] = field
    return roles


def _order_without_header(
    path: Path, rows: list[_Row], separator: str, options: ReadOptions, sensor: Sensor | None
) -> str:
    """The order of four columns: as the caller states it, or else as the format has it.

    Raises
    ------
    SourceError : the numbers look like another order.
    """
    order = options.columns or _usual_order(sensor)
    table = _numbers(rows, separator)
    likely = order if table is None else likely_order(table, order)
    if likely != order:
        # {columns} stands for the name of the parameter, see `SourceError`.
        raise SourceError(
            str(path),
            f"the columns are not {order!r}; they look like {likely!r}: state their order with "
            "{columns}, or write a header",
        )
    return order


def _numbers(rows: list[_Row], separator: str) -> np.ndarray | None:
    """The first rows as numbers in shape (N, 4); None if one of them is something else."""
    events = [row.text for row in rows if not row.is_comment]
    if len(events) > 1:
        events.pop()  # it may be cut off
    rows_of_words = [text.split(separator) for text in events[:ORDER_ROWS]]
    try:
        table = np.array(
            [[_polarity(word.strip(" \r\"'")) for word in words] for words in rows_of_words]
        )
    except ValueError:  # a word is not a number, or the rows have different lengths
        return None
    return table if table.ndim == 2 and table.shape[1] == 4 else None


def _geometry(path: Path, rows: list[_Row]) -> Sensor | None:
    """The sensor in a line `%geometry:WIDTH,HEIGHT` before the first row; None without one."""
    for row in rows:
        if not row.is_comment:
            return None
        match = _GEOMETRY.fullmatch(row.text)
        if match is not None:
            return _checked_sides(path, match[1].split(","), row.text)
    return None


def _checked_sides(path: Path, words: list[str], text: str) -> Sensor:
    """Two words as (width, height).

    Raises
    ------
    ValueError : the words are not the sides of a sensor; the message quotes the line's `text`.
    """
    # `sides` lacks each word that is no number, or far too long for a side. `int` would refuse a
    # word of thousands of digits with a message of its own.
    decimals = [word for word in words if word.strip().isdecimal()]
    sides = [int(word) for word in decimals if len(word) < 20]
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
    """The words of a comment that may name columns, such as `# x,y,p,t` or `# x y p t`."""
    by_blanks = comment.lower().split()
    if len(by_blanks) == n_columns:
        return by_blanks
    _, by_separators = _split(comment)
    return by_separators


def _is_header(columns: list[str]) -> bool:
    """Whether all of t, x, y and p are named."""
    return all(set(columns).intersection(names) for names in NAMES.values())
