"""The program as a process, executors, and a Dask cluster."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from async_tnt.archive.executor import executor_of
from async_tnt.sources.files.recording import sample_recordings

ROOT = Path(__file__).resolve().parents[2]
PATHS = os.pathsep.join(str(ROOT / name) for name in ("", "reference", "tests"))


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


@pytest.fixture
def start():
    """Start Python with words, as a process of its own, which ends with the test."""
    with contextlib.ExitStack() as stack:

        def begin(*words):
            process = subprocess.Popen(
                [sys.executable, *map(str, words)],
                env={**os.environ, "PYTHONPATH": PATHS},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.callback(process.communicate)
            stack.callback(process.kill)
            return process

        yield begin


@pytest.fixture
def wait_until():
    """Wait until something holds."""

    def wait(holds, timeout_s=120):
        end = time.monotonic() + timeout_s
        while not holds():
            assert time.monotonic() < end
            time.sleep(0.005)

    return wait


@contextlib.contextmanager
def dask_cluster(folder, n_workers):
    """Address of a Dask scheduler, with workers of one thread that are restarted when they end."""
    env = {**os.environ, "PYTHONPATH": PATHS, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    options = {"env": env, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    python, host = [sys.executable, "-m"], ["--host", "127.0.0.1", "--no-dashboard"]
    written = folder / "scheduler.json"
    words = ["distributed.cli.dask_scheduler", *host, "--port", "0", "--scheduler-file", written]
    scheduler = subprocess.Popen([*python, *words], **options)
    processes = [scheduler]
    address = ""

    def keep_worker():
        while scheduler.poll() is None:
            words = [
                "distributed.cli.dask_worker",
                address,
                *host,
                "--nthreads",
                "1",
                "--no-nanny",
                "--death-timeout",
                "60",
            ]
            worker = subprocess.Popen([*python, *words, "--local-directory", folder], **options)
            processes.append(worker)
            worker.wait()

    threads = [threading.Thread(target=keep_worker) for _ in range(n_workers)]
    try:
        while not address:
            assert scheduler.poll() is None
            time.sleep(0.05)
            with contextlib.suppress(OSError, ValueError):
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
def cluster(tmp_path_factory):
    """Address of a Dask scheduler with two workers."""
    pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    with dask_cluster(tmp_path_factory.mktemp("cluster"), 2) as address:
        yield address


@pytest.fixture
def empty_cluster(tmp_path):
    """Address of a Dask scheduler without workers."""
    pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    with dask_cluster(tmp_path, 0) as address:
        yield address


@pytest.fixture(params=["serial", "processes", "dask"])
def executor(request):
    """Every executor."""
    if request.param == "dask":
        return executor_of(dask=request.getfixturevalue("cluster"))
    return executor_of(1 if request.param == "serial" else 2)
