"""A progress bar on stderr for long work, where tqdm is installed and stderr is a terminal."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from typing import Any


class _Silent(AbstractContextManager["_Silent"]):
    def update(self, n: int = 1) -> None:
        pass

    def __exit__(self, *error: object) -> None:
        pass


def progress(total: int, what: str) -> Any:
    """`with progress(n, "checking") as bar: ... bar.update()`; it shows up when the work takes over a second."""
    try:
        from tqdm import tqdm
    except ImportError:
        return _Silent()
    return tqdm(total=total, desc=what, delay=1.0, leave=False, file=sys.stderr, disable=not sys.stderr.isatty())
