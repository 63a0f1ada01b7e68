"""AEDAT4, HDF5 and MATLAB files, read in a child process, because a damaged file can crash or hang their libraries.

faery panics on a damaged AEDAT4 file or asks for so much memory that its process is aborted; SciPy and Blosc's decoder
can crash on a damaged file, and HDF5 itself can read one forever. So `child_process.py` runs one of the readers beside
this file, `aedat4.py`, `hdf5.py` or `mat5.py`. Commands are lines of JSON in its standard input:

    ["sensor", READER, PATH]   it sends the sensor, as JSON: [width, height] or null
    ["events", READER, PATH]   it sends the events, in blocks: columns t, x, y, p as four rows of int64

Each answer ends with an empty message, then why the file cannot be read on, or another empty one. After damage, a
minute of silence, or an answer that was not read to its end, the child is killed; otherwise it reads the next file, as
starting one takes longer than reading a short file. It imports nothing from this package, which would take a second.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
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
        with _child() as child:
            sensor = list(self._ask(child, "sensor"))[-1]
            if isinstance(sensor, str):
                raise ValueError(f"{path}: not a readable {format} file: {sensor}")
        self.sensor = None if (sides := json.loads(sensor)) is None else (sides[0], sides[1])

    def blocks(self) -> Iterator[np.ndarray]:
        with _child() as child:
            yield from valid_blocks(_columns(self._ask(child, "events")))

    def _ask(self, child: Child, what: str) -> Iterator[bytes | str]:
        return child.ask(what, self._reader, str(self.path.absolute()))  # its own folder may be another


class Child:
    """A process that reads one file after another."""

    def __init__(self) -> None:
        from multiprocessing.connection import Pipe  # 15 ms that other formats need not wait for

        self._environment = _environment()
        self._receiver, sender = Pipe(duplex=False)
        with sender:
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(Path(__file__).with_name("child_process.py")), str(sender.fileno())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=self._environment,
                **_inherited(sender.fileno()),
            )

    @property
    def is_usable(self) -> bool:
        """It is alive, and would be started in the same way."""
        return self._process.poll() is None and self._environment == _environment()

    def ask(self, *command: str) -> Iterator[bytes | str]:
        """The messages of its answer; then, if the file could not be read on, a str that says why."""
        assert self._process.stdin is not None  # for mypy: it is a pipe
        try:
            self._process.stdin.write(json.dumps(command).encode() + b"\n")
            self._process.stdin.flush()
            while self._receiver.poll(SILENCE_S):
                if message := self._receiver.recv_bytes(MAX_MESSAGE_BYTES):
                    yield message
                else:
                    if error := self._receiver.recv_bytes(MAX_MESSAGE_BYTES):
                        yield error.decode()
                    return
            yield STOPPED
        except (EOFError, OSError):
            yield STOPPED

    def end(self) -> None:
        """Kill it."""
        self._process.kill()
        with suppress(OSError):  # a command that it has not read
            self._process.communicate()
        self._receiver.close()


_idle: dict[int, Child] = {}  # one at most, by process: a forked one must not use that of its parent


@contextmanager
def _child() -> Iterator[Child]:
    """A child; kept for the next file, but killed after an error, or if its answer was not read to the end."""
    child = _idle.pop(os.getpid(), None)
    if child is not None and not child.is_usable:
        child.end()
        child = None
    child = child or Child()
    try:
        yield child
    except BaseException:
        child.end()
        raise
    if _idle.setdefault(os.getpid(), child) is not child:  # another thread's was kept
        child.end()


@atexit.register
def _end_idle() -> None:
    if child := _idle.pop(os.getpid(), None):
        child.end()


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "RUST_BACKTRACE": "0"}


def _columns(messages: Iterable[bytes | str]) -> Iterator[Four]:
    n_read = 0
    for message in messages:
        if isinstance(message, str):
            raise CorruptData(f"after event {n_read}: {message}")
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
        raise ImportError(f"{path}: {format} is read by {library}, which is missing: pip install 'async_tnt[{extra}]'")
    return ChildSource(path, reader, format)
