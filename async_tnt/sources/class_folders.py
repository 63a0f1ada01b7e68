"""Which recordings a folder of class folders holds."""

from __future__ import annotations

import os
from pathlib import Path

from async_tnt.sources.files.formats import READERS


def find_recordings(folder: str | os.PathLike[str], part: str | None = None) -> dict[str, list[Path]]:
    """The recordings of a folder of class folders.

    Parameters
    ----------
    folder : holds a folder for each class, with the name of the class. Hidden files and folders (".cache"), files that
        are not recordings, and deeper ones are ignored.
    part : such as "Train": the class folders are in `folder/part` if that exists and has folders.

    Returns
    -------
    Class name -> paths, both sorted by name. A class folder without recordings has an empty list.

    Raises
    ------
    FileNotFoundError, NotADirectoryError : no such folder.
    ValueError : no class folders in it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for name in ("left/a.npy", "left/b.npz", "right/a.npy", "right/notes.md"):
    ...         Path(folder, name).parent.mkdir(exist_ok=True)
    ...         Path(folder, name).touch()
    ...     found = find_recordings(folder)
    >>> {name: [path.name for path in paths] for name, paths in found.items()}
    {'left': ['a.npy', 'b.npz'], 'right': ['a.npy']}
    """
    folder = Path(folder)
    if not folder.exists():
        raise FileNotFoundError(f"no folder {folder}; expected one with a folder of recordings for each class")
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is a file; expected a folder with a folder of recordings for each class")
    if part is not None and (folder / part).is_dir() and _folders(folder / part):
        folder = folder / part
    classes = _folders(folder)
    if not classes:
        raise ValueError(
            f"{folder}: no class folders; expected {folder.name}/<class name>/<recording>, recordings in "
            f"{', '.join(sorted(READERS))}"
        )
    return {c.name: sorted(path for path in c.iterdir() if is_recording(path) and not path.is_dir()) for c in classes}


def is_recording(path: Path) -> bool:
    """Whether `open_recording` knows the suffix, and the file is not hidden."""
    return path.suffix.lower() in READERS and not path.name.startswith(".")


def name_of(path: Path) -> str:
    """The name of a recording in messages and reports: class folder and file."""
    return f"{path.parent.name}/{path.name}"


def _folders(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
