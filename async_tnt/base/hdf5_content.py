"""The groups and data sets of an HDF5 file as plain data.

A damaged file can crash HDF5, let it run forever, or make it ask for any amount of memory. So the
file is read in a worker process, which has limits. Nothing of the file is trusted: sizes are
checked before values are read, and links to other files are refused.

The worker imports this module, which must import nothing that takes time.
"""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.messages import one_line, short
from async_tnt.base.worker import Worker

LIMIT_S = 30.0
"""Seconds after which a file counts as damaged. A file of `MAX_NUMBERS` takes some seconds."""

MAX_NUMBERS = 1 << 26
"""The most numbers in a file: as float64 they take half a gigabyte."""

MAX_TEXTS = 1 << 19
"""The most texts in a file."""

MAX_TEXT_BYTES = 1 << 24
"""The most bytes of all texts in a file."""

MAX_ENTRIES = 100_000
"""The most groups and data sets in a file."""

DEEPEST = 32
"""How deep groups may lie in groups. A group may hold itself."""

MAX_BYTES = 3 << 30
"""Bytes of address space that the worker may use: values, their copy for this process, libraries.
A damaged file may ask for any number of bytes."""


def read_hdf5(path: Path, group: str) -> dict[str, Any]:
    """The content of a group of an HDF5 file.

    Returns
    -------
    Name -> an array, a number, bytes (a text), or again such a mapping.

    Raises
    ------
    OSError : there is no such file, or it cannot be opened.
    ValueError : the file is damaged or too large, or holds other things. The message does not name
        the file.
    """
    path.open("rb").close()  # raises the OSError of a missing file
    worker = Worker()
    try:
        # the worker's own folder may be another
        worker.submit(_content_of, str(path.absolute()), group, limit_s=LIMIT_S)
        content: dict[str, Any] = worker.result(LIMIT_S)
    except Exception as error:
        raise ValueError(one_line(error)) from None
    finally:
        worker.end()
    return content


def _content_of(path: str, group: str) -> dict[str, Any]:
    """The content of a group. This runs in the worker."""
    import h5py

    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    with h5py.File(path, "r") as file:
        found = _entry(file, group)
        if not isinstance(found, h5py.Group):
            raise ValueError(f"it has no group {short(group)}")
        return _Reader(Path(path).stat().st_size).read(found, 0)


def _entry(group: Any, name: str) -> Any:
    """An entry of an HDF5 group, which must not be a link to somewhere else."""
    import h5py

    link = group.get(name, getlink=True)
    if link is not None and not isinstance(link, h5py.HardLink):
        raise ValueError(f"{short(name)} is a link to somewhere else")
    return group.get(name)


class _Reader:
    """Reads values, and counts what it has read."""

    def __init__(self, file_bytes: int) -> None:
        self._file_bytes = file_bytes
        self._n_numbers = 0
        self._n_entries = 0
        self._n_texts = 0
        self._n_text_bytes = 0

    def read(self, group: Any, depth: int) -> dict[str, Any]:
        """The content of a group."""
        import h5py

        if depth > DEEPEST:
            raise ValueError(f"groups lie in groups more than {DEEPEST} deep")
        self._n_entries += len(group)
        if self._n_entries > MAX_ENTRIES:
            raise ValueError(f"it has more than {MAX_ENTRIES:_} groups and data sets")
        content: dict[str, Any] = {}
        for name in group:
            entry = _entry(group, name)
            if isinstance(entry, h5py.Group):
                content[name] = self.read(entry, depth + 1)
            elif isinstance(entry, h5py.Dataset):
                content[name] = self._values(name, entry)
            else:
                raise ValueError(f"{short(name)} is neither a group nor a data set")
        return content

    def _values(self, name: str, dataset: Any) -> Any:
        """The values of a data set."""
        import h5py

        if dataset.is_virtual or dataset.external:
            raise ValueError(f"{short(name)} lies in another file")
        if dataset.shape is None:
            raise ValueError(f"{short(name)} is empty")
        text = h5py.check_string_dtype(dataset.dtype)
        if text is not None and text.length is None:
            return self._texts(name, dataset)
        if dataset.dtype.hasobject:
            raise ValueError(
                f"{short(name)} must hold numbers or texts, got {one_line(str(dataset.dtype), 80)}"
            )
        numbers_of_one = max(1, dataset.dtype.itemsize // 8)
        n_numbers = math.prod(dataset.shape) * numbers_of_one
        n_of_chunk = math.prod(dataset.chunks or (0,)) * numbers_of_one
        self._n_numbers += max(n_numbers, n_of_chunk)
        if self._n_numbers > MAX_NUMBERS:
            raise ValueError(
                f"with {short(name)} it has {self._n_numbers:_} numbers, more than {MAX_NUMBERS:_}"
            )
        return dataset[()]

    def _texts(self, name: str, dataset: Any) -> Any:
        """The values of a data set of texts, each of which has its own length.

        They are read in blocks, because many of them may be one and the same long text in the file.
        """
        self._n_texts += math.prod(dataset.shape)
        if self._n_texts > MAX_TEXTS:
            raise ValueError(f"with {short(name)} it has more than {MAX_TEXTS:_} texts")
        if not dataset.shape:
            values = dataset[()]
            self._count_bytes(name, [values])
            return values
        texts_of_a_row = max(1, math.prod(dataset.shape[1:]))
        n_rows = max(1, MAX_TEXT_BYTES // (texts_of_a_row * max(1, self._file_bytes)))
        values = np.empty(dataset.shape, object)
        for first in range(0, dataset.shape[0], n_rows):
            block = dataset[first : first + n_rows]
            self._count_bytes(name, block.reshape(-1).tolist())
            values[first : first + n_rows] = block
        return values

    def _count_bytes(self, name: str, texts: list[bytes]) -> None:
        """Refuse too long texts."""
        self._n_text_bytes += sum(map(len, texts))
        if self._n_text_bytes > MAX_TEXT_BYTES:
            raise ValueError(
                f"with {short(name)} its texts have more than {MAX_TEXT_BYTES:_} bytes"
            )
