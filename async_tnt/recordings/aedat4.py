"""AEDAT4 files (`.aedat4`) of DV, by faery (extra `files`). The first stream of events is read.

faery runs in a process of its own. It is written in Rust, and takes a file at its word: on a damaged one it panics
with a backtrace on stderr and an exception that `except Exception` does not catch, or asks for so much memory
that its process is aborted. Ours must outlive that.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from async_tnt.recordings.aedat4_child import DTYPE
from async_tnt.recordings.child import child_process
from async_tnt.recordings.damage import Damage
from async_tnt.recordings.source import Source, packed

SCRIPT = "aedat4_child.py"


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
        with child_process(SCRIPT, str(path)) as faery:
            said = faery.said()
        if "error" in said:
            raise ValueError(f"{path}: not a readable AEDAT4 file: {said['error']}")
        self.sensor = None if said["sensor"] is None else (said["sensor"][0], said["sensor"][1])

    def blocks(self) -> Iterator[np.ndarray]:
        n_read = 0
        with child_process(SCRIPT, str(self.path)) as faery:
            said = faery.said()
            if "error" in said:
                raise Damage(f"after event 0: {said['error']}")
            for data in faery.packets(DTYPE.itemsize):
                if isinstance(data, str):
                    raise Damage(f"after event {n_read}: {data}")
                packet = np.frombuffer(data, DTYPE)
                t = packet["t"].astype(np.int64)  # what is beyond int64 turns negative, which no time is
                events, problem = packed(t, packet["x"], packet["y"], packet["p"])
                yield events
                n_read += len(events)
                if problem is not None:
                    raise Damage(f"event {n_read}: {problem}")


def open_aedat4(path: Path) -> Source:
    """Open an AEDAT4 file."""
    return Aedat4Source(path)
