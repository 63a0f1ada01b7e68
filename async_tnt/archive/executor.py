"""Place: where the recordings of an archive are streamed."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from async_tnt.archive.job import Task
from async_tnt.archive.workers import run_all

Result = TypeVar("Result")


@dataclass(frozen=True)
class Place:
    """This process, or several processes of this machine, or a Dask cluster.

    Parameters
    ----------
    workers : processes; 1 is this one.
    dask : address of a cluster's scheduler, such as "tcp://10.0.0.1:8786"; then `workers` has no meaning.
    """

    workers: int = 1
    dask: str | None = None

    def run(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], lost: Callable[[Task], Result]
    ) -> Generator[Result]:
        """`function(task)` of each task, once each, in the order they are done; `lost(task)` of those that ended two
        workers.

        Raises
        ------
        OSError, ValueError, ImportError : the cluster cannot be reached, or cannot do the work.
        """
        if self.dask is None:
            yield from run_all(function, tasks, self.workers, lost=lost)
            return
        from async_tnt.archive.dask_cluster import run_on_dask

        yield from run_on_dask(function, tasks, self.dask, lost=lost)
