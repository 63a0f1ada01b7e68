"""Collect the records of many recordings in a result file.

A result file has a line of JSON for each recording, in order of the recordings' names.

Until all recordings are done, the lines are in another order: one process holds a lock on the file,
and appends each record as soon as it is made. If the process is killed, at most the last line is
incomplete, and the next process cuts it off. At the end, the sorted lines replace the file.
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
from async_tnt.evaluation.records import FIELDS, Record, lost_record

SUFFIXES = (".jsonl",)
START = b'{"recording": '
"""The first bytes of each line."""
Run = Callable[..., Generator[Record]]
"""`run_all` or `run_on_dask`, with all arguments but the function, the tasks and `lost`."""


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
    """Run the tasks that have no record yet, and write the result file.

    Returns the records of all tasks, in order of the recordings' names. A recording is done again
    if its record has an error, or if its file's size, time of change or class differs.

    Parameters
    ----------
    function : makes a task's record, such as `evaluate_recording`.
    tasks : at least one task. All have the same job and different recordings.
    run : runs the function over the tasks.
    out : the result file.
    check : a function, such as `check_record`, that gets each record of an earlier run. It raises a
        ValueError if these tasks cannot have such a record. Records with an error are not checked.
    progress : makes the progress bar, which counts recordings.
    report : called with lines of text: which records of an earlier run are kept or left out.

    Raises
    ------
    ValueError : this program has not written the file, or has written it with other settings; the
        file is damaged; or it holds only other recordings.
    OSError : another program is writing the file, or the file cannot be written.
    KeyboardInterrupt : Ctrl-C. The error says how many recordings are done.
    """
    out = check_writable(out)
    task_of = {task.recording: task for task in tasks}
    with contextlib.closing(ResultFile(out, tasks[0].job)) as file:
        good_records = _good_records(file, out, check)
        open_tasks = [task for task in tasks if not _is_done(task, good_records)]
        if good_records and len(open_tasks) == len(task_of):
            raise ValueError(
                f"{out} holds results ({len(good_records):,}), but none of a recording as it is "
                "here: of another folder? Name another file, or delete this one"
            )
        n_all = len(task_of)
        n_kept = n_all - len(open_tasks)
        if n_kept and open_tasks:
            report(f"{out}: {n_kept:,} of {n_all:,} recordings are done, resuming")
        n_gone = len(file.records.keys() - task_of.keys())
        if n_gone:
            report(f"{out}: recordings that no longer exist are left out ({n_gone:,})")

        with (
            progress(n_all, "streaming", done=n_kept) as bar,
            contextlib.closing(run(function, open_tasks, lost=lost_record)) as records,
        ):
            try:
                for record in records:
                    file.append(record)
                    bar.update()
            except KeyboardInterrupt:
                raise KeyboardInterrupt(f"{bar.done:,} of {n_all:,} recordings are done") from None
        file.finish(task_of)
        return [file.records[name] for name in sorted(task_of)]


def _good_records(
    file: ResultFile, out: Path, check: Callable[[Record], object]
) -> dict[str, Record]:
    """Name of a recording -> its record in the file. Records with an error are left out.

    A record that `check` refuses is a ValueError.
    """
    good_records = {
        name: record for name, record in file.records.items() if record["error"] is None
    }
    for name, record in good_records.items():
        try:
            check(record)
        except ValueError as error:
            raise ValueError(
                f"{out} is damaged: the record of {short(name)}: {one_line(error)}; restore "
                "the file, name another one, or delete this one"
            ) from None
    return good_records


def _is_done(task: Task, good_records: Mapping[str, Record]) -> bool:
    """Whether there is a record of this recording, and the recording has not changed since."""
    record = good_records.get(task.recording)
    if record is None:
        return False
    recorded = (record["bytes"], record["modified_ns"], record["class"])
    return recorded == (task.bytes, task.modified_ns, task.label)


class ResultFile:
    """A result file that is being written; locked until `close`.

    Parameters
    ----------
    out : path of the file. It must not be a link.
    job : the job that its records belong to.

    Attributes
    ----------
    records : name of a recording -> its newest record.

    Raises
    ------
    ValueError : this program has not written the existing file, or has written it with other
        settings; or the file is damaged.
    OSError : another program is writing the file, or the file cannot be written.
    """

    def __init__(self, out: Path, job: Job) -> None:
        self.records: dict[str, Record] = {}
        self._out = out
        self._job = job
        self._is_new = not out.exists()
        # the recording's name in each line, in the order of the lines
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
        """Write a record. It replaces an earlier record of its recording.

        The record is kept even if the process is killed afterwards.
        """
        with naming(self._out):
            self._file.write(_line(record))
            self._file.flush()
        self._add(record)

    def finish(self, names: Collection[str]) -> None:
        """Replace the file by the records of these recordings alone, in order of their names.

        If the file has just these lines already, it stays as it is.
        """
        if self._names == sorted(names):
            return
        with replacing(self._out) as part:
            with part.open("wb") as file:
                file.writelines(_line(self.records[name]) for name in sorted(names))
            if os.name == "nt":  # Windows cannot replace an open file
                self._file.close()

    def close(self) -> None:
        """Unlock the file. If it was created here and has no record, remove it."""
        if self._file.closed:
            return
        with naming(self._out), contextlib.closing(self._file):
            is_empty = not self._file.seek(0, os.SEEK_END)
            if os.name == "nt":  # Windows cannot delete an open file
                self._file.close()
            if is_empty and self._is_new:
                self._out.unlink(missing_ok=True)

    def _load(self) -> None:
        """Read the records of an earlier run."""
        first_bytes = self._file.read(len(START))
        if not START.startswith(first_bytes):
            raise ValueError(_refusal(self._out, "is not a result of async-tnt"))
        self._file.seek(0)
        for line in iter(self._file.readline, b""):
            if not line.endswith(b"\n"):
                # this incomplete line was left by a killed process, and is cut off
                self._file.truncate(self._file.tell() - len(line))
                return
            self._add(_record_of(line, self._job, self._out))

    def _add(self, record: Record) -> None:
        """Add a record that the file has now to `records`."""
        self._names.append(record["recording"])
        self.records[record["recording"]] = record


def _line(record: Record) -> bytes:
    """A record as a line of the file."""
    return json.dumps(record).encode() + b"\n"


def _record_of(line: bytes, job: Job, out: Path) -> Record:
    """Read the record in a line of the file `out`.

    Raises
    ------
    ValueError : the line is damaged, or the record does not belong to this job.
    """
    try:
        record = parse_json(line)
    except ValueError:
        record = None
    damage_error = ValueError(_refusal(out, "is not a result of async-tnt, or is damaged"))
    if not isinstance(record, dict) or record.keys() != set(FIELDS):
        raise damage_error
    if not isinstance(record["recording"], str):
        raise damage_error
    if record["settings"] != job.id:
        raise ValueError(
            f"{out} was made with another model, version or selection of pixels (its settings are "
            f"{short(record['settings'])}, now they are {job.id}): run with the same settings, "
            "name another file, or delete this one"
        )
    return record


def _refusal(out: Path, problem: str) -> str:
    return f"{out} {problem}: move it away, or name another file"
