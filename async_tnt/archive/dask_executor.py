"""The executor that runs a function over many tasks on the machines of a Dask cluster."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from async_tnt.archive.executor import Lost
from async_tnt.checks import needs_extra
from async_tnt.version import __version__

Task = TypeVar("Task")
Result = TypeVar("Result")

CONNECT_S = 10.0  # for the scheduler to answer
WORKERS_S = 15.0  # for the first worker to appear
PATIENCE_S = 120.0  # for a worker to appear again after the last one was lost
POLL_S = 2.0
IN_FLIGHT = 2  # chunks for each of the cluster's threads: one in progress, one queued
CHUNK_S = 0.2  # aim for a chunk's duration: sending one costs some milliseconds, as much as a short recording
MAX_CHUNK = 100
EXPECTED = "expected the address that `dask scheduler` prints, such as tcp://10.0.0.1:8786"


class DaskExecutor:
    """The workers of a Dask cluster, for an archive's tasks; `address` is that of its scheduler."""

    def __init__(self, address: str) -> None:
        self.address = address

    def run(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], lost: Lost[Task, Result] = None
    ) -> Generator[Result]:
        """See `Executor.run`.

        The cluster has a few chunks of tasks at a time; a long recording is a chunk of its own. Dask gives up a chunk
        after `distributed.scheduler.allowed-failures` + 1 workers that had it have ended (4 by default). It may only
        have been queued there, so each of its tasks is tried once more, alone.

        Raises
        ------
        ImportError : Dask is not installed.
        ValueError : not an address; or workers have no async_tnt, another version of it, or cannot read the files.
        OSError : no scheduler answers, or it is gone; there are no workers, or none for `PATIENCE_S`.
        """
        if tasks:
            with _connected(self.address) as client:
                _check_workers(client, self.address, tasks)
                yield from _Run(client, self.address, function, lost).results(tasks)


class _Run:
    """Tasks on a cluster, a bounded number at a time."""

    def __init__(self, client: Any, address: str, function: Callable[[Any], Any], lost: Lost[Any, Any]) -> None:
        self._client, self._address = client, address
        self._function, self._lost = function, lost
        self._in_flight: dict[str, tuple[Any, list[Any], bool]] = {}  # key -> (future, chunk, whether it is a retry)
        self._suspects: deque[Any] = deque()  # tasks of chunks that ended their workers
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._chunk = 1
        self._n_threads = 1
        self._polled = self._worker_seen = time.monotonic()

    def results(self, tasks: Sequence[Any]) -> Generator[Any]:
        waiting = deque(tasks)
        while waiting or self._in_flight or self._suspects:
            self._count_threads()
            while waiting and len(self._in_flight) < IN_FLIGHT * self._n_threads:
                share = 1 + len(waiting) // (4 * self._n_threads)  # small chunks at the end: no worker idles
                self._submit([waiting.popleft() for _ in range(min(self._chunk, share, len(waiting)))])
            if self._suspects and not self._in_flight:
                self._submit([self._suspects.popleft()], is_retry=True)
            yield from self._next_results()

    def _submit(self, chunk: list[Any], *, is_retry: bool = False) -> None:
        # a unique key and pure=False: never the result of another program's call
        key = f"async-tnt-{uuid.uuid4().hex}"
        future = self._client.submit(_run_chunk, self._function, chunk, key=key, pure=False)
        self._in_flight[key] = future, chunk, is_retry
        future.add_done_callback(self._ended.put)

    def _next_results(self) -> list[Any]:
        """Results of a chunk that has ended; none if no chunk ends within a second, or if it ended its workers."""
        from distributed import KilledWorker

        try:
            future = self._ended.get(timeout=1.0)
        except queue.Empty:
            return []
        if future.key not in self._in_flight:
            return []
        _, chunk, is_retry = self._in_flight[future.key]
        results: list[Any] = []
        try:
            seconds, results = future.result(timeout=30.0)  # waits if it was lost with its worker and is repeated
            self._chunk = max(1, min(int(CHUNK_S * len(chunk) / max(seconds, 1e-6)), 2 * self._chunk, MAX_CHUNK))
        except KilledWorker:
            if not is_retry:
                self._suspects += chunk
            elif self._lost is None:
                raise ChildProcessError(f"a task ended its workers of the Dask cluster at {self._address}") from None
            else:
                results = [self._lost(chunk[0])]
        except CancelledError:
            raise ConnectionError(f"the Dask scheduler at {self._address} is gone, or has cancelled the work") from None
        except TimeoutError:
            if future.status == "error":  # the task's own
                raise
            self._ended.put(future)
            return []
        del self._in_flight[future.key]
        return results

    def _count_threads(self) -> None:
        """Follow the size of the cluster; give up when it has had no worker for too long."""
        now = time.monotonic()
        if now - self._polled < POLL_S and self._in_flight:
            return
        try:
            n_threads = sum(self._client.nthreads().values()) if self._client.status == "running" else None
        except Exception:
            n_threads = None
        if n_threads is None:
            raise ConnectionError(f"the Dask scheduler at {self._address} is gone")
        self._polled = now
        if n_threads:
            self._n_threads, self._worker_seen = n_threads, now
        elif now - self._worker_seen > PATIENCE_S:
            raise ConnectionError(f"the Dask cluster at {self._address} has had no worker for {PATIENCE_S:.0f} s")


def _run_chunk(function: Callable[[Any], Any], chunk: list[Any]) -> tuple[float, list[Any]]:
    """On a worker: the seconds it took, and the results."""
    started = time.perf_counter()
    results = [function(task) for task in chunk]
    return time.perf_counter() - started, results


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Any]:
    with needs_extra("cluster", "--dask needs Dask"):
        from distributed import Client, rpc
    _check_address(address)

    async def identify() -> None:
        async with rpc(address) as scheduler:
            await scheduler.identity()

    logging.disable()  # errors become a one-line message; Dask would log them too, with their tracebacks
    try:
        try:
            # `Client` has a timeout of its own, but waits forever for a server that accepts and does not answer
            asyncio.run(asyncio.wait_for(identify(), CONNECT_S))
            client = Client(address, timeout=CONNECT_S, set_as_default=False, name="async-tnt")
        except Exception as error:  # of many types, depending on what is wrong with the address
            why = " ".join(str(error).split()) or type(error).__name__
            raise ConnectionError(f"no Dask scheduler answers at {address}; {EXPECTED} ({why})") from None
        try:
            yield client
        finally:
            client.close(timeout=5)
    finally:
        logging.disable(logging.NOTSET)


def _check_address(address: str) -> None:
    try:
        parts = urlsplit(address if "://" in address else f"tcp://{address}")
        is_address = bool(parts.hostname and parts.port)
    except ValueError:
        is_address = False
    if not is_address:
        raise ValueError(f"--dask {address}: no host and port; {EXPECTED}")


def _check_workers(client: Any, address: str, tasks: Sequence[Any]) -> None:
    """Ask every worker, before any work, whether it has this package and can read the files."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        raise ConnectionError(
            f"the Dask cluster at {address} has no workers: start some, `dask worker {address} --nthreads 1`"
        ) from None
    files = [str(next((task for task in tasks if task.bytes is not None), tasks[0]).path)]
    model = tasks[0].job.model
    if Path(model).is_absolute():
        files.append(model)

    # A nested function is sent as code: a worker without async_tnt could not import another.
    def look(files: list[str]) -> tuple[str | None, str, list[str]]:
        import os

        try:
            from async_tnt.version import __version__
        except ImportError as error:
            return None, str(error), []
        return __version__, "", [file for file in files if not os.access(file, os.R_OK)]

    try:
        found = client.run(look, files)
    except Exception as error:
        raise ConnectionError(f"a worker of the Dask cluster at {address} does not answer: {error}") from None
    for worker, (version, why, unreadable) in found.items():
        if version is None:
            raise ValueError(f"worker {worker} has no async_tnt ({why}): install it there, version {__version__}")
        if version != __version__:
            raise ValueError(
                f"worker {worker} has async_tnt {version}, this program is {__version__}: install the same"
            )
        if unreadable:
            raise ValueError(
                f"worker {worker} cannot read {unreadable[0]}: all machines must see the files by the same path"
            )
