"""What made a number: the commit of the code, the command, the machine and the date."""

from __future__ import annotations

import functools
import shlex
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import async_tnt
from async_tnt.base.package import __version__

ROOT = Path(__file__).resolve().parents[2]
"""Folder of the checkout."""

CODE = ("async_tnt", "reference", "experiments", "pyproject.toml")
"""What numbers depend on, in the checkout."""

NOT_CODE = (":!experiments/results", ":!experiments/*.md")
"""What lies in the folders of `CODE`, but changes no number: the results and the pages."""

CHANGED = "+"
"""Stands behind a commit whose code had changes that were not committed."""


def git(*words: str) -> str | None:
    """What a command of git prints in the checkout; None if it fails or there is no git."""
    try:
        process = subprocess.run(
            ["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return process.stdout.strip()


@functools.cache
def commit() -> str:
    """The commit of the code that runs, as at the first call.

    `CHANGED` stands behind it if the code has changes that are not committed. It is empty outside
    of a checkout, and if the package that runs is not that of the checkout.
    """
    if not Path(async_tnt.__file__).resolve().is_relative_to(ROOT):
        return ""
    head = git("rev-parse", "HEAD")
    changes = git("status", "--porcelain", "--", *CODE, *NOT_CODE)
    if head is None or changes is None:
        return ""
    return head + CHANGED if changes else head


def run_now(command: str, machine: dict[str, Any]) -> dict[str, Any]:
    """The entry "run" of a result that was made just now.

    command : command line that made it, see `command_line`.
    machine : what `speed.timing.machine` returns.
    """
    return {
        "commit": commit(),
        "version": __version__,
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        "command": command,
        "machine": machine,
    }


def command_line(module: str, arguments: Sequence[str] | None = None) -> str:
    """The command `python -m MODULE ARGUMENTS`.

    Of absolute paths only the last part is shown, because the rest differs between machines.

    arguments : those of this process by default.
    """
    words = sys.argv[1:] if arguments is None else arguments
    shown = [Path(word).name if Path(word).is_absolute() else word for word in words]
    return shlex.join(["python", "-m", module, *shown])
