"""Recordings, ways to run many tasks, and a Dask cluster."""

import importlib
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
    """Workers of one thread each, which are replaced when they end.

    A task that has ended a worker is given up.
    """
    distributed = pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    with importlib.import_module("dask").config.set({"distributed.scheduler.allowed-failures": 0}):
        return distributed.LocalCluster(
            n_workers=n_workers, threads_per_worker=1, dashboard_address=":0"
        )


@pytest.fixture(scope="module")
def clusters():
    """The newest one is in use."""
    started = []
    yield started
    for cluster in started:
        cluster.close()


@pytest.fixture
def cluster(clusters, monkeypatch):
    """The address of a scheduler with two workers.

    If a test has ended some workers, this is another scheduler, as Dask may never replace them
    on a busy machine.
    """
    monkeypatch.setattr(processes, "CONNECT_S", 120.0)
    if not clusters or len(clusters[-1].scheduler.workers) < 2:
        clusters.append(dask_cluster(2))
    until(lambda: len(clusters[-1].scheduler.workers) == 2)
    return clusters[-1].scheduler_address


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
