"""Collect the records of many recordings in a result file.

It has a line of JSON for each recording, in order of their names.

Until it is complete, the file is its own journal. One process holds a lock on it, and appends
records in the order in which they are done. A killed process leaves at most half a line, which the
next process cuts off. When all recordings are done, their sorted lines replace the file.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from pathlib import Path

from async_tnt.base.files import check_writable, naming, open_locked, replacing
from async_tnt.base.json_text import parse_json
from async_tnt.base.messages import one_line, short
from async_tnt.base.progress import Bar
from async_tnt.evaluation.job import Job, Task
from async_tnt.evaluation.records import FIELDS, Record, lost

SUFFIXES = (".jsonl",)
START = b'{"recording": '
"""The first bytes of each line."""
Run = Callable[..., Generator[Record]]
"""`run_all` or `run_on_dask`, with all arguments given but the function, the tasks, and `lost`."""


def collect(
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    run: Run,
    out: Path,
    *,
    check: Callable[[Record], object] = lambda record: None,
    progress: Callable[..., Bar] = Bar,
    report: Callable[[str], object] = lambda line: None,
) -> list[Record]:
    """Run the tasks that have no record yet, write the result file, and return all its records.

    The records are in order of the recordings' names.

    A recording is done again if its record has an error, or if its size, time of change or class
    differs.

    Parameters
    ----------
    function : makes a task's record, such as `evaluate_recording`.
    tasks : at least one task. All belong to one job, and each has another recording.
    run : runs the function over the tasks.
    out : the result file.
    check : raises a ValueError for a record without an error that cannot be one of these tasks,
        such as `check_record`.
    progress : makes the progress bar, which counts recordings.
    report : called with a line on what is kept of an earlier run, and what is left out.

    Raises
    ------
    ValueError : this program has not written the file, or with other settings; it is damaged; or it
        holds only other recordings.
    OSError : another program is writing it, or it cannot be written.
    KeyboardInterrupt : it says how many recordings are done.
    """
    out = check_writable(out)
    wanted = {task.recording: task for task in tasks}
    with contextlib.closing(ResultFile(out, tasks[0].job)) as file:
        good = _good_records(file, out, check)
        to_do = [task for task in tasks if not _is_done(task, good)]
        if good and len(to_do) == len(wanted):
            raise ValueError(
                f"{out} holds results ({len(good):,}), but none of a recording as it is here: of "
                "another folder? Name another file, or delete this one"
            )
        n_all = len(wanted)
        n_kept = n_all - len(to_do)
        if n_kept and to_do:
            report(f"{out}: {n_kept:,} of {n_all:,} recordings are done, resuming")
        n_gone = len(file.records.keys() - wanted.keys())
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


def _good_records(
    file: ResultFile, out: Path, check: Callable[[Record], object]
) -> dict[str, Record]:
    """The records in a file without those of errors, by the name of their recordings.

    A ValueError for a record that `check` refuses.
    """
    good = {name: record for name, record in file.records.items() if record["error"] is None}
    for name, record in good.items():
        try:
            check(record)
        except ValueError as error:
            raise ValueError(
                f"{out} is damaged: the record of {short(name)}: {one_line(error)}; restore "
                "the file, name another one, or delete this one"
            ) from None
    return good


def _is_done(task: Task, good: Mapping[str, Record]) -> bool:
    """Whether there is a record of this recording as it is now."""
    record = good.get(task.recording)
    if record is None:
        return False
    recorded = (record["bytes"], record["modified_ns"], record["class"])
    return recorded == (task.bytes, task.modified_ns, task.label)


class ResultFile:
    """A result file that is being written; locked until `close`.

    Parameters
    ----------
    out : the file, no link.
    job : the job that its records belong to.

    Attributes
    ----------
    records : recording -> its newest record.

    Raises
    ------
    ValueError : the file there was not written by this program, or with other settings; or it is
        damaged.
    OSError : another program is writing it, or it cannot be written.
    """

    def __init__(self, out: Path, job: Job) -> None:
        self.records: dict[str, Record] = {}
        self._out = out
        self._job = job
        self._is_new = not out.exists()
        # the recordings of all lines, in the file's order
        self._names: list[str] = []
        self._file = open_locked(
            out, f"{out}: another program is writing it; wait for that one, or name another file"
        )
        try:
            self._load()
        except BaseException:
            self.close()
            raise

    def append(self, record: Record) -> None:
        """Write a record; it replaces an earlier one of its recording, and outlives `kill -9`."""
        with naming(self._out):
            self._file.write(_line(record))
            self._file.flush()
        self._add(record)

    def finish(self, names: Collection[str]) -> None:
        """Let the file hold the records of these recordings and no others, in order.

        It is not written if it holds them already.
        """
        if self._names == sorted(names):
            return
        with replacing(self._out) as part:
            with part.open("wb") as file:
                file.writelines(_line(self.records[name]) for name in sorted(names))
            if os.name == "nt":  # where an open file cannot be replaced
                self._file.close()

    def close(self) -> None:
        """Unlock the file. One that was made here and has no record is removed."""
        if self._file.closed:
            return
        with naming(self._out), contextlib.closing(self._file):
            is_empty = not self._file.seek(0, os.SEEK_END)
            if os.name == "nt":  # where an open file cannot be deleted
                self._file.close()
            if is_empty and self._is_new:
                self._out.unlink(missing_ok=True)

    def _load(self) -> None:
        """Read the records of an earlier run."""
        start = self._file.read(len(START))
        if not START.startswith(start):
            raise ValueError(_not_ours(self._out))
        self._file.seek(0)
        for line in iter(self._file.readline, b""):
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
    """Read the record in a line of the file `out`.

    A ValueError if the record does not belong to this job.
    """
    try:
        record = parse_json(line)
    except ValueError:
        record = None
    damaged = ValueError(f"{_not_ours(out)}, or damaged")
    if not isinstance(record, dict) or record.keys() != set(FIELDS):
        raise damaged
    if not isinstance(record["recording"], str):
        raise damaged
    if record["settings"] != job.id:
        raise ValueError(
            f"{out} was made with another model, version or selection of pixels, settings "
            f"{short(record['settings'])} (now {job.id}): give the same again, name another file, "
            "or delete this one"
        )
    return record


def _not_ours(out: Path) -> str:
    return f"{out} is not a result of async-tnt: move it away, or name another file"
