"""Recordings, executors, and a Dask cluster."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time

import pytest
from processes import PATHS, wait_until

from async_tnt.archive.executor import executor_of
from async_tnt.sources.files.recording import sample_recordings


def pytest_configure(config):
    config.addinivalue_line("markers", "needs_pyarrow: writes Parquet")


@pytest.fixture(autouse=True)
def _skip_without_pyarrow(request):
    if request.node.get_closest_marker("needs_pyarrow"):
        pytest.importorskip("pyarrow", reason="Parquet needs pyarrow (extra `cluster`)")


@pytest.fixture(scope="session")
def samples(tmp_path_factory):
    """<digit>/<number>.bin: two recordings of each digit."""
    folder = tmp_path_factory.mktemp("archive") / "digits"
    for digit, path in sample_recordings().items():
        (folder / str(digit)).mkdir(parents=True)
        for k in range(2):
            (folder / str(digit) / f"{k:02d}.bin").write_bytes(path.read_bytes())
    return folder


@contextlib.contextmanager
def dask_cluster(folder, n_workers):
    """Address of a Dask scheduler, with workers of one thread that are replaced when they end."""
    written = folder / "scheduler.json"
    options = {
        "env": {**os.environ, "PYTHONPATH": PATHS, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"},
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    common = ["--host", "127.0.0.1", "--no-dashboard"]
    worker = ["--nthreads", "1", "--no-nanny", "--death-timeout", "60", "--local-directory", str(folder)]
    processes = []

    def start(module, *words):
        process = subprocess.Popen([sys.executable, "-m", f"distributed.cli.{module}", *common, *words], **options)
        processes.append(process)
        return process

    def keep_worker():
        while scheduler.poll() is None:
            start("dask_worker", address, *worker).wait()

    scheduler = start("dask_scheduler", "--port", "0", "--scheduler-file", str(written))
    threads = [threading.Thread(target=keep_worker) for _ in range(n_workers)]
    try:
        wait_until(lambda: written.exists() and written.read_text().endswith("}"))
        address = json.loads(written.read_text())["address"]
        for thread in threads:
            thread.start()
        yield address
    finally:
        scheduler.kill()
        scheduler.wait()
        while any(thread.is_alive() for thread in threads):  # one may just be starting another worker
            for process in processes:
                process.kill()
            time.sleep(0.05)


@pytest.fixture(scope="session")
def any_cluster(tmp_path_factory):
    pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    with dask_cluster(tmp_path_factory.mktemp("cluster"), 2) as address:
        yield address


@pytest.fixture
def cluster(any_cluster, monkeypatch):
    """Address of a scheduler, once both its workers are there: a test before may have ended some."""
    from distributed import Client

    from async_tnt.archive import dask_executor

    monkeypatch.setattr(dask_executor, "CONNECT_S", 120.0)
    with Client(any_cluster, timeout=120, set_as_default=False) as client:
        wait_until(lambda: len(client.nthreads()) == 2)
    return any_cluster


@pytest.fixture
def empty_cluster(tmp_path):
    """Address of a scheduler without workers."""
    with dask_cluster(tmp_path, 0) as address:
        yield address


@pytest.fixture(params=["serial", "processes", "dask"])
def executor(request):
    """Every executor."""
    if request.param == "dask":
        address = request.getfixturevalue("cluster")
        from async_tnt.archive.dask_executor import DaskExecutor

        return DaskExecutor(address)
    return executor_of(1 if request.param == "serial" else 2)
