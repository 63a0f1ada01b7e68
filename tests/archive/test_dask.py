"""`DaskExecutor`, what is special about a cluster: wrong addresses, and workers that differ."""

import socket
import threading

import pytest

pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")

from archive.made_work import make_tasks, record_of

from async_tnt.archive import dask_executor
from async_tnt.archive.dask_executor import DaskExecutor
from async_tnt.archive.records import lost

NAMES = [f"{k:02d}" for k in range(4)]


@pytest.fixture
def tasks(tmp_path):
    return make_tasks(tmp_path / "set", NAMES)


def test_workers_that_cannot_read_the_files_are_named(cluster, tasks):
    for task in tasks:
        task.path.unlink()
    with pytest.raises(ValueError, match=r"worker tcp://\S+ cannot read .*00: all machines must see the files"):
        list(DaskExecutor(cluster).run(record_of, tasks, lost))


def test_workers_of_another_version_are_named(cluster, tasks, monkeypatch):
    monkeypatch.setattr(dask_executor, "__version__", "9.9")
    with pytest.raises(ValueError, match=r"worker tcp://\S+ has async_tnt \S+, this program is 9.9: install the same"):
        list(DaskExecutor(cluster).run(record_of, tasks, lost))


def test_a_cluster_without_workers(empty_cluster, tasks, monkeypatch):
    monkeypatch.setattr(dask_executor, "CONNECT_S", 120.0)
    monkeypatch.setattr(dask_executor, "WORKERS_S", 0.5)
    with pytest.raises(ConnectionError, match=r"has no workers: start some, `dask worker tcp://"):
        list(DaskExecutor(empty_cluster).run(record_of, tasks, lost))


@pytest.mark.parametrize("address", ["nowhere", "tcp://a:b", ""])
def test_not_an_address(address, tasks):
    with pytest.raises(ValueError, match="no host and port; expected the address that `dask scheduler` prints"):
        list(DaskExecutor(address).run(record_of, tasks, lost))


@pytest.mark.parametrize("kind", ["closed", "ssh"])
def test_an_address_where_no_scheduler_answers(kind, tasks, monkeypatch):
    monkeypatch.setattr(dask_executor, "CONNECT_S", 1.0)

    def greet():
        with server.accept()[0] as connection:
            connection.sendall(b"SSH-2.0-OpenSSH")

    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if kind == "ssh":
            server.listen()
            threading.Thread(target=greet, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ConnectionError, match="no Dask scheduler answers at tcp://127"):
            list(DaskExecutor(address).run(record_of, tasks, lost))
