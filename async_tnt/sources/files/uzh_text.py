"""UZH's text files: an event per line, `t x y p`, t in seconds; first, at will, the sensor's `width height`.

    240 180
    0.003811000 96 133 0
    0.003820001 17 37 1

Times are turned into microseconds digit by digit, to the nearest one: no float is in between. Polarity is 0/1 or
-1/+1. Lines that begin with # or % are comments.

References
----------
Mueggler, Rebecq, Gallego, Delbruck, Scaramuzza 2017, The Event-Camera Dataset and Simulator, IJRR 36(2): events.txt.
"""

from __future__ import annotations

import re
from pathlib import Path

from async_tnt.kernels.text import BLANKS, P, T, X, Y
from async_tnt.sources.files.source import Sensor, Source
from async_tnt.sources.files.text_rows import COMMENTS, RowSource, head_rows

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
EXPECTED = "`t x y p`, t in seconds"


def open_uzh_text(path: Path) -> Source:
    """Open a text file in UZH's layout.

    Raises
    ------
    ValueError : its first line is neither the sensor nor an event, or its times are whole numbers throughout,
        which may be seconds or microseconds.
    OSError : missing or not readable.
    """
    rows = [row for row in head_rows(path) if not row[0].startswith(COMMENTS)]
    sensor: Sensor | None = None
    start, line = 0, 1
    if rows:
        text, start, end, line = rows[0]
        columns = text.split()
        if len(columns) == 2 and all(column.isdecimal() for column in columns):
            sensor = int(columns[0]), int(columns[1])
            if not (1 <= sensor[0] <= 1 << 16 and 1 <= sensor[1] <= 1 << 16):
                raise ValueError(f"{path}: a sensor must have 1 to 65536 pixels a side, got {text!r}")
            if len(rows) == 1 and path.stat().st_size == end:
                raise ValueError(f"{path}: the file ends in its first line, {text!r}: no events, and perhaps no sensor")
            start = end  # a line end, which the first row may begin with
        elif not columns or not _NUMBER.fullmatch(columns[0]) or len(columns) > 4:
            raise ValueError(f"{path}: expected {EXPECTED}, or first `width height`, got {text[:80]!r} at line {line}")
        times = [row[0].split()[0] for row in rows[1 if sensor else 0 :]]
        if len(times) > 1 and all(time.isdecimal() for time in times) and any(int(time) for time in times):
            raise ValueError(
                f"{path}: times must be seconds with decimals, got whole numbers ({times[0]}, {times[1]}, ...); "
                "if they are microseconds, write t,x,y,p with commas: CSV's times are microseconds"
            )
    return RowSource(path, start, line, (T, X, Y, P), BLANKS, 6, EXPECTED, sensor)
