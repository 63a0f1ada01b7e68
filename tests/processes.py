"""Python as a process of its own, for the tests of what a process does."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PATHS = os.pathsep.join(str(ROOT / name) for name in ("", "reference", "tests"))


@contextlib.contextmanager
def started(*words: object, **settings: object) -> Iterator[subprocess.Popen]:
    """Python with these words, which also imports the tests; killed at the end of the block."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    env = {**os.environ, "PYTHONPATH": PATHS, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, *map(str, words)], **{"env": env, **pipes, **settings}
    ) as process:
        try:
            yield process
        finally:
            process.kill()
