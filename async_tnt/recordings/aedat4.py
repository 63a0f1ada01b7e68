"""AEDAT4 files (`.aedat4`) of DV, by faery (extra `files`). The first stream of events is read.

faery runs in a process of its own. It is written in Rust, and takes a file at its word: on a damaged one it panics
with a backtrace on stderr and an exception that `except Exception` does not catch, or asks for so much memory
that its process is aborted. Ours must outlive that.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np

from async_tnt.recordings.aedat4_child import DTYPE
from async_tnt.recordings.damage import Damage
from async_tnt.recordings.source import Source, packed

SILENCE_S = 60.0  # a packet takes milliseconds


class Aedat4Source(Source):
    """The events of the file's first stream of events.

    Raises
    ------
    ImportError : faery is not installed.
    ValueError : no AEDAT4 file, or none with a stream of events.
    """

    def __init__(self, path: Path) -> None:
        if find_spec("faery") is None:
            raise ImportError(f"{path}: AEDAT4 files are read by faery, which is missing: pip install '.[files]'")
        self.path = path
        path.open("rb").close()  # so that a missing file is an OSError
        with _faery(path) as out:
            said = _said(out)
        if "error" in said:
            raise ValueError(f"{path}: not a readable AEDAT4 file: {said['error']}")
        self.sensor = None if said["sensor"] is None else (said["sensor"][0], said["sensor"][1])

    def blocks(self) -> Iterator[np.ndarray]:
        n_read = 0
        with _faery(self.path) as out:
            said = _said(out)
            while "error" not in said:
                count = out.read(4)
                if count == bytes(4):
                    said = _said(out)
                    break
                size = DTYPE.itemsize * struct.unpack("<I", count)[0] if len(count) == 4 else -1
                data = out.read(size) if size >= 0 else b""
                if len(data) != size:
                    said = STOPPED
                    break
                packet = np.frombuffer(data, DTYPE)
                t = packet["t"].astype(np.int64)  # what is beyond int64 turns negative, which no time is
                events, problem = packed(t, packet["x"], packet["y"], packet["p"])
                yield events
                n_read += len(events)
                if problem is not None:
                    raise Damage(f"event {n_read}: {problem}")
        if "error" in said:
            raise Damage(f"after event {n_read}: {said['error']}")


STOPPED = {"error": "faery stopped for good at the damage"}


def _said(out: IO[bytes]) -> dict[str, Any]:
    line = out.readline()
    return json.loads(line) if line.endswith(b"\n") else STOPPED


class _Watched:
    """The child's stdout; the child is killed when a read waits too long."""

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdout is not None  # it is a pipe
        self._child, self._out = child, child.stdout

    def read(self, size: int) -> bytes:
        return self._guarded(self._out.read, size)

    def readline(self) -> bytes:
        return self._guarded(self._out.readline)

    def _guarded(self, call: Any, *args: int) -> bytes:
        timer = threading.Timer(SILENCE_S, self._child.kill)
        timer.daemon = True
        timer.start()
        try:
            return call(*args)
        finally:
            timer.cancel()


@contextmanager
def _faery(path: Path) -> Iterator[Any]:
    """What a new process that reads the file writes; the process ends with the block."""
    child = subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).with_name("aedat4_child.py")), str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "RUST_BACKTRACE": "0"},
    )
    try:
        yield _Watched(child)
    finally:
        child.kill()
        child.wait()
        assert child.stdout is not None
        child.stdout.close()


def open_aedat4(path: Path) -> Source:
    """Open an AEDAT4 file."""
    return Aedat4Source(path)
