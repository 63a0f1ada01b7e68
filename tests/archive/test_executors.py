"""Every executor: each task is done once, lost workers are replaced, and workers end with the program."""

import contextlib
import os
from pathlib import Path

import pytest
from archive.made_work import broken, deadly, make_tasks, record_of
from archive.simple_work import raise_odd, sleep_or_end, twice, unpicklable
from processes import started
from waiting import until

from async_tnt.archive.executor import run_all
from async_tnt.archive.records import lost

posix = pytest.mark.skipif(os.name != "posix", reason="kill -9 of POSIX")
replacing_workers = pytest.mark.parametrize("executor", ["processes", "dask"], indirect=True)
NAMES = [f"{k:02d}" for k in range(40)]


def test_every_task_is_done_once(executor, tmp_path):
    records = list(executor.run(record_of, make_tasks(tmp_path / "set", NAMES), lost))
    assert sorted(record["label"] for record in records) == NAMES


def test_an_error_of_a_task_is_raised(executor, tmp_path):
    with pytest.raises(ImportError, match="no reader of that"):
        list(executor.run(broken, make_tasks(tmp_path / "set", NAMES), lost))


@posix
@replacing_workers
def test_a_task_that_ends_its_workers_is_lost_and_the_others_are_done_once(executor, tmp_path, request):
    names = [*NAMES[:10], "once", "poison", *NAMES[10:20]]
    records = list(executor.run(deadly, make_tasks(tmp_path / "set", names), lost))
    assert sorted(record["recording"] for record in records) == sorted(names)
    errors = {record["recording"]: record["error"] for record in records if record["error"] is not None}
    assert errors.keys() == {"poison"} and "its worker ended, twice" in errors["poison"]
    if "processes" in request.node.name:  # tasks queued behind a lost one are begun once; Dask may repeat a chunk
        begun = (tmp_path / "set" / "begun").read_text().split()
        assert sorted(begun) == sorted([*names, "once", "poison"])


def test_more_workers_than_tasks_and_large_results():
    assert sorted(run_all(twice, [4, 5], 4)) == [8, 10] and list(run_all(twice, [], 2)) == []
    assert sum(len(result) for result in run_all(twice, [b"x" * (1 << 20)] * 40, 2)) == 80 << 20


def test_what_cannot_be_pickled_is_an_error():
    with pytest.raises(Exception, match="pickle"):
        list(run_all(unpicklable, [1, 2], 2))
    with pytest.raises(RuntimeError, match="OddError: 7, not 0") as raised:
        list(run_all(raise_odd, [7, 7], 2))
    assert "in raise_odd" in str(raised.value.__cause__)  # the worker's traceback


def test_a_script_without_a_main_guard_gets_an_explanation(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("from async_tnt.archive.executor import run_all\nlist(run_all(abs, [1, 2, 3], 2))\n")
    with started(script) as process:
        assert "from a script without the line `if __name__" in process.communicate()[1]


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
    with started("-c", f"from archive.simple_work import run_sleepers; run_sleepers({str(tmp_path)!r})") as process:
        until(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
        pids = [int(path.stem) for path in tmp_path.glob("*.pid")]
        assert all(is_running(pid) for pid in pids)
        process.kill()
        until(lambda: not any(is_running(pid) for pid in pids))
