"""The header of Prophesee's RAW and DAT files: lines that begin with `% `, before the bytes of the events."""

from __future__ import annotations

import re
from pathlib import Path

from async_tnt.sources.files.source import Sensor

MAX_HEADER_BYTES = 1 << 16
_SIZE = re.compile(r"\d{1,5}")


class PropheseeHeader:
    """
    Attributes
    ----------
    fields : keyword in lower case -> the rest of its line.
    options : what `% format EVT3;height=720;width=1280` says after the name, in lower case.
    length : bytes of the header.
    sensor : (width, height), from geometry, format or Width and Height; None where none says it.
    """

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            data = file.read(MAX_HEADER_BYTES)
            ends = len(data) < MAX_HEADER_BYTES
        self.path = path
        self.fields: dict[str, str] = {}
        self.length = 0
        # an event's first byte can be a %, but hardly a line of text follows
        while data.startswith(b"% ", self.length):
            end = data.find(b"\n", self.length)
            line = data[self.length : end if end >= 0 else len(data)].rstrip(b"\r")
            if not all(32 <= byte < 127 or byte == 9 for byte in line):
                break
            if end < 0:
                if ends:
                    raise ValueError(f"{path}: the file ends inside its header, in {line.decode()[:80]!r}")
                break
            self.length = end + 1
            keyword, _, rest = line[2:].decode().strip().partition(" ")
            if keyword.lower() == "end":
                break
            self.fields[keyword.lower()] = rest.strip()
        self.format, *options = self.fields.get("format", "").lower().split(";")
        pairs = (option.partition("=") for option in options)
        self.options = {name.strip(): value.strip() for name, _, value in pairs}
        self.sensor = self._sensor()

    @property
    def t0_us(self) -> int:
        """What faery takes off the times when it writes; 0 where the header does not say it."""
        t0 = self.fields.get("t0", "0")
        if not t0.isdecimal() or len(t0) > 18:
            raise ValueError(f"{self.path}: `% t0` must be whole microseconds, got {t0[:40]!r}")
        return int(t0)

    def _sensor(self) -> Sensor | None:
        fields = self.fields
        if "geometry" in fields:
            sides = fields["geometry"].lower().split("x")
        elif "width" in self.options and "height" in self.options:
            sides = [self.options["width"], self.options["height"]]
        elif "width" in fields and "height" in fields:
            sides = [fields["width"], fields["height"]]
        else:
            return None
        if len(sides) != 2 or not all(_SIZE.fullmatch(side) and 1 <= int(side) <= 1 << 16 for side in sides):
            raise ValueError(f"{self.path}: the header's sensor must be two sizes in pixels, got {'x'.join(sides)!r}")
        return int(sides[0]), int(sides[1])
