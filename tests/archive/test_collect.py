"""`collect_to_file`: one record a recording, and the same file whatever happened on the way."""

import json
import os
import stat
from dataclasses import replace

import pytest
from archive.made_work import JOB, make_tasks, record_of
from hypothesis import given, settings
from hypothesis import strategies as st

from async_tnt.archive import parquet
from async_tnt.archive.collect import Progress, collect, collect_to_file
from async_tnt.archive.executor import executor_of
from async_tnt.archive.job import Job
from async_tnt.archive.records import failed
from async_tnt.archive.results import lines_path

NAMES = ["b", "a", "ccc", "dd", "a-b"]
SERIAL = executor_of()
FILES = ["r.jsonl", pytest.param("r.parquet", marks=pytest.mark.needs_pyarrow)]


class Stopped(BaseException):
    """Like Ctrl-C, or a kill: what is written stays as it is."""


def stopping_after(n):
    """Stops collecting after n records."""
    n_calls = iter(range(n + 1))

    def watch():
        if next(n_calls) == n:
            raise Stopped

    return watch


def collected_to(out, tasks, function=record_of, executor=SERIAL, **words):
    """The records, and what was counted."""
    progress = Progress()
    return list(collect_to_file(function, tasks, executor, out, progress, **words)), progress


def noting(done):
    def function(task):
        done.append(task.recording)
        return record_of(task)

    return function


def is_alone(out):
    """Without lines beside it."""
    return lines_path(out) == out or not lines_path(out).exists()


def without_seconds(records):
    return [{name: value for name, value in record.items() if name != "seconds"} for record in records]


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("n", [2, 5])
def test_interrupted_and_resumed_the_same_file_comes_of_it(executor, name, n, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    plain, out = tmp_path / f"plain_{name}", tmp_path / name
    records, _ = collected_to(plain, tasks)
    assert [record["recording"] for record in records] == sorted(NAMES)
    with pytest.raises(Stopped):
        collected_to(out, tasks, executor=executor, watch=stopping_after(n))
    assert lines_path(out).exists() == (n > 0)
    resumed, progress = collected_to(out, tasks[::-1], executor=executor)
    assert (progress.kept, progress.done) == (n, len(NAMES) - n)
    assert out.read_bytes() == plain.read_bytes() and sum(path.is_file() for path in tmp_path.iterdir()) == 2
    assert without_seconds(resumed) == without_seconds(records)
    assert sum(record["seconds"] is not None for record in resumed) == progress.done


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=30)
@given(
    order=st.permutations(NAMES),
    stops=st.lists(st.integers(0, len(NAMES)), max_size=3),
    torn=st.integers(0, 400),
)
def test_orders_stops_and_torn_ends_give_the_same_file(tmp_path_factory, name, order, stops, torn):
    folder = tmp_path_factory.mktemp("any")
    tasks = make_tasks(folder / "set", order)
    collected_to(folder / f"plain_{name}", sorted(tasks, key=lambda task: task.recording))
    out = folder / name
    for n in stops:
        try:
            collected_to(out, tasks, watch=stopping_after(n))
        except Stopped:
            if lines_path(out).exists():
                content = lines_path(out).read_bytes()
                lines_path(out).write_bytes(content[: max(0, len(content) - torn)])
    collected_to(out, tasks)
    assert out.read_bytes() == (folder / f"plain_{name}").read_bytes()


@pytest.mark.needs_pyarrow
def test_a_kill_between_the_parquet_file_and_the_end_of_its_lines_changes_nothing(tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / "r.parquet"
    with pytest.raises(Stopped):
        collected_to(out, tasks, watch=stopping_after(4))
    lines = lines_path(out).read_bytes()
    collected_to(out, tasks)
    whole = out.read_bytes()
    lines_path(out).write_bytes(lines)
    _, progress = collected_to(out, tasks)
    assert out.read_bytes() == whole and is_alone(out)
    assert (progress.kept, progress.done) == (len(NAMES), 0)


@pytest.mark.parametrize("name", FILES)
def test_done_is_done(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes(), out.stat().st_mtime_ns
    records, progress = collected_to(out, tasks, lambda task: pytest.fail("done twice"))
    assert (progress.kept, progress.done, len(records)) == (len(NAMES), 0, len(NAMES))
    assert (out.read_bytes(), out.stat().st_mtime_ns) == before and is_alone(out)


@pytest.mark.parametrize("name", FILES)
def test_new_and_changed_recordings_are_done_and_no_others(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    (tmp_path / "set" / "dd").write_text("longer")
    os.utime(tmp_path / "set" / "a", ns=(1, 10**18))
    tasks = make_tasks(tmp_path / "set", [*NAMES, "new"])
    done = []
    records, progress = collected_to(out, tasks, noting(done))
    assert sorted(done) == ["a", "dd", "new"]
    assert progress.kept == len(NAMES) - 2
    assert {r["recording"]: r["label"] for r in records} == {**{n: n for n in [*NAMES, "new"]}, "dd": "longer"}
    collected_to(tmp_path / f"fresh_{name}", tasks)
    assert out.read_bytes() == (tmp_path / f"fresh_{name}").read_bytes()


def test_recordings_with_an_error_are_tried_again(tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / "r.jsonl"
    records, _ = collected_to(out, tasks, lambda t: failed(t, "torn") if t.recording == "dd" else record_of(t))
    assert [r["error"] for r in records if r["recording"] == "dd"] == ["torn"]
    done = []
    records, _ = collected_to(out, tasks, noting(done))
    assert done == ["dd"] and all(record["error"] is None for record in records)


@pytest.mark.parametrize("name", FILES)
def test_a_recording_that_is_gone_leaves_the_result_and_one_that_is_there_does_not(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes()
    with pytest.raises(ValueError, match=r"holds 2 recordings that this command does not name, such as a"):
        collected_to(out, tasks[2:], is_gone=lambda name: False)
    assert out.read_bytes() == before and is_alone(out)
    records, progress = collected_to(out, tasks[2:], is_gone=lambda name: True)
    assert progress.gone == 2 and [r["recording"] for r in records] == sorted(NAMES[2:])


@pytest.mark.parametrize("name", FILES)
def test_other_settings_are_refused_without_restart(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    other = make_tasks(tmp_path / "set", NAMES, Job("run", "digits", "compiled", {"every_us": 1}, "b" * 64))
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes()
    names = r"made with every_us 5000 \(now 1\), model_sha256 a{24} \(now b{24}\)"
    no_names = r"made with another model, .* or selection of pixels, settings \w{12} \(now \w{12}\)"
    with pytest.raises(ValueError, match=f"was {names if 'parquet' in name else no_names}: give the same again"):
        collected_to(out, other)
    assert out.read_bytes() == before and is_alone(out)
    collected_to(out, tasks)
    _, progress = collected_to(out, other, restart=True)
    assert progress.done == len(NAMES) and out.read_bytes() != before


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_files_of_others_stay(name, restart, tmp_path):
    out = tmp_path / name
    out.write_bytes(b"my notes\nof years\n")
    with pytest.raises(ValueError, match=r"is not a result of async-tnt.*: move it away"):
        collected_to(out, make_tasks(tmp_path / "set", NAMES), restart=restart)
    assert out.read_bytes() == b"my notes\nof years\n" and is_alone(out)


@pytest.mark.parametrize("name", FILES)
def test_a_result_of_other_recordings_only_is_not_discarded(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes()
    others = {
        "other names": make_tasks(tmp_path / "other", ["x", "y"]),
        "the same names": [replace(task, modified_ns=1) for task in tasks],
        "one name": [replace(tasks[0], modified_ns=1)],
    }
    for why, theirs in others.items():
        with pytest.raises(ValueError, match="holds 5 results, none of a recording as it is here: of another"):
            collected_to(out, theirs)
        assert out.read_bytes() == before and is_alone(out), why
    unfinished = tmp_path / f"unfinished_{name}"
    with pytest.raises(Stopped):
        collected_to(unfinished, tasks, watch=stopping_after(3))
    for why, theirs in others.items():
        with pytest.raises(ValueError, match="none of a recording as it is here: of another"):
            collected_to(unfinished, [replace(task, modified_ns=1) for task in theirs])
        assert lines_path(unfinished).read_bytes().count(b"\n") == 3, why
    collected_to(unfinished, theirs, restart=True)


def test_errors_are_nothing_to_lose(tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    collected_to(tmp_path / "r.jsonl", tasks, lambda task: failed(task, "torn"))
    _, progress = collected_to(tmp_path / "r.jsonl", make_tasks(tmp_path / "other", ["x"]))
    assert (progress.done, progress.gone) == (1, 5)


@pytest.mark.skipif(os.name == "nt", reason="modes and links of POSIX")
@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_links_and_modes_stay(name, restart, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    (tmp_path / "far").mkdir()
    real, link = tmp_path / "far" / f"real_{name}", tmp_path / name
    link.symlink_to(real)  # to nothing yet
    collected_to(link, tasks[:3])
    assert link.is_symlink() and real.exists()
    new = tmp_path / "new"
    new.touch()
    assert real.stat().st_mode == new.stat().st_mode
    real.chmod(0o600)
    with pytest.raises(Stopped):
        collected_to(link, tasks, watch=stopping_after(1), restart=restart)
    assert stat.S_IMODE(lines_path(link).stat().st_mode) == 0o600
    collected_to(link, tasks)
    assert link.is_symlink() and stat.S_IMODE(real.stat().st_mode) == 0o600
    assert sorted(path.name for path in tmp_path.rglob("*real*")) == [real.name]


def test_in_memory(tmp_path):
    progress = Progress()
    records = collect(record_of, make_tasks(tmp_path / "set", NAMES), SERIAL, progress)
    assert [record["recording"] for record in records] == sorted(NAMES) and progress.done == len(NAMES)


@pytest.mark.needs_pyarrow
def test_parquet_has_row_groups_and_its_settings(tmp_path, monkeypatch):
    import pyarrow.parquet

    monkeypatch.setattr(parquet, "GROUP_ITEMS", 3)
    tasks = make_tasks(tmp_path / "set", NAMES)
    records, _ = collected_to(tmp_path / "r.parquet", tasks)
    file = pyarrow.parquet.ParquetFile(tmp_path / "r.parquet")
    assert file.num_row_groups > 1
    assert json.loads(file.schema_arrow.metadata[b"async_tnt"])["about"] == JOB.metadata
    assert file.read().to_pylist() == without_seconds(records)
