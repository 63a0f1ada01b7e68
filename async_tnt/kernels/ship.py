"""Compile all entry points into the package, for one kind of processor or several.

    python -m async_tnt.kernels.ship               for this machine's processor
    python -m async_tnt.kernels.ship x86-64-v3 x86-64-v4

Wheels are built with these files. A checkout needs them only to try them: the code no longer fits
after the next edit of a kernel.
"""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import subprocess
import sys
import tempfile
from pathlib import Path

from numba.core.serialize import dumps

from async_tnt import kernels
from async_tnt.kernels.entry_points import ENTRY_POINTS, prepare
from async_tnt.kernels.shipped import FOLDER, write_file
from async_tnt.kernels.target import GENERIC, KINDS, best_kind, is_x86, settings_for


def all_kinds() -> list[str]:
    """The kinds of processors that a wheel for this machine's system serves."""
    return list(KINDS) if is_x86() else [GENERIC]


def import_all() -> None:
    """Import all modules of kernels, so that all entry points are known."""
    for module in pkgutil.walk_packages(kernels.__path__, f"{kernels.__name__}."):
        importlib.import_module(module.name)


def compile_all(path: Path) -> None:
    """Compile all entry points for the processor that this process compiles for."""
    import_all()
    prepare(*ENTRY_POINTS)
    write_file(path, {entry.name: dumps(entry.result._reduce()) for entry in ENTRY_POINTS})


def ship(kinds: list[str], folder: Path) -> list[Path]:
    """Compile for kinds of processors, each in a process of its own.

    Returns the files.
    """
    files = []
    for kind in kinds:
        path = folder / f"{kind}.code"
        with tempfile.TemporaryDirectory() as cache:
            settings = settings_for(kind) | {"NUMBA_CACHE_DIR": cache}
            words = [sys.executable, "-m", __name__ if __name__ != "__main__" else __spec__.name]
            subprocess.run([*words, "--here", str(path)], env=os.environ | settings, check=True)
        files.append(path)
    return files


def main() -> None:
    """The command, see above."""
    parser = argparse.ArgumentParser(
        prog="python -m async_tnt.kernels.ship", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "kinds",
        nargs="*",
        metavar="KIND",
        help=f"kind of processor, of {', '.join(all_kinds())}; by default this machine's",
    )
    parser.add_argument("--all", action="store_true", help="all of these kinds")
    parser.add_argument("--out", type=Path, default=FOLDER, help="the folder of the files")
    parser.add_argument("--here", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        compile_all(options.here)
        return
    kinds = options.kinds or ([best_kind()] if best_kind() else [])
    if options.all:
        kinds = all_kinds()
    unknown = set(kinds) - set(all_kinds())
    if unknown:
        parser.error(f"KIND must be one of {', '.join(all_kinds())}, got {', '.join(unknown)}")
    for path in ship(kinds, options.out):
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
