"""Readers of AEDAT4, ES and HDF5 files, which run in a worker process.

A damaged file can crash or hang the libraries that read it. faery panics, or asks for so much
memory that its process is aborted. Blosc's decoder can crash, and HDF5 itself can read a damaged
file forever.

The worker is ended after damage, after a minute of silence, or after a file that was not read to
its end. Otherwise it reads the next file, as the start of a worker takes longer than reading a
short file.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.messages import one_line
from async_tnt.base.worker import Worker
from async_tnt.sources.files import library_readers
from async_tnt.sources.files.source import CorruptData, ReadOptions, Source, valid_blocks
from async_tnt.sources.files.source_error import SourceError

SILENCE_S = 60.0
"""Seconds to wait for an answer of the worker. A block takes milliseconds, but a disk may sleep,
and a machine may be busy."""

AHEAD = 8
"""Number of calls that wait at the worker at once. Blocks may be small, and one call at a time
would make each of them wait for an answer."""

READ_S = 120.0
"""Seconds of one call after which a worker ends itself, if its parent has not ended it."""


class WorkerSource(Source):
    """The events of one file, read in a worker process.

    Parameters
    ----------
    path : path of the file.
    read : function that reads the file in the worker, see `library_readers.py`.
    format : name of the format.

    Attributes
    ----------
    unit : name of the unit in which the reader's blocks are counted, for messages.
    """

    unit = "event"

    def __init__(self, path: Path, read: library_readers.Reader, format: str) -> None:
        self._path = str(path.absolute())  # the worker's own folder may be another
        self._read = read
        self.format = format
        path.open("rb").close()  # raises the OSError of a missing file
        with _worker() as worker:
            worker.submit(library_readers.head_of, read, self._path, limit_s=READ_S)
            try:
                head, self._first = worker.result(SILENCE_S)
            except SourceError as error:
                raise error.of(path, f"not a readable {format} file: ") from None
            except Exception as error:
                raise ValueError(
                    f"{path}: not a readable {format} file: {one_line(error)}"
                ) from None
        self._take_head(head)

    def blocks(self) -> Iterator[np.ndarray]:
        with _worker() as worker:
            worker.submit(library_readers.start, self._read, self._path, limit_s=READ_S)
            for _ in range(AHEAD):
                worker.submit(library_readers.next_block, limit_s=READ_S)
            yield from self._events_of(self._received(worker))

    def check_first(self) -> None:
        if self._first is None:
            return
        for events in self._events_of([self._first]):
            if len(events):
                return

    def _take_head(self, head: Any) -> None:
        """Store the first value that the reader yields."""
        self.sensor = head

    def _size_of(self, block: Any) -> int:
        """The number of units in a block."""
        return len(block[0])

    def _events_of(self, blocks: Iterable[Any]) -> Iterator[np.ndarray]:
        """The events in blocks of the reader."""
        return valid_blocks(blocks)

    def _received(self, worker: Worker) -> Iterator[Any]:
        """The blocks of a file that the worker has started to read.

        The worker reads on while a block is used.
        """
        n_read = 0
        try:
            worker.result(SILENCE_S)  # what `start` returns: the sensor
            while (block := worker.result(SILENCE_S)) is not None:
                worker.submit(library_readers.next_block, limit_s=READ_S)
                yield block
                n_read += self._size_of(block)
            for _ in range(AHEAD - 1):  # the calls that still wait are answered, too, with None
                worker.result(SILENCE_S)
        except Exception as error:
            raise CorruptData(f"after {self.unit} {n_read}: {one_line(error)}") from None


_idle: dict[int, Worker] = {}
"""Process id -> its idle worker. A forked process must not use the worker of its parent."""


@contextmanager
def _worker() -> Iterator[Worker]:
    """A worker, which is kept for the next file.

    The worker is ended after an error, or if the file was not read to its end.
    """
    worker = _idle.pop(os.getpid(), None)
    if worker is not None and not worker.is_running:
        worker.end()
        worker = None
    worker = worker or Worker()
    try:
        yield worker
    except BaseException:
        worker.end()
        raise
    if _idle.setdefault(os.getpid(), worker) is not worker:  # another thread has kept its worker
        worker.end()


@atexit.register
def _end_idle() -> None:
    worker = _idle.pop(os.getpid(), None)
    if worker is not None:
        worker.end()


def _open(
    read: library_readers.Reader,
    format: str,
    library: str,
    extra: str,
    path: Path,
    options: ReadOptions,
) -> Source:
    """Open a file that `read` reads in the worker.

    Raises
    ------
    ImportError : the `library` is missing; `extra` installs it.
    """
    if find_spec(library) is None:
        raise ImportError(
            f"{path}: {format} is read by {library}, which is missing: pip install "
            f"'async_tnt[{extra}]'"
        )
    return WorkerSource(path, read, format)


open_aedat4 = partial(_open, library_readers.read_aedat4, "AEDAT4", "faery", "files")
open_es = partial(_open, library_readers.read_es, "ES", "faery", "files")
open_hdf5 = partial(_open, library_readers.read_hdf5, "HDF5", "h5py", "hdf5")
"""Functions of a path and `ReadOptions`. Each opens a file of one format as a `Source`."""
