"""The journal beside a result file: what is done so far, a line of JSON a recording, in the order they are done.

`results.jsonl.partial`: the first line says what the records depend on; every other line is a record. Lines are only
ever appended, by one process, which holds a lock on the file. What a kill leaves of a line is cut off by whoever opens
the journal next. A recording's newest line counts.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from async_tnt.archive.records import Record
from async_tnt.files import check_own

HEADER = "async_tnt_journal"
FOLDER = "folder"
"""In what a journal was begun with, besides `Job.about`: where relative names begin."""
PIXELS = ("roi", "crop", "mask", "sensor")
"""Options of every command that streams archives."""
WHAT_TO_DO = "give the same again, another --out, or --restart to throw it away"
SYNC_S = 5.0
"""A killed program loses no record that was written; a machine that loses power may lose those of so many seconds."""


class Journal:
    """An open, locked journal.

    Parameters
    ----------
    path : the file; made where there is none.
    about : what the records depend on.
    valid : whether a line, parsed, is a record.
    who : the result file, for messages.
    restart : True throws away what is in the journal, whatever its settings.

    Raises
    ------
    ValueError : the file is no journal, or one of other settings.
    OSError : another program has it open, or it cannot be written.
    """

    def __init__(
        self, path: Path, about: dict[str, Any], valid: Callable[[Any], bool], who: Path, *, restart: bool = False
    ) -> None:
        self.path = path
        self.where: dict[str, tuple[int, int]] = {}
        """Recording -> (offset, length) of its newest line."""
        self._file = _open_locked(path, who)
        try:
            begun = self._begun_with(who)
            if begun is not None and begun != about and not restart and self._file.read(1):
                raise ValueError(other_settings(who, begun, about))
            if begun == about and not restart:
                self._read_records(valid)
            if not self.where:
                self._file.truncate(0)
                self._file.seek(0)
                self._write({HEADER: 1, "about": about})
            self._synced = time.monotonic()
        except BaseException:
            self._file.close()
            raise

    def append(self, record: Record) -> None:
        """Write a record; after this, `kill -9` does not lose it."""
        offset = self._file.tell()
        self.where[record["recording"]] = (offset, self._write(record))
        if time.monotonic() - self._synced > SYNC_S:
            os.fsync(self._file.fileno())
            self._synced = time.monotonic()

    def read(self, recording: str) -> Record:
        """The newest record of a recording. KeyError: none."""
        offset, length = self.where[recording]
        end = self._file.tell()
        self._file.seek(offset)
        line = self._file.read(length)
        self._file.seek(end)
        return json.loads(line)

    def remove(self) -> None:
        """Delete the file: its records are elsewhere."""
        if os.name == "nt":  # there an open file cannot be deleted
            self._file.close()
        self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Unlock it. A journal without records is deleted."""
        if self._file.closed:
            return
        if not self.where:
            self.remove()
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._file.close()

    def _write(self, record: dict[str, Any]) -> int:
        line = json.dumps(record).encode() + b"\n"
        self._file.write(line)
        self._file.flush()
        return len(line)

    def _begun_with(self, who: Path) -> dict[str, Any] | None:
        """What the header says; None where there is no whole one. Leaves the position behind it."""
        self._file.seek(0)
        line = self._file.readline()
        header = parsed(line)
        if isinstance(header, dict) and HEADER in header and isinstance(header.get("about"), dict):
            return header["about"]
        start = json.dumps({HEADER: 1})[:-1].encode()  # of which a kill has left a part
        if not line.endswith(b"\n") and (line.startswith(start) or start.startswith(line)):
            return None
        raise ValueError(f"{self.path} is no journal of async-tnt: move it away, or give another file than --out {who}")

    def _read_records(self, valid: Callable[[Any], bool]) -> None:
        """Find the records; cut off the first line that is none and what follows it: that is done again."""
        while True:
            offset = self._file.tell()
            line = self._file.readline()
            record = parsed(line)
            if not valid(record):
                break
            self.where[record["recording"]] = (offset, len(line))
        self._file.truncate(offset)
        self._file.seek(offset)


def parsed(line: bytes) -> Any:
    """What a whole line of JSON says; None where it is none."""
    if not line.endswith(b"\n"):
        return None
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def other_settings(who: Path, before: dict[str, Any], now: dict[str, Any]) -> str:
    """The one line that refuses to mix results."""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    if "command" in names:  # whose settings are others
        names = ["command"]
    told = ", ".join(
        "another model"
        if name == "model_sha256"
        else f"{_option(name, before)} {_said(before.get(name))} (now {_said(now.get(name))})"
        for name in names
    )
    return f"{who} was begun with {told}: {WHAT_TO_DO}"


def _option(name: str, about: dict[str, Any]) -> str:
    """As it is given, where it is."""
    is_option = name in PIXELS or (name not in ("command", "version", FOLDER) and about.get("command") == "run")
    return f"--{name.replace('_', '-')}" if is_option else name


def _said(value: Any) -> str:
    if isinstance(value, dict):  # a LeakyIntegrator
        return ":".join(f"{number:g}" for number in list(value.values())[:2])
    if value is True:  # --crop
        return "given"
    return "not given" if value is None else str(value)


def _open_locked(path: Path, who: Path) -> IO[bytes]:
    while True:
        check_own(path)
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
        file = os.fdopen(os.open(path, flags, 0o666), "r+b")
        try:
            _lock(file)
            if os.name == "nt" or _is_at(file, path):
                return file
        except BlockingIOError:
            file.close()
            raise OSError(f"{who}: another program is writing it; wait for that one, or give another --out") from None
        except BaseException:
            file.close()
            raise
        file.close()  # whoever had the lock has just deleted that file: take the new one


def _is_at(file: IO[bytes], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.stat(path))
    except FileNotFoundError:
        return False


def _lock(file: IO[bytes]) -> None:
    """Lock the file until it is closed, or its process ends. BlockingIOError: it is locked."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        file.seek(1 << 30)  # a byte far behind the end: a locked one cannot be read by others
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined, unused-ignore]
        except OSError:
            raise BlockingIOError from None
        finally:
            file.seek(0)
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
