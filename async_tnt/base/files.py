"""Files: paths as users write them, pointers of Git LFS, reading regular files alone, and writing.

Files are written whole or not at all, replacing nothing but regular files, and by one process at a
time.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

LFS_POINTER = b"version https://git-lfs.github.com/spec/"


def user_path(path: str | os.PathLike[str]) -> Path:
    """A path with `~` and `~name` as home folders; unchanged where there is no such user.

    A shell does this only for words that begin with `~`, and Python does not.
    """
    return Path(os.path.expanduser(path))


def refuse_git_lfs(path: Path) -> None:
    """A ValueError if a pointer of Git LFS is there in place of the file; nothing else is checked.

    Git leaves such a pointer, three lines of text, where a repository was cloned without its large
    files.
    """
    if not path.is_file():  # it is missing, a folder or a pipe, which others say better
        return
    with path.open("rb") as file:
        is_pointer = file.read(len(LFS_POINTER)) == LFS_POINTER
    if is_pointer:
        raise ValueError(
            f"{path}: only a Git LFS pointer to the file, not the file itself; fetch it with `git "
            "lfs pull` in its "
            "repository"
        )


def open_regular(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a regular file, or a link to one, to read its bytes.

    A pipe without a writer would wait forever, and a device may never end.

    Raises
    ------
    OSError : something else, such as a pipe or a device; missing, or not readable.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):  # `open` itself refuses folders
        raise OSError(errno.EINVAL, "a pipe or a device, expected a regular file", os.fspath(path))
    return Path(path).open("rb")


def read_regular(path: str | os.PathLike[str]) -> bytes:
    """All bytes of a regular file, see `open_regular`."""
    with open_regular(path) as file:
        return file.read()


def check_writable(path: Path, suffixes: Sequence[str] = ()) -> Path:
    """The file to write, following a symbolic link; refuses, before any work, what `Replacement`
    could not replace.

    Parameters
    ----------
    suffixes : `path` must have one of these, in upper or lower case; empty: any.

    Raises
    ------
    ValueError : another suffix.
    OSError : something other than a regular file is there, the folder is missing, or there is no
        permission.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: its name must end in {', '.join(suffixes)}")
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if not target.parent.is_dir():
        raise FileNotFoundError(f"no folder {target.parent} to write {target.name} to")
    _check_regular(path)
    if not os.access(target.parent, os.W_OK) or (
        target.exists() and not os.access(target, os.W_OK)
    ):
        raise PermissionError(f"{path} cannot be written: no permission")
    _check_regular(_part_of(target), follow_symlinks=False)
    return target


def check_ours(paths: Sequence[Path], marks: Sequence[str]) -> None:
    """Refuse, before any work, to replace files that the user has not named and this program has
    not written.

    Parameters
    ----------
    paths : written together. If any of them exists, the first must be ours, and then all are.
    marks : what a first file of ours contains.

    Raises
    ------
    OSError : they are not ours, or see `check_writable`.
    """
    there = [path for path in paths if check_writable(path).exists()]
    content = paths[0].read_bytes() if paths[0] in there else b""
    if there and any(mark.encode() not in content for mark in marks):
        expected = f"expected {paths[0].name} with {', '.join(marks)}"
        raise FileExistsError(
            f"{there[0]} is of another program ({expected}): move it away, or give another name"
        )


def check_folder(folder: Path, names: Sequence[str] = ()) -> None:
    """An OSError, before any work, if a folder, or these files in it, could not be made or
    written."""
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if not there.is_dir():
        raise NotADirectoryError(f"{there} is not a folder; expected a folder to write to")
    if not os.access(there, os.W_OK):
        raise PermissionError(f"{folder} cannot be written: no permission")
    for name in names if folder.is_dir() else ():
        check_writable(folder / name)


class Replacement:
    """A file that replaces another, whose permissions stay, when it is complete; until then it is
    NAME.part.

    Parameters and errors are those of `check_writable`.
    """

    def __init__(self, path: Path) -> None:
        self._target = check_writable(path)
        self.part = _part_of(self._target)
        self.part.unlink(missing_ok=True)  # left by a killed process
        # O_EXCL does not follow a link placed there meanwhile; what replaces a private file is
        # private from the start
        mode = 0o600 if self._target.exists() else 0o666
        os.close(os.open(self.part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))

    def complete(self) -> None:
        """Replace the file."""
        # nothing to replace, or a file system without permissions
        with contextlib.suppress(OSError):
            shutil.copymode(self._target, self.part)
        self.part.replace(self._target)

    def discard(self) -> None:
        """Leave the file as it was; nothing happens after `complete`."""
        self.part.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write the file that this yields, a `Replacement.part`: after the block it replaces `path`.

    If the block fails, `path` stays as it was. A killed process leaves the old or the new file, and
    maybe a `.part`.
    """
    file = Replacement(path)
    try:
        with naming(path):
            yield file.part
        file.complete()
    finally:
        file.discard()


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """An OSError of the block that names no file, as that of a full disk, names this one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write a whole file of UTF-8."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def open_locked(path: Path, busy: str) -> IO[bytes]:
    """Open a file, made if missing, and lock it until it is closed or its process ends in any way.

    BlockingIOError, with the text `busy`, if another process has locked it, or has just replaced or
    deleted it. Where the system has no such locks, nothing is locked.
    """
    _check_regular(path, follow_symlinks=False)
    file = path.open("a+b")
    try:
        with contextlib.suppress(ImportError):  # Windows has no `fcntl`
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.path.samestat(os.fstat(file.fileno()), path.stat()):
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError):
        file.close()
        raise BlockingIOError(busy) from None
    except OSError:
        pass  # a file system without locks
    file.seek(0)
    return file


@contextlib.contextmanager
def locked_folder(folder: Path, name: str) -> Iterator[None]:
    """Make a folder, and lock the file `name` in it for the block; BlockingIOError if another
    process has locked it.

    What was made here and is empty in the end is removed again.
    """
    busy = f"{folder}: another program is at work there; wait for that one, or give another folder"
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with open_locked(folder / name, busy):
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # a folder is not empty
                (folder / name).unlink()
                for path in missing:
                    path.rmdir()


def _part_of(target: Path) -> Path:
    return target.with_name(f"{target.name}.part")


def _check_regular(path: Path, *, follow_symlinks: bool = True) -> None:
    """Refuse anything but a regular file, or nothing at all."""
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path, follow_symlinks=follow_symlinks).st_mode):
            raise FileExistsError(
                f"{path} is not a regular file; only those are replaced: give another name"
            )
