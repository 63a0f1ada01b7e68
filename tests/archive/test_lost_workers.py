"""`run_all` where workers are lost: every task is answered once, and what cannot be done is said."""

import os
import signal
import threading
import time

import pytest
from archive.made_work import OnlyHere, deadly, double, ends, make_tasks, slow, unsendable

from async_tnt.archive.records import lost
from async_tnt.workers import run_all

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kill -9 is a matter of POSIX")


def test_a_task_that_ends_two_workers_is_given_up_and_the_others_are_done_once(tmp_path):
    names = [*"abcdefg", "once", "poison", *"hijk"]
    tasks = make_tasks(tmp_path / "set", names)
    records = list(run_all(deadly, tasks, 2, lost=lost))
    assert sorted(record["recording"] for record in records) == sorted(names)
    errors = {record["recording"]: record["error"] for record in records if record["error"] is not None}
    assert errors.keys() == {"poison"} and "its worker ended, twice" in errors["poison"]
    assert (tmp_path / "set" / "tries").read_text() == ".."


def test_without_lost_the_second_time_is_an_error():
    with pytest.raises(ChildProcessError, match=r"a worker process ended without an answer \(exit code 3\)"):
        list(run_all(ends, [1, -1, 2, 3], 2))


def test_all_tasks_may_end_their_workers():
    assert sorted(run_all(ends, [-1, -2, -3], 2, lost=abs)) == [1, 2, 3]


def test_an_answer_that_cannot_be_sent_is_an_error():
    with pytest.raises(TypeError, match="a worker's answer cannot be sent"):
        list(run_all(unsendable, [1, 2], 2))


def test_more_workers_than_tasks_and_many_tasks():
    assert sorted(run_all(double, [4, 5], 4)) == [8, 10]
    assert sorted(run_all(double, range(500), 3)) == [2 * n for n in range(500)]


def test_large_tasks_and_results_do_not_wait_for_each_other():
    megabyte = b"x" * (1 << 20)
    assert sum(len(twice) for twice in run_all(double, [megabyte] * 40, 2)) == 80 << 20


def test_a_task_that_the_worker_cannot_read_is_an_error():
    with pytest.raises(ValueError, match="only here"):
        list(run_all(double, [OnlyHere(), OnlyHere()], 2))


def test_a_worker_killed_from_outside_is_replaced(tmp_path):
    tasks = make_tasks(tmp_path / "set", [f"{k:02d}" for k in range(60)])
    pids = tmp_path / "set" / "pids"
    killed = []

    def kill():
        while not pids.exists() or len(pids.read_text().splitlines()) < 10:
            time.sleep(0.005)
        killed.append(int(pids.read_text().split()[0]))
        os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    records = list(run_all(slow, tasks, 2, lost=lost))
    killer.join()
    assert sorted(record["recording"] for record in records) == [task.recording for task in tasks]
    assert all(record["error"] is None for record in records)
    begun = [line.split()[1] for line in pids.read_text().splitlines()]
    assert len(begun) in (60, 61)  # the task that was lost, if there was one, again; no other
    workers = [int(line.split()[0]) for line in pids.read_text().splitlines()]
    assert len(set(workers)) in (2, 3)  # on a busy machine the other one may be done before the new one has begun
    assert workers.count(killed[0]) < 30


def test_closing_ends_the_workers(tmp_path):
    tasks = make_tasks(tmp_path / "set", [f"{k:02d}" for k in range(500)])
    results = run_all(slow, tasks, 2)
    next(results)
    results.close()
    for pid in {int(line.split()[0]) for line in (tmp_path / "set" / "pids").read_text().splitlines()}:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
