"""Files: paths as users write them, pointers of Git LFS, reading and writing.

Only regular files are read and replaced. A file is written whole or not at all, by one process at a
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
"""First bytes of a pointer of Git LFS."""


def user_path(path: str | os.PathLike[str]) -> Path:
    """A path with `~` or `~name` replaced by a home folder; unchanged if there is no such user.

    A shell replaces `~` only in words that begin with it, and Python never does.
    """
    return Path(os.path.expanduser(path))


def refuse_git_lfs(path: Path) -> None:
    """Raise a ValueError if a file is only a pointer of Git LFS; nothing else is checked.

    Git leaves such a pointer, three lines of text, where a repository was cloned without its large
    files.
    """
    # a missing file, a folder or a pipe gives a better error later
    if not path.is_file():
        return
    with path.open("rb") as file:
        is_pointer = file.read(len(LFS_POINTER)) == LFS_POINTER
    if is_pointer:
        raise ValueError(
            f"{path}: only a Git LFS pointer to the file, not the file itself; fetch it with "
            "`git lfs pull` in its repository"
        )


def open_regular(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a regular file, or a link to a regular file, to read its bytes.

    Other kinds of files are refused, because a read from a pipe without a writer would wait
    forever, and a device may never end.

    Raises
    ------
    OSError : the path is not a regular file, but a pipe or a device, for example; it is missing; or
        it is not readable.
    """
    mode = os.stat(path).st_mode
    # `open` itself refuses folders
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "a pipe or a device, expected a regular file", os.fspath(path))
    return Path(path).open("rb")


def read_regular(path: str | os.PathLike[str]) -> bytes:
    """All bytes of a regular file, see `open_regular`."""
    with open_regular(path) as file:
        return file.read()


def check_writable(path: Path, suffixes: Sequence[str] = ()) -> Path:
    """The path of the file that would be written: `path` itself, or where a symbolic link leads.

    A file that `Replacement` could not replace is refused here, before any work.

    Parameters
    ----------
    suffixes : suffixes that `path` may have, in upper or lower case; empty: any suffix.

    Raises
    ------
    ValueError : the path has another suffix.
    OSError : the path is not a regular file, the folder is missing, or there is no permission.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: its name must end in {', '.join(suffixes)}")
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if not target.parent.is_dir():
        raise FileNotFoundError(f"no folder {target.parent} to write {target.name} to")
    _check_regular(path)
    is_locked = target.exists() and not os.access(target, os.W_OK)
    if is_locked or not os.access(target.parent, os.W_OK):
        raise PermissionError(f"{path} cannot be written: no permission")
    _check_regular(_part_path(target), follow_symlinks=False)
    return target


def check_ours(paths: Sequence[Path], marks: Sequence[str]) -> None:
    """Refuse, before any work, to replace files that another program has written.

    Parameters
    ----------
    paths : files that are written together. If any of them exists, the first file must exist and be
        ours. If so, all files are taken for ours.
    marks : texts that the first file contains if it is ours.

    Raises
    ------
    OSError : the files are not ours, or cannot be written, see `check_writable`.
    """
    existing = [path for path in paths if check_writable(path).exists()]
    content = paths[0].read_bytes() if paths[0] in existing else b""
    if existing and any(mark.encode() not in content for mark in marks):
        expected = f"expected {paths[0].name} with {', '.join(marks)}"
        raise FileExistsError(
            f"{existing[0]} is of another program ({expected}): move it away, or give another name"
        )


def check_folder(folder: Path, names: Sequence[str] = ()) -> None:
    """Raise an OSError, before any work, if a folder could not be made or written.

    names : files in the folder that will be written; they are checked, too.
    """
    # the folder itself, or else the nearest folder above it that exists
    nearest = folder
    if not os.path.lexists(nearest):
        nearest = next(path for path in folder.absolute().parents if os.path.lexists(path))
    if not nearest.is_dir():
        raise NotADirectoryError(f"{nearest} is not a folder; expected a folder to write to")
    if not os.access(nearest, os.W_OK):
        raise PermissionError(f"{folder} cannot be written: no permission")
    if folder.is_dir():
        for name in names:
            check_writable(folder / name)


class Replacement:
    """A new file that replaces an old file when it is complete; until then it is NAME.part.

    The permissions of the old file stay. Parameters and errors are those of `check_writable`.

    Attributes
    ----------
    part : the path of NAME.part, to be written.
    """

    def __init__(self, path: Path) -> None:
        self._target = check_writable(path)
        self.part = _part_path(self._target)
        self.part.unlink(missing_ok=True)  # left by a killed process

        # A file that replaces a private file is private from the start. O_EXCL does not follow a
        # link that somebody placed there meanwhile.
        mode = 0o600 if self._target.exists() else 0o666
        os.close(os.open(self.part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))

    def complete(self) -> None:
        """Replace the file."""
        # An error means that there is no old file, or that the file system has no permissions.
        with contextlib.suppress(OSError):
            shutil.copymode(self._target, self.part)
        self.part.replace(self._target)

    def discard(self) -> None:
        """Leave the old file as it was. After `complete` this does nothing."""
        self.part.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the path of a file to write, NAME.part. After the block this file replaces `path`.

    If the block fails, `path` stays as it was. A killed process leaves the old or the new file, and
    perhaps NAME.part.
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
    """Put this path into an OSError of the block that names no file, such as "no space left"."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write a whole text file in UTF-8."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def open_locked(path: Path, busy_message: str) -> IO[bytes]:
    """Open a file, made if it is missing, and lock it until it is closed or this process ends.

    Where the system has no such locks, nothing is locked.

    Raises
    ------
    BlockingIOError : another process has locked the file, or has just replaced or deleted it. The
        message is `busy_message`.
    """
    _check_regular(path, follow_symlinks=False)
    file = path.open("a+b")
    try:
        with contextlib.suppress(ImportError):  # Windows has no `fcntl`
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # another process may have replaced or deleted the file before it was locked here
        if not os.path.samestat(os.fstat(file.fileno()), path.stat()):
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError):
        file.close()
        raise BlockingIOError(busy_message) from None
    except OSError:
        pass  # a file system without locks
    file.seek(0)
    return file


@contextlib.contextmanager
def locked_folder(folder: Path, name: str) -> Iterator[None]:
    """Make a folder, and lock the file `name` in it for the block.

    Folders that were made here are removed again if they are empty in the end.

    Raises
    ------
    BlockingIOError : another process has locked the file.
    """
    busy_message = (
        f"{folder}: another program is at work there; wait for that one, or give another folder"
    )
    missing_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with open_locked(folder / name, busy_message):
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # a folder that is not empty stays
                (folder / name).unlink()
                for path in missing_folders:
                    path.rmdir()


def _part_path(target: Path) -> Path:
    return target.with_name(f"{target.name}.part")


def _check_regular(path: Path, *, follow_symlinks: bool = True) -> None:
    """Refuse a path that exists and is not a regular file."""
    with contextlib.suppress(FileNotFoundError):
        mode = os.stat(path, follow_symlinks=follow_symlinks).st_mode
        if not stat.S_ISREG(mode):
            raise FileExistsError(
                f"{path} is not a regular file; only those are replaced: give another name"
            )
