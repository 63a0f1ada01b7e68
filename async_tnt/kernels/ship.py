"""Compile all entry points into files that a package brings with it, see `shipped`.

    python -m async_tnt.kernels.ship FOLDER         for this machine's processor
    python -m async_tnt.kernels.ship FOLDER all     for all kinds of processors of this system

Wheels are built with these files. In a checkout they lie in `async_tnt/kernels/compiled`; after the
next edit of a kernel they no longer fit.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
import tempfile
from pathlib import Path

from numba.core.serialize import dumps

from async_tnt.kernels.entry_points import ENTRY_POINTS, prepare
from async_tnt.kernels.shipped import write_file
from async_tnt.kernels.target import GENERIC, KINDS, best_kind, is_x86, settings_for

PACKAGE = "async_tnt.kernels"


def import_all() -> None:
    """Import all modules of kernels, so that all entry points are known."""
    folder = str(Path(__file__).parent)
    for module in pkgutil.walk_packages([folder], f"{PACKAGE}."):
        importlib.import_module(module.name)


def compile_all(path: Path) -> None:
    """Compile all entry points for the processor that this process compiles for.

    Numba cannot write what it has loaded: its cache must be empty, and the package's code not used.
    """
    import_all()
    prepare(*ENTRY_POINTS)
    write_file(path, {entry.name: dumps(entry.result._reduce()) for entry in ENTRY_POINTS})


def ship(kinds: list[str], folder: Path) -> list[Path]:
    """Compile for kinds of processors, each in a process of its own. Returns the files."""
    files = [folder / f"{kind}.code" for kind in kinds]
    code = f"import sys, pathlib; from {PACKAGE}.ship import compile_all; "
    code += "compile_all(pathlib.Path(sys.argv[1]))"
    for kind, path in zip(kinds, files, strict=True):
        with tempfile.TemporaryDirectory() as cache:
            # NUMBA_OPT at its default: where it is set, code of the package is not loaded
            settings = {**settings_for(kind), "NUMBA_CACHE_DIR": cache, "NUMBA_OPT": "3"}
            environment = os.environ | settings
            subprocess.run([sys.executable, "-c", code, str(path)], env=environment, check=True)
    return files


def main() -> int:
    """The command, see above. Returns the exit code."""
    arguments = sys.argv[1:]
    if not arguments or arguments[1:] not in ([], ["all"]):
        print(f"usage: python -m {PACKAGE}.ship FOLDER [all]", file=sys.stderr)
        return 2
    best = best_kind()
    if arguments[1:]:
        kinds = list(KINDS) if is_x86() else [GENERIC]
    elif best is not None:
        kinds = [best]
    else:
        kinds = []  # a processor that is older than all kinds gets no file
    for path in ship(kinds, Path(arguments[0])):
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
