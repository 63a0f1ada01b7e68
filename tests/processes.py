"""Python in a process of its own, for the tests of what a process does."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The folder of the repository."""
PATHS = os.pathsep.join(str(ROOT / name) for name in ("", "reference", "tests"))
"""PYTHONPATH of a process that imports the package, the reference and the tests."""


@contextlib.contextmanager
def started(*words: object, **settings: object) -> Iterator[subprocess.Popen]:
    """Start Python; it is killed at the end of the block.

    words : what follows `python` on the command line.
    settings : arguments of `Popen` that differ from the usual ones here.
    """
    usual = {
        "env": {**os.environ, "PYTHONPATH": PATHS, "PYTHONUNBUFFERED": "1"},
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
    }
    with subprocess.Popen([sys.executable, *map(str, words)], **usual | settings) as process:
        try:
            yield process
        finally:
            process.kill()
