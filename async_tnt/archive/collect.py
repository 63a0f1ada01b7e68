"""Collect the records of an archive's recordings, in memory or in a result file that a later run goes on with."""

from __future__ import annotations

import contextlib
import heapq
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .job import Task
from .journal import FOLDER, Journal
from .place import Place
from .records import TIMED, Record, lost
from .results import check_ours, file_of, is_record, read_results, write_results


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


def journal_of(out: Path) -> Path:
    """Where the journal of a result file lies: beside it, the file itself if `out` is a link."""
    out = file_of(out)
    return out.with_name(out.name + ".partial")


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
    out = file_of(out)
    job = tasks[0].job
    wanted = {task.recording: task for task in tasks}
    collected.total = len(wanted)
    if restart and out.exists():
        check_ours(out)
    about = job.about if folder is None else {**job.about, FOLDER: folder}
    journal = Journal(journal_of(out), about, lambda record: is_record(record, job.kind), out, restart=restart)
    with contextlib.closing(journal):
        if out.exists():  # who may read the result may read the journal, and after --restart the next result
            journal.path.chmod(stat.S_IMODE(out.stat().st_mode) | stat.S_IRUSR | stat.S_IWUSR)
        if restart:
            out.unlink(missing_ok=True)
        in_file, others, n_good = _found_in(out, wanted, journal)
        _check_others(others, gone, out)
        in_journal = {name for name in journal.where if name in wanted and _is_done(journal.read(name), wanted[name])}
        if n_good and not in_file and not in_journal:
            raise ValueError(
                f"{out} holds results of {n_good} recordings, none of which is here as it was: of another folder? Give "
                "another --out, or --restart to throw it away"
            )
        collected.gone = len(others)
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

        if to_do or in_journal or others:
            seconds = {name: journal.read(name)[TIMED] for name in wanted.keys() - in_file}
            timeless = ({k: v for k, v in record.items() if k != TIMED} for record in merged())
            write_results(out, job.kind, job.about, timeless, like=out if out.exists() else journal.path)
        else:
            seconds = {}
        journal.remove()
    results = read_results(out, job.kind, job.about, job.id)
    return ({**record, TIMED: seconds.get(record["recording"])} for record in results)


def _found_in(out: Path, wanted: Mapping[str, Task], journal: Journal) -> tuple[set[str], list[str], int]:
    """Of the result file: recordings that are done, and not in the journal; of both, those that are not asked for, and
    the number of those without an error."""
    done = set()
    others = [name for name in journal.where if name not in wanted]
    n_good = sum(journal.read(name)["error"] is None for name in journal.where)
    if out.exists() and out.stat().st_size:
        job = next(iter(wanted.values())).job
        for record in read_results(out, job.kind, job.about, job.id):
            name = record["recording"]
            if name in journal.where:
                continue
            n_good += record["error"] is None
            if name not in wanted:
                others.append(name)
            elif _is_done(record, wanted[name]):
                done.add(name)
    return done, others, n_good


def _is_done(record: Record, task: Task) -> bool:
    return record["error"] is None and (record["bytes"], record["modified_ns"]) == (task.bytes, task.modified_ns)


def _check_others(others: list[str], gone: Callable[[str], bool], out: Path) -> None:
    there = [name for name in others if not gone(name)]
    if there:
        raise ValueError(
            f"{out} holds {len(there)} recordings that this command does not name, such as {there[0]}: name them too, "
            "give another --out, or --restart to throw it away"
        )
