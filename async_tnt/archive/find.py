"""The recordings that files and folders name."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from async_tnt.sources.class_folders import is_recording
from async_tnt.sources.files.formats import READERS


def recordings_under(paths: Iterable[Path]) -> list[Path]:
    """Files as they are, and of a folder all recordings at any depth, without hidden files and folders; each once.

    A folder is searched by suffix (`READERS`); links to folders are not followed.

    Raises
    ------
    FileNotFoundError : no such file or folder. ValueError : a folder without recordings.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for name in ("b.npz", "a/c.npy", "a/notes.md", ".cache/d.npy"):
    ...         Path(folder, name).parent.mkdir(exist_ok=True)
    ...         Path(folder, name).touch()
    ...     found = recordings_under([Path(folder), Path(folder, "a/c.npy")])
    >>> [path.name for path in found]
    ['c.npy', 'b.npz']
    """
    found: dict[str, Path] = {}  # by absolute path
    for path in paths:
        if not path.is_dir():
            if not path.exists():
                raise FileNotFoundError(f"no file or folder {path}")
            found.setdefault(os.path.abspath(path), path)
            continue
        inside = []
        for folder, names, files in os.walk(path, onerror=_raise):
            names[:] = sorted(name for name in names if not name.startswith("."))
            inside += [Path(folder, name) for name in files if is_recording(Path(name))]
        if not inside:
            raise ValueError(f"{path}: no recordings in this folder; expected files in {', '.join(sorted(READERS))}")
        for file in sorted(inside):
            found.setdefault(os.path.abspath(file), file)
    return list(found.values())


def _raise(error: OSError) -> None:
    raise error  # os.walk would leave out in silence what it may not read
