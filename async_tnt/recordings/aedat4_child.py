"""The process that reads an AEDAT4 file with faery: `python aedat4_child.py FILE`, see `aedat4.py`.

Its first line is {"sensor": [width, height]} or {"error": "..."}; see `child.py` for the rest.
"""

from __future__ import annotations

import json
import signal
import struct
import sys
from contextlib import suppress
from typing import IO, Any

import numpy as np

READ_S = 120  # a packet takes milliseconds, but a disk may sleep
MOST_BYTES = 4 << 30  # of addresses; a packet takes megabytes, but a damaged file may ask for anything
DTYPE = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])


class Watched:
    """Stdout. Where nothing is written for `READ_S`, the system ends this process: who started it does so, too, but may
    be gone, and a library that hangs can do nothing by itself."""

    def __init__(self, out: IO[bytes]) -> None:
        self._out = out
        self._alarm = getattr(signal, "alarm", lambda seconds: 0)  # Windows has none
        self._alarm(READ_S)

    def write(self, data: bytes) -> None:
        self._alarm(0)  # who reads may take his time
        self._out.write(data)
        self._out.flush()
        self._alarm(READ_S)

    def flush(self) -> None:
        """Nothing is held back."""


def _write(out: Watched, **said: Any) -> None:
    out.write(json.dumps(said).encode() + b"\n")
    out.flush()


def _limit_memory() -> None:
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))


def main(path: str, out: Watched) -> None:
    from faery.extension import aedat

    try:
        decoder = aedat.Decoder(path)
        tracks = decoder.tracks()
    except BaseException as error:  # pyo3's PanicException derives from BaseException alone
        said = " ".join(str(error).split())[:200] or type(error).__name__
        return _write(out, error=f"not a readable AEDAT4 file: {said}")
    track = next((track for track in tracks if track.data_type == "events"), None)
    if track is None:
        kinds = ", ".join(track.data_type for track in tracks) or "none"
        return _write(out, error=f"the file must have a stream of events; its streams are: {kinds}")
    _write(out, sensor=None if track.dimensions is None else [int(side) for side in track.dimensions])
    try:
        for found, packet in decoder:
            if found.id != track.id or found.data_type != "events" or len(packet) == 0:
                continue
            events = np.empty(len(packet), DTYPE)
            for ours, theirs in (("t", "t"), ("x", "x"), ("y", "y"), ("p", "on")):
                events[ours] = packet[theirs]
            out.write(struct.pack("<I", len(events)) + events.tobytes())
            out.flush()
    except BrokenPipeError:  # the reader has seen enough
        return None
    except BaseException as error:
        out.write(bytes(4))
        return _write(out, error=" ".join(str(error).split())[:200] or type(error).__name__)
    out.write(bytes(4))
    _write(out)


if __name__ == "__main__":
    _limit_memory()
    main(sys.argv[1], Watched(sys.stdout.buffer))
