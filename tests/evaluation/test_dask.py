"""What is special about a Dask cluster: wrong addresses, and workers that differ."""

import socket

import pytest

pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")

from evaluation.made_work import make_tasks, record_of

from async_tnt.evaluation import dask_cluster
from async_tnt.evaluation.dask_cluster import run_on_dask
from async_tnt.evaluation.records import lost

NAMES = [f"{k:02d}" for k in range(4)]


@pytest.fixture
def tasks(tmp_path):
    return make_tasks(tmp_path / "set", NAMES)


def test_workers_that_cannot_read_the_files_are_named(cluster, tasks):
    for task in tasks:
        task.path.unlink()
    with pytest.raises(ValueError, match=r"worker tcp://\S+ cannot read .*00: all machines must see the files"):
        list(run_on_dask(record_of, tasks, cluster, lost))


def test_workers_of_another_version_are_named(cluster, tasks, monkeypatch):
    monkeypatch.setattr(dask_cluster, "__version__", "9.9")
    with pytest.raises(ValueError, match=r"worker tcp://\S+ has async_tnt \S+, expected 9.9: install it there"):
        list(run_on_dask(record_of, tasks, cluster, lost))


def test_a_cluster_without_workers(empty_cluster, tasks, monkeypatch):
    monkeypatch.setattr(dask_cluster, "CONNECT_S", 120.0)
    monkeypatch.setattr(dask_cluster, "WORKERS_S", 0.5)
    with pytest.raises(ConnectionError, match=r"has no workers: start some, with one thread each: dask worker tcp://"):
        list(run_on_dask(record_of, tasks, empty_cluster, lost))


@pytest.mark.parametrize("address", ["nowhere", "tcp://a:b"])
def test_not_an_address(address, tasks):
    with pytest.raises(ConnectionError, match=f"answers at '{address}'; expected the address that `dask scheduler`"):
        list(run_on_dask(record_of, tasks, address, lost))


def test_an_address_where_no_scheduler_answers(tasks, monkeypatch):
    monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.5)
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ConnectionError, match="no Dask scheduler answers at 'tcp://127"):
            list(run_on_dask(record_of, tasks, address, lost))
