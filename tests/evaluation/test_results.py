"""The result file has one record for each recording.

It is the same file whatever happened on the way to it.
"""

import fcntl
import os
from contextlib import closing
from dataclasses import replace
from functools import partial

import pytest
from evaluation.made_work import JOB, make_tasks, record_of
from hypothesis import given, settings
from hypothesis import strategies as st

from async_tnt.base.progress import Bar
from async_tnt.evaluation.processes import run_all
from async_tnt.evaluation.results import ResultFile, collect
from async_tnt.sources.pixels.pixels import Pixels

HERE = partial(run_all, workers=1)
NAMES = ["b", "a", "ccc", "dd", "a-b"]


class Stopped(BaseException):
    """Like Ctrl-C, or a kill: what is written stays as it is."""


def stopping_after(n):
    """A bar that stops collecting after n records."""

    class StoppingBar(Bar):
        def __enter__(self):
            self.left = n + 1
            self.update(0)
            return self

        def update(self, n=1, title=None):
            self.left -= 1
            if self.left == 0:
                raise Stopped

    return StoppingBar


def collected_to(out, tasks, function=record_of, run=HERE, progress=Bar, **words):
    """The records, how many of them were kept, and what was reported."""
    kept = []
    said = []

    def noted(total, title, *, done):
        kept.append(done)
        return progress(total, title, done=done)

    records = collect(function, tasks, run, out, progress=noted, report=said.append, **words)
    return records, *kept, said


def noting(done):
    def function(task):
        done.append(task.recording)
        return record_of(task)

    return function


@pytest.fixture
def tasks(tmp_path):
    return make_tasks(tmp_path / "set", NAMES)


@pytest.fixture
def finished(tasks, tmp_path):
    """A result of all tasks."""
    collected_to(tmp_path / "r.jsonl", tasks)
    return tmp_path / "r.jsonl"


@pytest.fixture
def unfinished(tmp_path):
    """A result of three recordings that was interrupted; one of them, b, has two lines."""
    with closing(ResultFile(tmp_path / "r.jsonl", JOB)) as file:
        for late, task in enumerate(make_tasks(tmp_path / "set", ["b", "a", "ccc", "b"])):
            file.append(record_of(task) | {"late": late})
    return tmp_path / "r.jsonl"


def test_interrupted_in_any_way_to_run_it_resumes_to_the_same_file(run, tasks, tmp_path):
    plain = tmp_path / "plain.jsonl"
    out = tmp_path / "r.jsonl"
    records, *_ = collected_to(plain, tasks)
    with pytest.raises(Stopped):
        collected_to(out, tasks, run=run, progress=stopping_after(2))
    resumed, kept, said = collected_to(out, tasks[::-1], run=run)
    assert kept == 2 and said == [f"{out}: 2 of 5 recordings are done, resuming"]
    assert out.read_bytes() == plain.read_bytes()
    assert sum(path.is_file() for path in tmp_path.iterdir()) == 2
    assert resumed == records


@settings(max_examples=20)
@given(
    order=st.permutations(NAMES),
    stops=st.lists(st.integers(0, 5), max_size=3),
    torn=st.integers(0, 400),
)
def test_orders_stops_and_torn_ends_give_the_same_file(tmp_path_factory, order, stops, torn):
    folder = tmp_path_factory.mktemp("any")
    tasks = make_tasks(folder / "set", order)
    collected_to(folder / "plain.jsonl", sorted(tasks, key=lambda task: task.recording))
    out = folder / "r.jsonl"
    for n in stops:
        try:
            collected_to(out, tasks, progress=stopping_after(n))
        except Stopped:
            if out.exists():
                out.write_bytes(out.read_bytes()[:-torn] if torn else out.read_bytes())
    collected_to(out, tasks)
    assert out.read_bytes() == (folder / "plain.jsonl").read_bytes()


def test_new_and_changed_recordings_are_done_and_no_others(finished, tmp_path):
    (tmp_path / "set" / "dd").write_text("longer")
    os.utime(tmp_path / "set" / "a", ns=(1, 10**18))
    tasks = make_tasks(tmp_path / "set", [*NAMES, "new"])
    done = []
    records, kept, _ = collected_to(finished, tasks, noting(done))
    assert sorted(done) == ["a", "dd", "new"] and kept == len(NAMES) - 2
    assert {r["recording"]: r["label"] for r in records} == {
        **{n: n for n in [*NAMES, "new"]},
        "dd": "longer",
    }
    fresh = finished.with_stem("fresh")
    collected_to(fresh, tasks)
    assert finished.read_bytes() == fresh.read_bytes()


@pytest.mark.parametrize(
    "change", [{"bytes": 7}, {"modified_ns": 7}, {"label": "another class"}], ids=str
)
def test_a_recording_of_another_size_time_or_class_is_done_again_and_no_other(
    finished, tasks, change
):
    done = []
    tasks[1] = replace(tasks[1], **change)
    records, kept, _ = collected_to(finished, tasks, noting(done))
    assert done == [NAMES[1]] and kept == len(NAMES) - 1
    changed = next(record for record in records if record["recording"] == NAMES[1])
    assert change.get("label") == changed["class"]
    # once more: nothing is done, said or written
    before = finished.stat()
    _, kept, said = collected_to(finished, tasks, noting(done))
    assert (kept, said, len(done)) == (len(NAMES), [], 1)
    assert (finished.stat().st_ino, finished.stat().st_mtime_ns) == (
        before.st_ino,
        before.st_mtime_ns,
    )


@pytest.mark.parametrize(
    "changes",
    [{"version": "0.1"}, {"model_sha256": "b" * 64}, {"pixels": Pixels(roi=(0, 0, 9, 9))}],
    ids=["version", "model", "pixels"],
)
def test_results_of_another_version_model_or_selection_of_pixels_are_refused(
    finished, tmp_path, changes
):
    theirs = make_tasks(tmp_path / "set", NAMES, replace(JOB, **changes))
    with pytest.raises(
        ValueError, match="was made with another model, version or selection of pixels"
    ):
        collected_to(finished, theirs)
    finished.unlink()
    assert len(collected_to(finished, theirs)[0]) == len(NAMES)


def test_results_of_recordings_that_are_gone_are_left_out_and_no_others(finished, tasks):
    records, _, said = collected_to(finished, tasks[2:])
    assert said == [f"{finished}: recordings that no longer exist are left out (2)"]
    assert [r["recording"] for r in records] == sorted(NAMES[2:])


def test_a_result_of_other_recordings_only_is_not_discarded(finished, tasks, tmp_path):
    unfinished = finished.with_stem("unfinished")
    with pytest.raises(Stopped):
        collected_to(unfinished, tasks, progress=stopping_after(3))
    for theirs in (
        make_tasks(tmp_path / "other", ["x", "y"]),
        [replace(task, modified_ns=1) for task in tasks],
    ):
        for out, n in (finished, 5), (unfinished, 3):
            before = out.read_bytes()
            with pytest.raises(
                ValueError, match=rf"holds results \({n}\), but none of a recording as it is"
            ):
                collected_to(out, theirs)
            assert out.read_bytes() == before


@pytest.mark.parametrize(
    "line", [b"[" * 100_000, b'{"recording": 3}', b"9" * 5000, b'{"recording": "x"}', b"\xff", b""]
)
def test_a_damaged_line_is_refused_and_files_of_others_stay(line, unfinished):
    lines = unfinished.read_bytes().splitlines(keepends=True)
    for content in (b"".join([*lines[:2], line + b"\n", *lines[2:]]), b"x" + line):
        unfinished.write_bytes(content)
        with pytest.raises(
            ValueError, match=r"is not a result of async-tnt(, or is damaged)?: move it away"
        ):
            ResultFile(unfinished, JOB)
        assert unfinished.read_bytes() == content


@pytest.mark.parametrize("is_there", [False, True])
def test_a_file_without_records_is_removed_only_where_it_was_created(tmp_path, is_there):
    out = tmp_path / "r.jsonl"
    if is_there:
        out.touch()
    ResultFile(out, JOB).close()
    assert out.exists() == is_there


def test_two_programs_at_once_are_refused(unfinished):
    with (
        closing(ResultFile(unfinished, JOB)),
        pytest.raises(OSError, match=r"r\.\w+: another program is writing it"),
    ):
        ResultFile(unfinished, JOB)
    ResultFile(unfinished, JOB).close()


def test_a_file_that_goes_before_it_is_locked_is_not_written(unfinished, monkeypatch):
    """Opened, then locked: in between the program that had locked it may have finished."""
    lock = fcntl.flock
    before = unfinished.read_bytes()

    def lock_late(file, how):
        unfinished.rename(unfinished.with_name("gone"))
        unfinished.touch()
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    with pytest.raises(BlockingIOError, match="another program is writing it"):
        ResultFile(unfinished, JOB)
    assert unfinished.read_bytes() == b"" and unfinished.with_name("gone").read_bytes() == before
