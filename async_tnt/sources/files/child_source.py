"""AEDAT4, HDF5 and MATLAB files, read in a child process, because a damaged file can crash or hang their libraries.

faery panics on a damaged AEDAT4 file or asks for so much memory that its process is aborted; Blosc's decoder can crash
on a damaged HDF5 file, and HDF5 itself can read one forever. So `child_process.py` runs one of the readers beside this
file, `aedat4.py`, `hdf5.py` or `mat5.py`, and sends what it reads through a pipe, as messages:

    the sensor           JSON: [width, height] or null
    a block of events    its columns t, x, y, p: four rows of int64; any number of such messages
    the end              an empty message, then why the file cannot be read on, or another empty one

The child is killed after a minute of silence. It imports nothing from this package, which would take a second.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.event_forms import Four
from async_tnt.sources.files.source import CorruptData, Source, valid_blocks

SILENCE_S = 60.0  # a block takes milliseconds, but a disk may sleep, and a machine be busy
MAX_MESSAGE_BYTES = 1 << 30  # megabytes, but a child that is about to crash may send anything
STOPPED = "the process that reads it crashed or hung"


class ChildSource(Source):
    """The events of one file, read in a child process.

    Parameters
    ----------
    reader : the script beside this one that reads it.
    format : its name, for messages.
    """

    def __init__(self, path: Path, reader: str, format: str) -> None:
        self.path = path
        self._reader = reader
        path.open("rb").close()  # raises the OSError of a missing file
        with closing(self._messages()) as messages:
            sensor = next(messages, STOPPED)
        if isinstance(sensor, str):
            raise ValueError(f"{path}: not a readable {format} file: {sensor}")
        self.sensor = None if (sides := json.loads(sensor)) is None else (sides[0], sides[1])

    def blocks(self) -> Iterator[np.ndarray]:
        with closing(self._messages()) as messages:
            yield from valid_blocks(_columns(messages))

    def _messages(self) -> Generator[bytes | str, None, None]:
        """The messages of a new child up to the end; then, if the file could not be read on, a str that says why."""
        from multiprocessing.connection import Pipe  # 15 ms that other formats need not wait for

        receiver, sender = Pipe(duplex=False)
        script = Path(__file__).with_name("child_process.py")
        with receiver, sender:
            process = subprocess.Popen(
                [sys.executable, "-P", str(script), self._reader, str(self.path), str(sender.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "RUST_BACKTRACE": "0"},
                **_inherited(sender.fileno()),
            )
            sender.close()
            try:
                while receiver.poll(SILENCE_S):
                    if message := receiver.recv_bytes(MAX_MESSAGE_BYTES):
                        yield message
                    else:
                        if error := receiver.recv_bytes(MAX_MESSAGE_BYTES):
                            yield error.decode()
                        return
                yield STOPPED
            except (EOFError, OSError):
                yield STOPPED
            finally:
                process.kill()
                process.wait()


def _columns(messages: Iterable[bytes | str]) -> Iterator[Four]:
    n_read = 0
    for i, message in enumerate(messages):
        if isinstance(message, str):
            raise CorruptData(f"after event {n_read}: {message}")
        if i > 0:  # after the sensor
            t, x, y, p = np.frombuffer(message, np.int64).reshape(4, -1)
            yield t, x, y, p
            n_read += len(t)


def _inherited(fd: int) -> dict[str, Any]:
    """The arguments of `Popen` that hand one end of a pipe to the child."""
    if os.name != "nt":
        return {"pass_fds": [fd]}
    os.set_handle_inheritable(fd, True)  # type: ignore[attr-defined,unused-ignore]
    return {"startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [fd]})}  # type: ignore[attr-defined,unused-ignore]


def open_aedat4(path: Path) -> Source:
    """Open an AEDAT4 file."""
    return _open(path, "aedat4.py", "AEDAT4", "faery", "files")


def open_hdf5(path: Path) -> Source:
    """Open an HDF5 file of events."""
    return _open(path, "hdf5.py", "HDF5", "h5py", "hdf5")


def open_mat(path: Path) -> Source:
    """Open a MATLAB file of events; version 7.3 is HDF5."""
    with path.open("rb") as file:
        if file.read(10) == b"MATLAB 7.3":
            return open_hdf5(path)
    return _open(path, "mat5.py", "MATLAB", "scipy", "matlab")


def _open(path: Path, reader: str, format: str, library: str, extra: str) -> Source:
    if find_spec(library) is None:
        raise ImportError(f"{path}: {format} files are read by {library}, which is missing: pip install '.[{extra}]'")
    return ChildSource(path, reader, format)
