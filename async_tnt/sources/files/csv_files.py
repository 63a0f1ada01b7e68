"""CSV: an event per row, whole microseconds; the separator is a comma, a semicolon or a tab.

With a header, its names say which column is what (t|ts|timestamp, x, y, p|on|polarity|pol; others are left out);
without, the columns are t, x, y, p. Polarity is 0/1, -1/+1 or False/True.
"""

from __future__ import annotations

import re
from pathlib import Path

from async_tnt.event_forms import NAMES, the_name
from async_tnt.kernels.text import SKIPPED
from async_tnt.sources.files.source import Source
from async_tnt.sources.files.text_rows import COMMENTS, ROLES, RowSource, head_rows

SEPARATORS = ",;\t"


def open_csv(path: Path) -> Source:
    """Open a CSV file.

    Raises
    ------
    ValueError : no separator, a header without one of the four names, or no header and other than four columns.
    OSError : missing or not readable.
    """
    rows = head_rows(path)
    header: list[str] | None = None
    start, line = 0, 1
    for text, start, end, line in rows:  # noqa: B007
        if not text.startswith(COMMENTS):
            break
        names = _split(text.lstrip("".join(COMMENTS)))
        if _is_header(names):  # `# x,y,p,t`: a comment that is a header
            header = names
    else:
        return RowSource(path, start, line, tuple(ROLES.values()), ord(","), 0, "t,x,y,p")
    columns = _split(text)
    if len(columns) < 4:
        raise ValueError(
            f"{path}: expected at least four columns with commas, semicolons or tabs between them, "
            f"got {text[:80]!r} at line {line}"
        )
    separator = _separator(text)
    if header is None and any(re.search("[A-Za-z]", column) for column in columns[:2]):
        header = columns
        if not _is_header(header):
            wanted = ", ".join("|".join(names) for names in NAMES.values())
            raise ValueError(f"{path}: the header must name {wanted}; got {text[:80]!r} at line {line}")
        if len(rows) == 1 and path.stat().st_size == end:
            raise ValueError(f"{path}: the file ends in its header, {text[:80]!r}")
        start = end  # a line end, which the first row may begin with
    if header is None:
        if len(columns) != 4:
            raise ValueError(
                f"{path}: without a header there must be four columns t, x, y, p, got {len(columns)} in "
                f"{text[:80]!r} at line {line}; with one, further columns are left out"
            )
        header = list(ROLES)
    lower = [name.lower() for name in header]
    roles = [SKIPPED] * len(header)
    for field in ROLES:
        try:
            roles[lower.index(the_name(field, lower, "the header"))] = ROLES[field]
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    expected = separator.join(header) + ", t in whole microseconds"
    return RowSource(path, start, line, roles, ord(separator), 0, expected)


def _separator(text: str) -> str:
    return max(SEPARATORS, key=text.count)


def _split(text: str) -> list[str]:
    return [column.strip(" \r\"'") for column in text.split(_separator(text))]


def _is_header(columns: list[str]) -> bool:
    """Whether all of t, x, y and p are named."""
    lower = {name.lower() for name in columns}
    return all(lower.intersection(names) for names in NAMES.values())
