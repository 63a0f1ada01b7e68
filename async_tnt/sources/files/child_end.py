"""The other end of a `ChildSource`: `python child_end.py READER.py FILE` runs a reader, which lies beside this file.

A reader has `write_events(path, out)`, which tells an `Out` what the file holds.
"""

from __future__ import annotations

import json
import runpy
import signal
import struct
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

READ_S = 120  # a packet takes milliseconds, but a disk may sleep
MOST_BYTES = 4 << 30  # of addresses; a packet takes megabytes, but a damaged file may ask for anything


class Out:
    """What the other process gets to know, in the form that `child.py` says.

    Parameters
    ----------
    stream : bytes go there, at once.
    read_s : the system ends this process where nothing is written for so many seconds; 0: never. Who started it does
        so, too, but may be gone, and a library that hangs can do nothing by itself.
    """

    def __init__(self, stream: IO[bytes], read_s: int = 0) -> None:
        self._stream, self._read_s = stream, read_s
        self._is_open = False
        self._wait(read_s)

    def open(self, **said: Any) -> None:
        """The file can be read: what there is to know of it."""
        self._write(_line(said))
        self._is_open = True

    def packet(self, n: int, events: bytes) -> None:
        """n events."""
        self._write(struct.pack("<I", n) + events)

    def end(self, error: str = "") -> None:
        """No more events; or why the file cannot be read, or not further."""
        said = _line({"error": " ".join(error.split())[:300]} if error else {})
        self._write(bytes(4) + said if self._is_open else said)

    def _write(self, data: bytes) -> None:
        self._wait(0)  # who reads may take his time
        self._stream.write(data)
        self._stream.flush()
        self._wait(self._read_s)

    def _wait(self, seconds: int) -> None:
        if self._read_s and hasattr(signal, "alarm"):  # Windows has none
            signal.alarm(seconds)


def _line(said: dict[str, Any]) -> bytes:
    return json.dumps(said).encode() + b"\n"


def _limit_memory() -> None:
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))


if __name__ == "__main__":
    _limit_memory()
    reader = runpy.run_path(str(Path(__file__).with_name(sys.argv[1])))
    with suppress(BrokenPipeError):  # who reads has seen enough
        reader["write_events"](sys.argv[2], Out(sys.stdout.buffer, READ_S))
