"""Collect the records of an archive's recordings, in memory or in a result file that a later run goes on with."""

from __future__ import annotations

import contextlib
import heapq
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from async_tnt.archive.executor import Place
from async_tnt.archive.job import Task
from async_tnt.archive.journal import FOLDER, Journal
from async_tnt.archive.records import TIMED, Record, lost
from async_tnt.archive.results import check_ours, is_record, journal_of, read_results, write_results
from async_tnt.files import check_writable, set_mode


@dataclass
class Collected:
    """What `collect` has done so far; to be read also when it was interrupted.

    Parameters
    ----------
    total : recordings asked for.
    kept : of these, done by an earlier run.
    done : of these, done by this one.
    gone : recordings of an earlier run that are no longer there, and left out of the result.
    """

    total: int = 0
    kept: int = 0
    done: int = 0
    gone: int = 0


def counted(n: int, noun: str) -> str:
    """For messages.

    Examples
    --------
    >>> counted(1, "recording"), counted(1000, "recording")
    ('1 recording', '1,000 recordings')
    """
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def collect(
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    place: Place,
    collected: Collected,
    *,
    each: Callable[[], object] = lambda: None,
) -> list[Record]:
    """Records of all tasks, in order of the recordings' names, in memory. `each` is called for each one done."""
    collected.total = len(tasks)
    records = []
    with contextlib.closing(place.run(function, tasks, lost)) as results:
        for record in results:
            records.append(record)
            collected.done += 1
            each()
    return sorted(records, key=lambda record: record["recording"])


def collect_to_file(
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    place: Place,
    out: Path,
    collected: Collected,
    *,
    folder: str | None = None,
    restart: bool = False,
    gone: Callable[[str], bool] = lambda recording: True,
    begin: Callable[[int], object] = lambda n: None,
    each: Callable[[], object] = lambda: None,
) -> Iterator[Record]:
    """Do what is not done yet, write the result file, and give its records in order of the recordings' names.

    Records come with `seconds` where this run or an interrupted one before measured it; the file has none.
    A recording is done again if it has an error, or its size or time of change is another.

    Parameters
    ----------
    tasks : at least one, all of one job, no two of one recording.
    folder : where the recordings' names begin; None: they are whole paths. An interrupted run of another folder is
        not gone on with. The result does not say it, as the same archive may come to lie elsewhere.
    restart : throw away what an earlier run has left.
    gone : whether a recording of an earlier run that is not in `tasks` is no longer there.
    begin : told how many recordings there are to do. each : called for each one done.

    Raises
    ------
    ValueError : the file is none of ours, was begun with other settings or in another folder, holds recordings that
        are there but not in `tasks`, or none that is as it was. OSError : another program is writing it, or it cannot
        be written.
    """
    out = check_writable(out)
    job = tasks[0].job
    wanted = {task.recording: task for task in tasks}
    collected.total = len(wanted)
    if restart and out.exists():
        check_ours(out)
    about = job.about if folder is None else {**job.about, FOLDER: folder}
    journal = Journal(journal_of(out), about, lambda record: is_record(record, job.kind), out, restart=restart)
    with contextlib.closing(journal):
        if out.exists():  # who may read the result may read the journal, and after --restart the next result
            set_mode(journal.path, out.stat().st_mode | stat.S_IRUSR | stat.S_IWUSR)
        if restart:
            out.unlink(missing_ok=True)
        found = _found_in(out, wanted, journal)
        in_file, in_journal = found.in_file, found.in_journal
        _check_others(found.others, gone, out)
        if found.n_good and not in_file and not in_journal:
            raise ValueError(
                f"{out} holds {counted(found.n_good, 'result')}, none of a recording as it is here: "
                "another folder's? Give another --out, or --restart to throw it away"
            )
        collected.gone = len(found.others)
        collected.kept = len(in_file) + len(in_journal)
        to_do = [task for name, task in wanted.items() if name not in in_file and name not in in_journal]
        begin(len(to_do))
        doing = {task.recording for task in to_do}
        with contextlib.closing(place.run(function, to_do, lost)) as records:
            for record in records:
                doing.remove(record["recording"])  # a KeyError here would be a recording done twice
                journal.append(record)
                collected.done += 1
                each()

        def merged() -> Iterator[Record]:
            before = (r for r in read_results(out, job.kind, job.about, job.id) if r["recording"] in in_file)
            new = (journal.read(name) for name in sorted(wanted.keys() - in_file))
            return heapq.merge(before if in_file else iter(()), new, key=lambda record: record["recording"])

        if to_do or in_journal or found.others:
            seconds = {name: journal.read(name)[TIMED] for name in wanted.keys() - in_file}
            timeless = ({k: v for k, v in record.items() if k != TIMED} for record in merged())
            write_results(out, job.kind, job.about, timeless, like=journal.path)
        else:
            seconds = {}
        journal.remove()
    results = read_results(out, job.kind, job.about, job.id)
    return ({**record, TIMED: seconds.get(record["recording"])} for record in results)


@dataclass
class _Found:
    """What earlier runs have left: the recordings that are done in the result file, and in the journal, which counts
    before it; those of either that are not asked for; and how many hold a result and no error."""

    in_file: set[str] = field(default_factory=set)
    in_journal: set[str] = field(default_factory=set)
    others: list[str] = field(default_factory=list)
    n_good: int = 0

    def add(self, record: Record, wanted: Mapping[str, Task], done: set[str]) -> None:
        name = record["recording"]
        self.n_good += record["error"] is None
        if name not in wanted:
            self.others.append(name)
        elif _is_done(record, wanted[name]):
            done.add(name)


def _found_in(out: Path, wanted: Mapping[str, Task], journal: Journal) -> _Found:
    found = _Found()
    for name in journal.where:
        found.add(journal.read(name), wanted, found.in_journal)
    if out.exists() and out.stat().st_size:
        job = next(iter(wanted.values())).job
        for record in read_results(out, job.kind, job.about, job.id):
            if record["recording"] not in journal.where:
                found.add(record, wanted, found.in_file)
    return found


def _is_done(record: Record, task: Task) -> bool:
    return record["error"] is None and (record["bytes"], record["modified_ns"]) == (task.bytes, task.modified_ns)


def _check_others(others: list[str], gone: Callable[[str], bool], out: Path) -> None:
    there = [name for name in others if not gone(name)]
    if there:
        raise ValueError(
            f"{out} holds {counted(len(there), 'recording')} that this command does not name, such as {there[0]}: "
            "name all, give another --out, or --restart to throw it away"
        )
