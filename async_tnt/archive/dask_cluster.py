"""Run a function over many tasks on the machines of a Dask cluster."""

from __future__ import annotations

import contextlib
import logging
import queue
import socket
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from async_tnt import __version__
from async_tnt.archive.job import Task

Result = TypeVar("Result")

CONNECT_S = 10.0
"""For the scheduler to answer."""
WORKERS_S = 15.0
"""For the first worker to be there."""
PATIENCE_S = 120.0
"""For a worker to be there again, after the last one was lost."""
IN_FLIGHT = 2
"""Chunks of tasks that the cluster has at a time, for each of its threads: one to do, and the next."""
CHUNK_S = 0.2
"""That a chunk is to take: sending one costs some ms, as long as a short recording."""
MOST = 100
"""Tasks in a chunk."""
EXPECTED = "expected the address that `dask scheduler` prints, such as tcp://10.0.0.1:8786"


def run_on_dask(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    address: str,
    *,
    lost: Callable[[Task], Result],
    patience_s: float = PATIENCE_S,
) -> Generator[Result]:
    """Results of `function(task)`, once each, in the order they are done.

    The cluster has a few chunks of tasks at a time, whatever their number; a chunk of long recordings is one. Those of
    a lost worker are done again by others. Dask gives a chunk up when it was at
    `distributed.scheduler.allowed-failures` + 1 workers that ended (4 by default). It may only have waited there, so
    each of its tasks is tried once more, alone; `lost` gives the result where that ends workers, too.

    Raises
    ------
    ImportError : Dask is not installed.
    OSError : nobody answers at `address`, there are no workers, or all are lost for `patience_s`.
    ValueError : workers have no async_tnt, another version of it, or do not see the files.
    """
    if not tasks:
        return
    with _connected(address) as client:
        _check_workers(client, address, tasks)
        yield from _Spread(client, function, address, patience_s).run(tasks, lost)


class _Spread:
    """Tasks on a cluster, a bounded number at a time."""

    def __init__(self, client: Any, function: Callable[[Task], Any], address: str, patience_s: float) -> None:
        self.client = client
        self.function = function
        self.address = address
        self.patience_s = patience_s
        self.name = f"async-tnt-{uuid.uuid4().hex[:12]}"  # two programs on one cluster keep apart
        self.n_submitted = 0
        self.running: dict[str, tuple[Any, list[Task]]] = {}
        self.chunk = 1
        self.done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.n_threads = 1
        self.looked = -1e9
        self.last_worker = time.monotonic()

    def run(self, tasks: Sequence[Task], lost: Callable[[Task], Result]) -> Generator[Result]:
        waiting = deque(tasks)
        suspects: list[Task] = []
        while waiting or self.running:
            self._look()
            while waiting and len(self.running) < IN_FLIGHT * self.n_threads:
                share = 1 + len(waiting) // (4 * self.n_threads)  # at the end all workers have something to do
                self._submit([waiting.popleft() for _ in range(min(self.chunk, share))])
            for chunk, answers in self._next():
                if answers is None:
                    suspects += chunk
                else:
                    yield from answers
        for task in suspects:
            self._submit([task])
            while self.running:
                self._look()
                for _, answers in self._next():
                    yield from [lost(task)] if answers is None else answers

    def _submit(self, chunk: list[Task]) -> None:
        self.n_submitted += 1
        # pure=False and a key of its own: nobody's earlier result is taken for this one's
        key = f"{self.name}-{self.n_submitted}"
        future = self.client.submit(_do_chunk, self.function, chunk, key=key, pure=False)
        self.running[future.key] = future, chunk
        future.add_done_callback(self.done.put)

    def _next(self) -> Iterator[tuple[list[Task], list[Any] | None]]:
        """At most one chunk that has ended, and its results; None for results if it ended workers."""
        from distributed import KilledWorker

        try:
            future = self.done.get(timeout=1.0)
        except queue.Empty:
            return
        if future.key not in self.running:
            return
        _, chunk = self.running[future.key]
        status = future.status
        answers = None
        if status == "error":
            error = future.exception()
            if not isinstance(error, KilledWorker):
                raise error
        elif status == "finished":
            try:
                seconds, answers = future.result(timeout=30.0)
            except TimeoutError:  # its worker was lost with it: the scheduler has it done again
                future.add_done_callback(self.done.put)
                return
            fitting = int(CHUNK_S * len(chunk) / max(seconds, 1e-6))
            self.chunk = max(1, min(fitting, 2 * self.chunk, MOST))
        else:  # the scheduler was lost, or somebody has cancelled our work
            del self.running[future.key]
            self._look(now=True)
            self._submit(chunk)
            return
        del self.running[future.key]
        future.release()
        yield chunk, answers

    def _look(self, *, now: bool = False) -> None:
        """Count the cluster's threads, every few seconds; give up where there are none for long."""
        if not now and time.monotonic() - self.looked < 2.0:
            return
        gone = f"the Dask scheduler at {self.address} is gone"
        if self.client.status != "running":
            raise ConnectionError(gone)
        try:
            threads = sum(self.client.nthreads().values())
        except Exception as error:
            raise ConnectionError(f"{gone} ({' '.join(str(error).split())})") from None
        self.looked = time.monotonic()
        if threads:
            self.last_worker = self.looked
            self.n_threads = threads
        elif self.looked - self.last_worker > self.patience_s:
            raise ConnectionError(
                f"the Dask cluster at {self.address} has had no worker for {self.patience_s:.0f} s: all were lost"
            )


def _do_chunk(function: Callable[[Task], Any], chunk: list[Task]) -> tuple[float, list[Any]]:
    """On a worker: the seconds it took, and the results."""
    started = time.perf_counter()
    answers = [function(task) for task in chunk]
    return time.perf_counter() - started, answers


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError(f"--dask needs Dask: pip install '.[cluster]' ({error})") from None
    with _quiet():
        try:
            _wait_for_scheduler(address)
            client = Client(address, timeout=CONNECT_S, set_as_default=False, name="async-tnt")
        except ValueError:
            raise
        except Exception as error:  # of many types, by what is wrong with the address
            raise ConnectionError(
                f"no Dask scheduler answers at {address}; {EXPECTED} "
                f"({' '.join(str(error).split()) or type(error).__name__})"
            ) from None
        try:
            yield client
        finally:
            client.close(timeout=5)


def _wait_for_scheduler(address: str) -> None:
    """Return when something at the address speaks as a Dask scheduler does.

    Dask itself waits for ever for the first word of a server that takes the connection and is silent, and 20 s where
    the port is missing.

    Raises
    ------
    ValueError : no such address can be. OSError : nobody answers within `CONNECT_S`, or another kind of server.
    """
    try:
        parts = urlsplit(address if "://" in address else f"tcp://{address}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if host is None or port is None:
        raise ValueError(f"--dask {address}: no host and port; {EXPECTED}")
    if parts.scheme != "tcp":  # with tls, ws the client speaks first
        return
    deadline = time.monotonic() + CONNECT_S
    while True:
        try:
            with socket.create_connection((host, port), timeout=max(0.1, deadline - time.monotonic())) as probe:
                probe.settimeout(CONNECT_S)
                start = probe.recv(8)  # of a message: its length
            break
        except ConnectionRefusedError:  # it may be about to start
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)
    if len(start) < 8 or int.from_bytes(start, "little") > 1 << 20:
        raise ConnectionError("another kind of server is there")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """What goes wrong is told by us, in one line; Dask would log it, too, with its traceback."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "tornado", "asyncio")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _check_workers(client: Any, address: str, tasks: Sequence[Task]) -> None:
    """Ask every worker, before any work, whether it can do it."""
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

    # A function inside a function travels as code: a worker without async_tnt could not import another.
    def look(files: list[str]) -> dict[str, Any]:
        import os

        try:
            import async_tnt

            version = async_tnt.__version__
        except ImportError as error:
            version = None
            why = str(error)
        else:
            why = ""
        return {"version": version, "why": why, "hidden": [f for f in files if not os.access(f, os.R_OK)]}

    try:
        found = client.run(look, files)
    except Exception as error:
        raise ConnectionError(f"a worker of the Dask cluster at {address} does not answer: {error}") from None
    for worker, seen in found.items():
        if seen["version"] is None:
            raise ValueError(
                f"worker {worker} has no async_tnt ({seen['why']}): install it there, version {__version__}"
            )
        if seen["version"] != __version__:
            raise ValueError(
                f"worker {worker} has async_tnt {seen['version']}, this program is {__version__}: install the same"
            )
        if seen["hidden"]:
            raise ValueError(
                f"worker {worker} cannot read {seen['hidden'][0]}: all machines must see the files by the same path"
            )
