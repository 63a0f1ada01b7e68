"""AEDAT4 files (`.aedat4`) of DV, by faery (extra `files`). The first stream of events is read.

faery runs in a process of its own. It is written in Rust, and takes a file at its word: on a damaged one it panics
with a backtrace on stderr and an exception that `except Exception` does not catch, or asks for so much memory
that its process is aborted. Ours must outlive that.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from async_tnt.sources.files.aedat4_child import DTYPE
from async_tnt.sources.files.child import ChildSource
from async_tnt.sources.files.source import Source, packed


class Aedat4Source(ChildSource):
    """The events of the file's first stream of events.

    Raises
    ------
    ImportError : faery is not installed.
    ValueError : no AEDAT4 file, or none with a stream of events.
    """

    event_bytes = DTYPE.itemsize

    def __init__(self, path: Path) -> None:
        if find_spec("faery") is None:
            raise ImportError(f"{path}: AEDAT4 files are read by faery, which is missing: pip install '.[files]'")
        super().__init__(path, "aedat4_child.py")

    def decoded(self, data: bytes) -> tuple[np.ndarray, str | None]:
        packet = np.frombuffer(data, DTYPE)
        t = packet["t"].astype(np.int64)  # what is beyond int64 turns negative, which no time is
        return packed(t, packet["x"], packet["y"], packet["p"])


def open_aedat4(path: Path) -> Source:
    """Open an AEDAT4 file."""
    return Aedat4Source(path)
