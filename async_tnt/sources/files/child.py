"""Sources read in a process of their own, for libraries that a damaged file can crash; ours must outlive that.

The process runs `child_end.py`, and with it a reader beside this file. It writes to stdout: a line of JSON, {...} or
{"error": "..."}; then, for each packet, the number of its events (4 bytes, little-endian) and their bytes; at the end,
0, and a line of JSON again. Nothing of ours is imported there: that would take it a second. It is ended where it hangs:
by this process, or by its own alarm where this one was killed.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import threading
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.sources.files.damage import Damage
from async_tnt.sources.files.source import Source

SILENCE_S = 60.0  # a packet takes milliseconds, but a disk may sleep, and a machine be busy
STOPPED = {"error": "its reader stopped for good, or hung, at the damage"}


class ChildSource(Source):
    """The events of one file, read by a reader beside this file.

    Parameters
    ----------
    path : the file.
    reader : its name.

    Raises
    ------
    ValueError : the reader says why the file cannot be read. OSError : it is missing or not readable.
    """

    def __init__(self, path: Path, reader: str) -> None:
        self.path, self._reader = path, reader
        path.open("rb").close()  # so that a missing file is an OSError
        with child_process(reader, path) as child:
            self.said = child.said()
        if "error" in self.said:
            raise ValueError(f"{path}: {self.said['error']}")
        sensor = self.said["sensor"]
        self.sensor = None if sensor is None else (sensor[0], sensor[1])

    event_bytes: int
    """Of one event, as the reader writes it."""

    @abstractmethod
    def decoded(self, data: bytes) -> tuple[np.ndarray, str | None]:
        """The events of a packet of the reader's, as `packed` gives them."""

    def blocks(self) -> Iterator[np.ndarray]:
        n_read = 0
        with child_process(self._reader, self.path) as child:
            said = child.said()
            if "error" in said:
                raise Damage(f"after event 0: {said['error']}")
            for data in child.packets(self.event_bytes):
                if isinstance(data, str):
                    raise Damage(f"after event {n_read}: {data}")
                events, problem = self.decoded(data)
                yield events
                n_read += len(events)
                if problem is not None:
                    raise Damage(f"event {n_read}: {problem}")


class Child:
    """What the process writes; the process is killed when a read waits too long."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None  # it is a pipe
        self._process, self._out = process, process.stdout

    def said(self) -> dict[str, Any]:
        """The line of JSON that comes now."""
        line = self._guarded(self._out.readline)
        return json.loads(line) if line.endswith(b"\n") else STOPPED

    def packets(self, event_bytes: int) -> Iterator[bytes | str]:
        """The events of each packet; last of all, where there was one, the error in words."""
        while True:
            count = self._guarded(self._out.read, 4)
            if count == bytes(4):
                said = self.said()
                break
            size = event_bytes * struct.unpack("<I", count)[0] if len(count) == 4 else -1
            data = self._guarded(self._out.read, size) if size >= 0 else b""
            if len(data) != size:
                said = STOPPED
                break
            yield data
        if "error" in said:
            yield said["error"]

    def _guarded(self, call: Any, *args: int) -> bytes:
        timer = threading.Timer(SILENCE_S, self._process.kill)
        timer.daemon = True
        timer.start()
        try:
            return call(*args)
        finally:
            timer.cancel()


@contextmanager
def child_process(reader: str, path: Path) -> Iterator[Child]:
    """A new process in which a reader reads the file; it ends with the block."""
    process = subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).with_name("child_end.py")), reader, str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "RUST_BACKTRACE": "0"},
    )
    try:
        yield Child(process)
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
