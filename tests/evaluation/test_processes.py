"""Every way to run many tasks.

Each task is done once, lost workers are replaced, and workers end with the program.
"""

import contextlib
import logging
import os
import socket
import struct
import time
from concurrent.futures import CancelledError
from pathlib import Path
from types import SimpleNamespace

import pytest
from evaluation.made_work import deadly, make_tasks, record_of
from evaluation.simple_work import (
    answer_with,
    end_itself,
    note_limits,
    own_process,
    raise_odd,
    sent_within_limit,
    sleep_or_end,
    twice,
)
from processes import started
from waiting import until

from async_tnt.base.worker import Worker, WorkerEnded
from async_tnt.evaluation import processes as ways
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.evaluation.records import lost_record

posix = pytest.mark.skipif(os.name != "posix", reason="kill -9 of POSIX")
replacing_workers = pytest.mark.parametrize("run", ["processes", "dask"], indirect=True)
NAMES = [f"{k:02d}" for k in range(40)]


def test_every_task_is_done_once(run, tmp_path, monkeypatch):
    """Equal tasks, too, and more tasks than a cluster has at a time. Without tasks nothing is."""
    monkeypatch.setattr(ways, "IN_FLIGHT", 7)
    records = list(run(record_of, make_tasks(tmp_path / "set", NAMES), lost=lost_record))
    assert sorted(record["label"] for record in records) == NAMES
    assert list(run(twice, [2, 2, 2], lost=twice)) == [4, 4, 4]
    assert list(run(twice, [], lost=twice)) == []


@pytest.mark.parametrize(
    ("n_tasks", "workers", "n_processes"), [(8, 2, 2), (8, 3, 3), (2, 4, 2), (1, 2, 1)]
)
def test_there_are_as_many_processes_as_workers_and_no_more_than_tasks(
    n_tasks, workers, n_processes
):
    used = {*run_all(own_process, range(n_tasks), workers)}
    assert len(used) == n_processes and os.getpid() not in used


def test_one_worker_is_this_process():
    assert {*run_all(own_process, range(3), 1)} == {os.getpid()}


@posix
@replacing_workers
def test_a_task_that_ends_its_worker_is_named_and_the_others_are_done_once(run, tmp_path, request):
    names = [*NAMES[:10], "poison", *NAMES[10:20]]
    records = list(run(deadly, make_tasks(tmp_path / "set", names), lost=lost_record))
    assert sorted(record["recording"] for record in records) == sorted(names)
    errors = {
        record["recording"]: record["error"] for record in records if record["error"] is not None
    }
    assert errors.keys() == {"poison"}
    assert "its worker ended: killed, out of memory" in errors["poison"]
    if "processes" in request.node.name:  # Dask repeats tasks of a worker that has ended
        assert sorted((tmp_path / "set" / "begun").read_text().split()) == sorted(names)


@posix
def test_each_task_after_a_lost_worker_gets_a_new_one():
    """No worker is left idle that could take the next task."""
    assert sorted(run_all(end_itself, range(4), 2, lost=twice)) == [0, 2, 4, 6]


@posix
def test_without_a_result_for_lost_tasks_a_lost_worker_is_an_error():
    with pytest.raises(WorkerEnded):
        list(run_all(end_itself, range(4), 2))


def test_a_scheduler_that_is_gone_is_an_error_of_one_line():
    def cancelled():
        raise CancelledError

    with pytest.raises(ConnectionError, match="the Dask scheduler at tcp://a:1 is gone, or has"):
        ways._result(SimpleNamespace(result=cancelled), "tcp://a:1")


def test_without_tasks_no_scheduler_is_needed():
    assert list(run_on_dask(record_of, [], "nowhere", lost_record)) == []


def test_what_cannot_be_pickled_is_an_error():
    with pytest.raises(RuntimeError, match="OddError: 7, not 0") as raised:
        list(run_all(raise_odd, [7, 7], 2))
    assert "in raise_odd" in raised.value.__notes__[0]  # the worker's traceback


def is_running(pid):
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except ProcessLookupError:
        return False
    except OSError:  # no /proc
        return not Path("/proc").is_dir()


@posix
@pytest.mark.parametrize("end", ["return", "raise"])
def test_closing_or_an_error_ends_workers_in_the_middle_of_their_tasks(end, tmp_path):
    results = run_all(sleep_or_end, [(tmp_path, "sleep"), (tmp_path, "sleep"), (tmp_path, end)], 3)
    with contextlib.closing(results), contextlib.suppress(ZeroDivisionError):
        next(results)
    pids = [int(path.stem) for path in tmp_path.glob("*.pid")]
    assert len(pids) == 2 and not any(is_running(pid) for pid in pids)


@posix
def test_killing_the_program_ends_its_workers_in_the_middle_of_their_tasks(tmp_path):
    with started(
        "-c", f"from evaluation.simple_work import run_sleepers; run_sleepers({str(tmp_path)!r})"
    ) as process:
        until(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
        pids = [int(path.stem) for path in tmp_path.glob("*.pid")]
        assert all(is_running(pid) for pid in pids)
        process.kill()
        until(lambda: not any(is_running(pid) for pid in pids))


def test_a_call_over_its_limit_ends_the_worker():
    worker = Worker()
    worker.submit(twice, 2)
    assert worker.result() == 4
    # The worker ends by itself, even if its parent is gone.
    worker.submit(time.sleep, 3600, limit_s=0.1)
    with pytest.raises(
        WorkerEnded, match="a worker process crashed, hung, was killed, or ran out of memory"
    ):
        worker.result()
    worker.end()
    worker = Worker()
    worker.submit(time.sleep, 3600)
    with pytest.raises(WorkerEnded):
        worker.result(0.1)
    worker.end()
    assert not worker.is_running


@posix
@pytest.mark.parametrize(
    "content",
    [struct.pack("!i", 9) + b"no pickle", struct.pack("!iQ", -1, 1 << 40)],
    ids=["no pickle", "a terabyte"],
)
def test_what_a_crashing_worker_sends_is_no_answer(content):
    worker = Worker()
    worker.submit(answer_with, content)
    with pytest.raises(WorkerEnded):
        worker.result()
    worker.end()


def test_the_limit_of_a_call_does_not_run_while_its_answer_is_sent():
    """The parent may be slow to read it: the worker has done its work in time."""
    worker = Worker()
    for call in ((note_limits,), (twice, 2), (twice, 3), (sent_within_limit,)):
        worker.submit(*call, limit_s=600)
    assert [worker.result() for _ in range(4)] == [None, 4, 6, [False] * 3]
    worker.end()


def test_a_cluster_without_workers(empty_cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(ways, "CONNECT_S", 120.0)
    monkeypatch.setattr(ways, "WORKERS_S", 0.5)
    with pytest.raises(
        ConnectionError,
        match=r"has no workers: start some, with one thread each: dask worker tcp://",
    ):
        list(
            run_on_dask(record_of, make_tasks(tmp_path / "set", ["00"]), empty_cluster, lost_record)
        )


def test_an_address_where_no_scheduler_answers(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs Dask (extra `cluster`)")
    monkeypatch.setattr(ways, "CONNECT_S", 0.5)
    tasks = make_tasks(tmp_path / "set", ["00"])
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        for address in ("nowhere", "tcp://a:b", f"tcp://127.0.0.1:{server.getsockname()[1]}"):
            expected = f"no Dask scheduler answers at '{address}'; expected the address that"
            with pytest.raises(ConnectionError, match=f"{expected} `dask scheduler`"):
                list(run_on_dask(record_of, tasks, address, lost_record))
            assert logging.root.manager.disable == logging.NOTSET  # as it was before
