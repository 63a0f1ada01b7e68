"""The same records from a Dask cluster; its workers are killed, its address is wrong, its versions differ."""

import os
import signal
import socket
import threading
import time

import pytest

pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")

from archive.made_work import JOB, deadly, long, make_tasks, record_of, slow

from async_tnt.archive import dask_cluster
from async_tnt.archive.collect import Collected, collect_to_file
from async_tnt.archive.dask_cluster import run_on_dask
from async_tnt.archive.executor import Place
from async_tnt.archive.records import lost

NAMES = [f"{k:02d}" for k in range(40)]


def test_the_same_file_as_in_this_process(cluster, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    for name, place in (("here", Place()), ("there", Place(dask=cluster))):
        list(collect_to_file(record_of, tasks, place, tmp_path / f"{name}.jsonl", Collected()))
    assert (tmp_path / "here.jsonl").read_bytes() == (tmp_path / "there.jsonl").read_bytes()


def test_a_worker_killed_in_the_middle_loses_no_recording(cluster, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    pids = tmp_path / "set" / "pids"

    def kill():
        while not pids.exists() or len(pids.read_text().splitlines()) < 8:
            time.sleep(0.005)
        os.kill(int(pids.read_text().split()[0]), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    records = list(run_on_dask(slow, tasks, cluster, lost=lost))
    killer.join()
    assert sorted(record["recording"] for record in records) == NAMES
    assert all(record["error"] is None for record in records)


def test_a_recording_that_kills_every_worker_is_an_error_of_its_own(cluster, tmp_path):
    names = [*NAMES[:10], "once", "poison", *NAMES[10:20]]
    tasks = make_tasks(tmp_path / "set", names)
    records = list(run_on_dask(deadly, tasks, cluster, lost=lost))
    assert sorted(record["recording"] for record in records) == sorted(names)
    assert [record["recording"] for record in records if record["error"]] == ["poison"]


def test_the_cluster_has_few_tasks_at_a_time(cluster, tmp_path, monkeypatch):
    most, sizes = [], []
    submit = dask_cluster._Spread._submit

    def watched(self, chunk):
        submit(self, chunk)
        most.append(len(self.running))
        sizes.append(len(chunk))

    monkeypatch.setattr(dask_cluster._Spread, "_submit", watched)
    assert len(list(run_on_dask(record_of, make_tasks(tmp_path / "set", NAMES), cluster, lost=lost))) == len(NAMES)
    assert 1 < max(most) <= 4  # of two threads
    assert sum(sizes) == len(NAMES) and 1 < max(sizes) <= 12  # short ones go together, but never all to one worker
    most, sizes[:] = [], []
    assert len(list(run_on_dask(long, make_tasks(tmp_path / "set", NAMES[:6]), cluster, lost=lost))) == 6
    assert set(sizes) == {1}


def test_an_error_of_the_work_stops_it(cluster, tmp_path):
    def broken(task):
        raise ImportError("no reader of that")

    with pytest.raises(ImportError, match="no reader of that"):
        list(run_on_dask(broken, make_tasks(tmp_path / "set", NAMES), cluster, lost=lost))


def test_workers_that_do_not_see_the_files_are_named(cluster, tmp_path, monkeypatch):
    tasks = make_tasks(tmp_path / "set", NAMES[:3])
    for task in tasks:
        task.path.unlink()
    with pytest.raises(ValueError, match=r"worker tcp://\S+ cannot read .*00: all machines must see the files"):
        list(run_on_dask(record_of, tasks, cluster, lost=lost))


def test_another_version_on_the_workers_is_named(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_cluster, "__version__", "9.9")
    with pytest.raises(ValueError, match=r"worker tcp://\S+ has async_tnt \S+, this program is 9.9: install the same"):
        list(run_on_dask(record_of, make_tasks(tmp_path / "set", NAMES[:3]), cluster, lost=lost))


def test_a_cluster_without_workers_is_told(tmp_path, monkeypatch):
    import distributed

    monkeypatch.setattr(dask_cluster, "WORKERS_S", 0.5)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0", protocol="tcp", host="127.0.0.1") as empty,
        pytest.raises(ConnectionError, match=r"has no workers: start some, `dask worker tcp://"),
    ):
        list(run_on_dask(record_of, make_tasks(tmp_path / "set", NAMES[:3]), empty.scheduler_address, lost=lost))


@pytest.mark.parametrize("address", ["nowhere", "tcp://", "tcp://a:b", "://", "", "tcp://127.0.0.1"])
def test_an_address_that_is_none(address, tmp_path):
    with pytest.raises(ValueError, match="no host and port; expected the address that `dask scheduler` prints"):
        list(run_on_dask(record_of, make_tasks(tmp_path / "set", NAMES[:1]), address, lost=lost))


def _greet(listening):
    with listening.accept()[0] as taken:
        taken.sendall(b"SSH-2.0-OpenSSH")


@pytest.mark.parametrize("kind", ["closed", "silent", "ssh"])
def test_an_address_where_no_scheduler_answers(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_cluster, "CONNECT_S", 1.0)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if kind != "closed":
            other.listen()
        if kind == "ssh":
            threading.Thread(target=_greet, args=(other,), daemon=True).start()
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        started = time.monotonic()
        with pytest.raises(ConnectionError, match="no Dask scheduler answers at tcp://127"):
            list(run_on_dask(record_of, make_tasks(tmp_path / "set", NAMES[:1]), address, lost=lost))
        assert time.monotonic() - started < 10


def test_nothing_to_do_needs_no_cluster():
    assert list(run_on_dask(record_of, [], "tcp://127.0.0.1:9", lost=lost)) == []


def test_tasks_are_small_to_send(tmp_path):
    import pickle

    (task,) = make_tasks(tmp_path / "set", ["a"])
    assert pickle.loads(pickle.dumps(task)) == task and len(pickle.dumps(task)) < 1000
    assert task.job == JOB
