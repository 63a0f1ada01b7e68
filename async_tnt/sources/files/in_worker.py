"""What a worker process does for a `WorkerSource`: it reads one file after another. Imports nothing that takes time.

A reader is a function of a path. It yields the sensor, (width, height) or None, then blocks of events, each as a list
of four columns of integers: t, x, y, p. It raises an exception where the file cannot be read on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np

MAX_BYTES = 4 << 30  # of addresses; a block takes megabytes, but a damaged file may ask for anything

Reader = Callable[[str], Iterator[Any]]

_blocks: Iterator[Any] = iter(())  # of the file that this process reads


def sensor_of(read: Reader, path: str) -> tuple[Any, str]:
    """A file's sensor; and why it cannot be read, or ""."""
    global _blocks
    answer = start(read, path)
    _blocks = iter(())  # closes the file
    return answer


def start(read: Reader, path: str) -> tuple[Any, str]:
    """`sensor_of`, and `next_block` then reads this file from its beginning."""
    global _blocks
    _limit_memory()
    try:
        _blocks = read(path)
        return next(_blocks), ""
    except BaseException as error:  # a panic in Rust derives from BaseException alone
        return None, _line(error)


def next_block() -> tuple[list[np.ndarray] | None, str]:
    """The columns of the next events, None at the end; and why the file cannot be read on, or ""."""
    try:
        return next(_blocks, None), ""
    except BaseException as error:
        return None, _line(error)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__


def _limit_memory() -> None:
    with suppress(ImportError, OSError, ValueError):  # no POSIX, or a lower limit already
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
