"""Recordings, executors, and a Dask cluster."""

import pytest
from waiting import until

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


def dask_cluster(n_workers):
    """Workers of one thread each, which are replaced when they end."""
    distributed = pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    import dask

    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        return distributed.LocalCluster(n_workers=n_workers, threads_per_worker=1, dashboard_address=":0")


@pytest.fixture(scope="module")
def two_workers():
    """For each module: on a busy machine Dask may not replace a worker that a test has ended for minutes."""
    with dask_cluster(2) as cluster:
        yield cluster


@pytest.fixture
def cluster(two_workers, monkeypatch):
    """Address of a scheduler, once both its workers are there: a test before may have ended some."""
    from async_tnt.archive import dask_executor

    monkeypatch.setattr(dask_executor, "CONNECT_S", 120.0)
    until(lambda: len(two_workers.scheduler.workers) == 2)
    return two_workers.scheduler_address


@pytest.fixture
def empty_cluster():
    """Address of a scheduler without workers."""
    with dask_cluster(0) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["serial", "processes", "dask"])
def executor(request):
    """Every executor."""
    if request.param == "dask":
        address = request.getfixturevalue("cluster")
        from async_tnt.archive.dask_executor import DaskExecutor

        return DaskExecutor(address)
    return executor_of(1 if request.param == "serial" else 2)
