"""The result file, lines of JSON or Parquet by its suffix: one record per recording, in order of the recordings' names.

Records are appended as lines of JSON in the order they are done: to FILE.jsonl itself, or to FILE.parquet.jsonl beside
FILE.parquet. One process writes them and holds a lock on them. A killed process leaves at most half a line, which the
next one cuts off. When all recordings are done, the sorted lines, or the Parquet file made from them, replace the
earlier result.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from async_tnt.archive.job import Job
from async_tnt.archive.parquet import import_pyarrow, not_ours, read_metadata, read_parquet, write_parquet
from async_tnt.archive.records import COLUMNS, Record
from async_tnt.files import check_writable, file_of, naming, open_locked, replacing, set_mode

SUFFIXES = (".jsonl", ".parquet")
START = b'{"recording": '
WHAT_TO_DO = "give the same again, another --out, or --restart to discard it"


def check_out(out: Path) -> None:
    """Refuse, before any work, a result file that could not be written.

    Raises
    ------
    ValueError, OSError : see `check_writable`. ImportError : Parquet without pyarrow.
    """
    check_writable(out, SUFFIXES)
    if is_parquet(out):
        import_pyarrow()


def is_parquet(out: Path) -> bool:
    return out.suffix.lower() == ".parquet"


def lines_path(out: Path) -> Path:
    """The file of JSON lines that an unfinished result consists of."""
    out = file_of(out)
    return out.with_name(out.name + ".jsonl") if is_parquet(out) else out


def read_results(out: Path, job: Job) -> Iterator[Record]:
    """The records of a finished result file, one by one.

    Raises
    ------
    ValueError : this program has not written the file, or with other settings; or it is damaged.
    """
    if is_parquet(out):
        before = read_metadata(out)
        if before != job.metadata:
            raise ValueError(f"{out} was made with {_difference(before, job.metadata)}: {WHAT_TO_DO}")
        records: Iterator[Any] = read_parquet(out)
    else:
        records = _read_lines(out)
    for record in records:
        _check_record(record, job, out)
        yield record


class ResultFile:
    """A result file that is being written; locked until it is closed.

    Parameters
    ----------
    out : the file, no link.
    job : of its records.
    restart : True discards the results that are there, whatever their settings.

    Raises
    ------
    ValueError : the file there was not written by this program, or with other settings; or it is damaged.
    OSError : another program is writing it, or it cannot be written.
    """

    def __init__(self, out: Path, job: Job, *, restart: bool = False) -> None:
        self.versions: dict[str, tuple[int, int, str | None] | None] = {}
        """Recording -> (bytes, modified_ns) of the file that its record is of, and the class that it was compared with;
        None where that has an error."""
        self._out, self._job = out, job
        self._path = lines_path(out)
        self._is_kept = self._path == out and out.exists()  # also with no lines in it
        self._where: dict[str, tuple[int, int]] = {}  # recording -> (offset, length) of its newest line
        self._last = ""
        self._in_order = True
        busy = f"{out}: another program is writing it; wait for that one, or give another --out"
        self._lines = open_locked(self._path, busy)
        try:
            if self._has_parquet():  # users with access to the result have access to the lines and to the next result
                set_mode(self._path, out.stat().st_mode | stat.S_IRUSR | stat.S_IWUSR)
            if restart:
                self._discard()
            self._load()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ResultFile:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def append(self, record: Record) -> None:
        """Write a record; it replaces an earlier one of its recording, and outlives `kill -9`."""
        line = json.dumps(record).encode() + b"\n"
        with naming(self._path):
            offset = self._lines.seek(0, os.SEEK_END)
            self._lines.write(line)
            self._lines.flush()
        self._add(record, offset, len(line))

    def is_finished(self, names: Collection[str]) -> bool:
        """Whether it holds the records of these recordings and no others, in their final form."""
        is_final = not self._where if is_parquet(self._out) else self._in_order
        return is_final and self.versions.keys() == set(names)

    def finish(self, names: Collection[str]) -> None:
        """Give it its final form, with the records of these recordings and no others."""
        names = sorted(names)
        if is_parquet(self._out):
            if any(name not in self._where for name in names):
                for record in read_results(self._out, self._job):
                    if record["recording"] not in self._where:
                        self.append(record)
            with replacing(self._out) as part:
                write_parquet(part, self._job, (json.loads(self._line(name)) for name in names))
            self._lines.truncate(0)
            return
        with replacing(self._out) as part:
            with part.open("wb") as file:
                file.writelines(self._line(name) for name in names)
            if os.name == "nt":  # where an open file cannot be replaced
                self._lines.close()

    def close(self) -> None:
        """Unlock it."""
        if self._lines.closed:
            return
        with naming(self._path), contextlib.closing(self._lines):
            is_empty = not self._lines.seek(0, os.SEEK_END)
            if os.name == "nt":  # where an open file cannot be deleted
                self._lines.close()
            if is_empty and not self._is_kept:
                self._path.unlink(missing_ok=True)

    def _load(self) -> None:
        while line := self._lines.readline():
            offset = self._lines.tell() - len(line)
            if not line.endswith(b"\n") and (self._where or line.startswith(START) or START.startswith(line)):
                self._lines.truncate(offset)  # the half of a line that a killed process has left
                break
            record = _parsed(line)
            _check_record(record, self._job, self._out)
            self._add(record, offset, len(line))
        if self._has_parquet():
            for record in read_results(self._out, self._job):
                self.versions.setdefault(record["recording"], _version_of(record))

    def _discard(self) -> None:
        """Discard what is there, if this program has written it."""
        first = self._lines.readline()
        if first and not first.startswith(START):
            raise ValueError(not_ours(self._out))
        if self._has_parquet():
            read_metadata(self._out)
            self._out.unlink()
        self._lines.truncate(0)
        self._lines.seek(0)

    def _has_parquet(self) -> bool:
        return is_parquet(self._out) and self._out.exists() and self._out.stat().st_size > 0

    def _add(self, record: Record, offset: int, length: int) -> None:
        name = record["recording"]
        self._in_order = self._in_order and self._last < name
        self._last = name
        self._where[name] = (offset, length)
        self.versions[name] = _version_of(record)

    def _line(self, name: str) -> bytes:
        offset, length = self._where[name]
        self._lines.seek(offset)
        return self._lines.read(length)


def _version_of(record: Record) -> tuple[int, int, str | None] | None:
    return None if record["error"] is not None else (record["bytes"], record["modified_ns"], record.get("class"))


def _read_lines(out: Path) -> Iterator[Any]:
    with out.open("rb") as file:
        yield from map(_parsed, file)


def _parsed(line: bytes) -> Any:
    """The value of a whole line of JSON; None where it is none."""
    if not line.endswith(b"\n"):
        return None
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _check_record(record: Any, job: Job, out: Path) -> None:
    is_record = (
        isinstance(record, dict)
        and record.keys() == COLUMNS[job.kind].keys()
        and isinstance(record["recording"], str)
        and isinstance(record["settings"], str)
        and isinstance(record["error"], str | None)
    )
    if not is_record:
        raise ValueError(not_ours(out, f" {job.kind}, or is damaged"))
    if record["settings"] != job.id:
        raise ValueError(
            f"{out} was made with another model, window, trigger, engine, version or selection of pixels, "
            f"settings {record['settings']} (now {job.id}): {WHAT_TO_DO}"
        )


def _difference(before: dict[str, Any], now: dict[str, Any]) -> str:
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return ", ".join(f"{name} {before.get(name)!s:.24} (now {now.get(name)!s:.24})" for name in names)
