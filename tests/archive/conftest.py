"""The program as a process, an archive of copies of the samples, and a Dask cluster."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from async_tnt.sources.files.recording import sample_recordings

ROOT = Path(__file__).resolve().parents[2]


def pytest_configure(config):
    config.addinivalue_line("markers", "needs_pyarrow: writes Parquet")


@pytest.fixture(autouse=True)
def _skip_without_pyarrow(request):
    if request.node.get_closest_marker("needs_pyarrow"):
        pytest.importorskip("pyarrow", reason="Parquet needs pyarrow (extra `cluster`)")


@pytest.fixture(scope="session")
def samples(tmp_path_factory):
    """<digit>/<number>.bin: 300 recordings, links to the ten bundled ones."""
    folder = tmp_path_factory.mktemp("archive") / "digits"
    for digit, path in sample_recordings().items():
        (folder / str(digit)).mkdir(parents=True)
        for k in range(30):
            (folder / str(digit) / f"{k:02d}.bin").symlink_to(path)
    return folder


@pytest.fixture
def start():
    """Start `async-tnt` with words, as a process of its own, which ends with the test."""
    started = []

    def begin(*words):
        paths = os.pathsep.join([str(ROOT), str(ROOT / "reference")])
        process = subprocess.Popen(
            [sys.executable, "-m", "async_tnt.cli", *map(str, words)],
            env={**os.environ, "PYTHONPATH": paths},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def wait_for_lines():
    """Wait until a file has so many lines."""

    def wait(path, n, process, timeout_s=60):
        until = time.monotonic() + timeout_s
        while not path.exists() or path.read_bytes().count(b"\n") < n:
            if process.poll() is not None or time.monotonic() > until:
                pytest.fail(f"ended before {n} lines: {process.communicate()}")
            time.sleep(0.001)

    return wait


@pytest.fixture(scope="session")
def cluster():
    """Address of a Dask scheduler with two workers, processes of one thread, which are started anew when they end."""
    distributed = pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    import dask

    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "reference"), str(ROOT / "tests")])
    try:
        with (
            dask.config.set({"distributed.scheduler.allowed-failures": 1}),
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address=":0", protocol="tcp", host="127.0.0.1"
            ) as made,
        ):
            yield made.scheduler_address
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before
