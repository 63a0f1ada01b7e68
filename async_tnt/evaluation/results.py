"""Collect the records of many recordings in a result file: a line of JSON per recording, in order
of their names.

Until it is complete, it is its own journal: records are appended in the order they are done, by one
process, which holds a lock on the file. A killed process leaves at most half a line, which the next
one cuts off. When all recordings are done, their sorted lines replace the file.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Collection, Generator, Sequence
from pathlib import Path

from async_tnt.base.checks import one_line, parse_json, short
from async_tnt.base.files import check_writable, naming, open_locked, replacing
from async_tnt.base.progress import Bar
from async_tnt.evaluation.job import Job, Task
from async_tnt.evaluation.records import FIELDS, Record, lost

SUFFIXES = (".jsonl",)
START = b'{"recording": '
Run = Callable[..., Generator[Record]]
"""`run_all` or `run_on_dask`, with all arguments given but the function, the tasks, and `lost`."""


def collect(
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    run: Run,
    out: Path,
    *,
    restart: bool = False,
    check: Callable[[Record], object] = lambda record: None,
    progress: Callable[..., Bar] = Bar,
    report: Callable[[str], object] = lambda line: None,
) -> list[Record]:
    """Do what is not done yet, write the result file, and return its records in order of the
    recordings' names.

    A recording is done again if its record has an error, or if its size, time of change or class
    differs.

    Parameters
    ----------
    tasks : at least one, all of one job, no two of one recording.
    restart : True discards the results of an earlier run.
    check : raises a ValueError for a record without an error that cannot be one of these tasks,
        such as `check_record`.
    progress : makes the progress bar, which counts recordings.
    report : called with a line on what is kept of an earlier run, and what is left out.

    Raises
    ------
    ValueError : this program has not written the file, or with other settings; it is damaged; or it
        holds only other recordings.
    OSError : another program is writing it, or it cannot be written.
    KeyboardInterrupt : with how many are done.
    """
    out = check_writable(out)
    job = tasks[0].job
    wanted = {task.recording: task for task in tasks}
    with contextlib.closing(ResultFile(out, job, restart=restart)) as file:
        good = {name: record for name, record in file.records.items() if record["error"] is None}
        for name, record in good.items():
            try:
                check(record)
            except ValueError as error:
                raise ValueError(
                    f"{out} is damaged: the record of {short(name)}: {one_line(error)}; restore "
                    "the file, name another "
                    "one, or discard it by a restart"
                ) from None
        of_file = {
            name: (good[name]["bytes"], good[name]["modified_ns"], good[name]["class"])
            for name in good
        }
        to_do = [
            task
            for task in tasks
            if of_file.get(task.recording) != (task.bytes, task.modified_ns, task.label)
        ]
        n_gone = len(file.records.keys() - wanted.keys())
        if good and len(to_do) == len(wanted):
            raise ValueError(
                f"{out} holds results ({len(good):,}), but none of a recording as it is here: of "
                "another folder? "
                "Name another file, or discard it by a restart"
            )
        n_all, n_kept = len(wanted), len(wanted) - len(to_do)
        if n_kept and to_do:
            report(f"{out}: {n_kept:,} of {n_all:,} recordings are done, resuming")
        if n_gone:
            report(f"{out}: recordings that no longer exist are left out ({n_gone:,})")
        with (
            progress(n_all, "streaming", done=n_kept) as bar,
            contextlib.closing(run(function, to_do, lost=lost)) as records,
        ):
            try:
                for record in records:
                    file.append(record)
                    bar.update()
            except KeyboardInterrupt:
                raise KeyboardInterrupt(f"{bar.done:,} of {n_all:,} recordings are done") from None
        file.finish(wanted)
        return [file.records[name] for name in sorted(wanted)]


class ResultFile:
    """A result file that is being written; locked until `close`.

    Parameters
    ----------
    out : the file, no link.
    job : of its records.
    restart : True discards the results that are there, whatever their settings.

    Attributes
    ----------
    records : recording -> its newest record.

    Raises
    ------
    ValueError : the file there was not written by this program, or with other settings; or it is
        damaged.
    OSError : another program is writing it, or it cannot be written.
    """

    def __init__(self, out: Path, job: Job, *, restart: bool = False) -> None:
        self.records: dict[str, Record] = {}
        self._out, self._job, self._is_new = out, job, not out.exists()
        self._names: list[str] = []  # of all lines
        self._file = open_locked(
            out, f"{out}: another program is writing it; wait for that one, or name another file"
        )
        self._restarts = restart
        try:
            self._load()
        except BaseException:
            self.close()
            raise

    def append(self, record: Record) -> None:
        """Write a record; it replaces an earlier one of its recording, and outlives `kill -9`."""
        with naming(self._out):
            if self._restarts:  # not before there is something new
                self._file.truncate(0)
                self._restarts = False
            self._file.write(_line(record))
            self._file.flush()
        self._add(record)

    def finish(self, names: Collection[str]) -> None:
        """Let it hold the records of these recordings and no others, in order; it is not written if
        it does."""
        if self._names == sorted(names):
            return
        with replacing(self._out) as part:
            with part.open("wb") as file:
                file.writelines(_line(self.records[name]) for name in sorted(names))
            if os.name == "nt":  # where an open file cannot be replaced
                self._file.close()

    def close(self) -> None:
        """Unlock it; a file that was made here and has no record is removed."""
        if self._file.closed:
            return
        with naming(self._out), contextlib.closing(self._file):
            is_empty = not self._file.seek(0, os.SEEK_END)
            if os.name == "nt":  # where an open file cannot be deleted
                self._file.close()
            if is_empty and self._is_new:
                self._out.unlink(missing_ok=True)

    def _load(self) -> None:
        start = self._file.read(len(START))
        if not START.startswith(start):
            raise ValueError(_not_ours(self._out))
        if self._restarts:
            return
        self._file.seek(0)
        while line := self._file.readline():
            if not line.endswith(b"\n"):
                # half a line, which a killed process has left
                self._file.truncate(self._file.tell() - len(line))
                return
            self._add(_record_of(line, self._job, self._out))

    def _add(self, record: Record) -> None:
        self._names.append(record["recording"])
        self.records[record["recording"]] = record


def _line(record: Record) -> bytes:
    return json.dumps(record).encode() + b"\n"


def _record_of(line: bytes, job: Job, out: Path) -> Record:
    try:
        record = parse_json(line)
    except ValueError:
        record = None
    if (
        not isinstance(record, dict)
        or record.keys() != set(FIELDS)
        or not isinstance(record["recording"], str)
    ):
        raise ValueError(f"{_not_ours(out)}, or damaged")
    if record["settings"] != job.id:
        raise ValueError(
            f"{out} was made with another model, version or selection of pixels, settings "
            f"{short(record['settings'])} "
            f"(now {job.id}): give the same again, name another file, or discard it by a restart"
        )
    return record


def _not_ours(out: Path) -> str:
    return f"{out} is not a result of async-tnt: move it away, or name another file"
