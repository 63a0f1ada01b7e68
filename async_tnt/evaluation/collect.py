"""Collect the records of many recordings in a result file, where a later run resumes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from async_tnt.evaluation.job import Task
from async_tnt.evaluation.records import TIMED, Record, lost
from async_tnt.evaluation.results import ResultFile, read_results
from async_tnt.files import check_writable


class Run(Protocol):
    """`run_all` or `run_on_dask`, with all but these arguments given."""

    def __call__(
        self, function: Callable[[Task], Record], tasks: Sequence[Task], *, lost: Callable[[Task], Record]
    ) -> Generator[Record]: ...


@dataclass
class Progress:
    """How far `collect` has come; valid also after an interruption.

    Parameters
    ----------
    total : recordings asked for.
    kept : of these, done by an earlier run.
    done : of these, done by this one.
    gone : recordings of an earlier run that no longer exist and are left out of the result.
    """

    total: int = 0
    kept: int = 0
    done: int = 0
    gone: int = 0


def collect(
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    run: Run,
    out: Path,
    progress: Progress,
    *,
    restart: bool = False,
    is_gone: Callable[[str], bool] = lambda recording: True,
    watch: Callable[[], object] = lambda: None,
) -> Iterator[Record]:
    """Do what is not done yet, write the result file, and return its records in order of the recordings' names.

    Records have `seconds` if this run measured it; the file has none. A recording is done again if its record has an
    error, or if its size, time of change or class differs.

    Parameters
    ----------
    tasks : at least one, all of one job, no two of one recording.
    restart : True discards the results of an earlier run.
    is_gone : whether a recording of an earlier run that is not in `tasks` no longer exists.
    watch : called before the first recording, when `progress` is complete, and after each one.

    Raises
    ------
    ValueError : this program has not written the file, or with other settings; or it holds recordings that exist but
        are not in `tasks`, or only others. OSError : another program is writing it, or it cannot be written.
    """
    out = check_writable(out)
    job = tasks[0].job
    wanted = {task.recording: task for task in tasks}
    seconds: dict[str, float] = {}
    with ResultFile(out, job, restart=restart) as file:
        to_do = [
            task for task in tasks if file.versions.get(task.recording) != (task.bytes, task.modified_ns, task.label)
        ]
        others = [name for name in file.versions if name not in wanted]
        existing = [name for name in others if not is_gone(name)]
        if existing:
            raise ValueError(
                f"{out} holds recordings that this command does not name ({len(existing):,}), such as {existing[0]}: "
                "name them too, or another file, or discard it by a restart"
            )
        n_good = sum(version is not None for version in file.versions.values())
        if n_good and len(to_do) == len(wanted):
            raise ValueError(
                f"{out} holds results ({n_good:,}), but none of a recording as it is here: of another folder? "
                "Name another file, or discard it by a restart"
            )
        progress.total, progress.kept, progress.gone = len(wanted), len(wanted) - len(to_do), len(others)
        watch()
        with contextlib.closing(run(function, to_do, lost=lost)) as records:
            for record in records:
                seconds[record["recording"]] = record.pop(TIMED)
                file.append(record)
                progress.done += 1
                watch()
        file.finish(wanted)
    return ({**record, TIMED: seconds.get(record["recording"])} for record in read_results(out, job))
