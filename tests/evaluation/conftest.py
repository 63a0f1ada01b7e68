"""Recordings, ways to run many tasks, and a Dask cluster."""

from functools import partial

import pytest
from waiting import until

from async_tnt.evaluation import processes
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.sources.files.recording import sample_recordings


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
    return distributed.LocalCluster(n_workers=n_workers, threads_per_worker=1, dashboard_address=":0")


@pytest.fixture(scope="module")
def two_workers():
    """For each module: on a busy machine Dask may not replace a worker that a test has ended for minutes."""
    with dask_cluster(2) as cluster:
        yield cluster


@pytest.fixture
def cluster(two_workers, monkeypatch):
    """Address of a scheduler, once both its workers are there: a test before may have ended some."""
    monkeypatch.setattr(processes, "CONNECT_S", 120.0)
    until(lambda: len(two_workers.scheduler.workers) == 2)
    return two_workers.scheduler_address


@pytest.fixture
def empty_cluster():
    """Address of a scheduler without workers."""
    with dask_cluster(0) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["here", "processes", "dask"])
def run(request):
    """Every way to run a function over tasks."""
    if request.param == "dask":
        address = request.getfixturevalue("cluster")
        return partial(run_on_dask, address=address)
    return partial(run_all, workers=1 if request.param == "here" else 2)
