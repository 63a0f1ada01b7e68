"""`run_all` where workers are lost: every task is answered once, and what cannot be done is said."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from archive.made_work import OnlyHere, Unreadable, deadly, double, ends, make_tasks, odd, slow, unreadable, unsendable

from async_tnt.archive.records import lost
from async_tnt.archive.workers import _sent, run_all

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


@pytest.mark.parametrize("error", [EOFError("torn"), OSError("torn"), ValueError("torn")])
def test_what_cannot_be_unpickled_is_an_error_and_no_lost_worker(error):
    with pytest.raises(TypeError, match=rf"a worker's answer cannot be read: {type(error).__name__}: torn"):
        list(run_all(unreadable, [error] * 5, 2, lost=lambda task: pytest.fail("lost")))
    with pytest.raises(type(error), match="torn"):
        list(run_all(double, [Unreadable(error)] * 3, 2, lost=lambda task: pytest.fail("lost")))


def test_an_error_that_cannot_be_unpickled_is_told_by_another():
    with pytest.raises(RuntimeError, match="Odd: 7, not 0") as raised:
        list(run_all(odd, [7, 7], 2))
    assert "in odd" in raised.value.__notes__[0]  # where it was


def _start(code):
    here = Path(__file__).resolve().parents[2]
    paths = os.pathsep.join(str(here / name) for name in ("", "reference", "tests"))
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def _wait(until, what, timeout_s=60):
    end = time.monotonic() + timeout_s
    while not until():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def _is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    try:  # where nobody asks for its exit code it stays as a zombie
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return not Path("/proc").is_dir()


def test_killing_the_program_ends_its_workers_in_the_middle_of_their_tasks(tmp_path):
    process = _start(f"from archive.made_work import longs; longs({str(tmp_path)!r})")
    pids = []
    try:
        _wait(lambda: len(list(tmp_path.glob("*.pid"))) == 2, "the workers have not begun")
        pids += [int(path.stem) for path in tmp_path.glob("*.pid")]
        assert all(_is_running(pid) for pid in pids)
        process.kill()
        process.wait()
        _wait(lambda: not any(_is_running(pid) for pid in pids), "workers outlive the program", timeout_s=10)
    finally:
        process.kill()
        for pid in filter(_is_running, pids):
            os.kill(pid, signal.SIGKILL)
        process.communicate()


def test_killing_the_program_leaves_no_traceback_of_its_workers():
    for _ in range(3):
        process = _start("from archive.made_work import shorts; shorts()")
        process.stdout.read(50)
        process.kill()
        assert process.communicate(timeout=30)[1] == b""


def test_workers_whose_parent_is_gone_say_nothing():
    ours, theirs = multiprocessing.Pipe()
    ours.close()
    assert not _sent(theirs, ("result", 3))


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
