"""Recordings, executors, and a Dask cluster."""

import os

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


@pytest.fixture(scope="session")
def local_cluster():
    """A scheduler in this process, and two workers of one thread, which are replaced when they end."""
    distributed = pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    import dask

    settings = {
        "distributed.scheduler.allowed-failures": 1,
        "distributed.comm.timeouts.connect": "120s",  # of a machine that does much else
        "distributed.worker.memory.terminate": False,
    }
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = PATHS
    try:
        with (
            dask.config.set(settings),
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, protocol="tcp", host="127.0.0.1", dashboard_address=":0"
            ) as cluster,
        ):
            yield cluster
    finally:
        os.environ.pop("PYTHONPATH") if before is None else os.environ.update(PYTHONPATH=before)


@pytest.fixture
def cluster(local_cluster, monkeypatch):
    """Its address, once both workers are there: a test before may have ended some."""
    from async_tnt.archive import dask_executor

    monkeypatch.setattr(dask_executor, "CONNECT_S", 120.0)
    wait_until(lambda: len(local_cluster.scheduler.workers) == 2)
    return local_cluster.scheduler_address


@pytest.fixture(params=["serial", "processes", "dask"])
def executor(request):
    """Every executor."""
    if request.param == "dask":
        address = request.getfixturevalue("cluster")
        from async_tnt.archive.dask_executor import DaskExecutor

        return DaskExecutor(address)
    return executor_of(1 if request.param == "serial" else 2)
