"""`DaskExecutor`, what is special about a cluster: wrong addresses, workers that differ, chunks of tasks."""

import pickle
import socket
import threading

import pytest

pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")

from archive.made_work import JOB, make_tasks, record_of

from async_tnt.archive import dask_executor
from async_tnt.archive.dask_executor import DaskExecutor
from async_tnt.archive.records import lost

NAMES = [f"{k:02d}" for k in range(40)]


@pytest.fixture
def tasks(tmp_path):
    return make_tasks(tmp_path / "set", NAMES)


def test_the_cluster_has_few_chunks_at_a_time(cluster, tasks, monkeypatch):
    in_flight, sizes = [], []
    submit = dask_executor._Run._submit

    def watched(self, chunk, **settings):
        submit(self, chunk, **settings)
        in_flight.append(len(self._in_flight))
        sizes.append(len(chunk))

    monkeypatch.setattr(dask_executor._Run, "_submit", watched)
    assert len(list(DaskExecutor(cluster).run(record_of, tasks, lost))) == len(NAMES)
    assert max(in_flight) <= 4  # of two threads
    assert sum(sizes) == len(NAMES) and max(sizes) <= 11  # short ones go together, but never all to one worker
    sizes.clear()
    monkeypatch.setattr(dask_executor, "CHUNK_S", 0.0)  # every task is longer
    assert len(list(DaskExecutor(cluster).run(record_of, tasks[:6], lost))) == 6
    assert sizes == [1] * 6


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


@pytest.mark.parametrize("address", ["nowhere", "tcp://", "tcp://a:b", "://", "", "tcp://127.0.0.1"])
def test_not_an_address(address, tasks):
    with pytest.raises(ValueError, match="no host and port; expected the address that `dask scheduler` prints"):
        list(DaskExecutor(address).run(record_of, tasks, lost))


@pytest.mark.parametrize("kind", ["closed", "silent", "ssh"])
def test_an_address_where_no_scheduler_answers(kind, tasks, monkeypatch):
    monkeypatch.setattr(dask_executor, "CONNECT_S", 1.0)

    def greet():
        with server.accept()[0] as connection:
            connection.sendall(b"SSH-2.0-OpenSSH")

    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if kind != "closed":
            server.listen()
        if kind == "ssh":
            threading.Thread(target=greet, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ConnectionError, match="no Dask scheduler answers at tcp://127"):
            list(DaskExecutor(address).run(record_of, tasks, lost))


def test_nothing_to_do_needs_no_cluster():
    assert list(DaskExecutor("tcp://127.0.0.1:9").run(record_of, [], lost)) == []


def test_tasks_are_small_to_send(tasks):
    data = pickle.dumps(tasks[0])
    assert pickle.loads(data) == tasks[0] and len(data) < 1000 and tasks[0].job == JOB
