"""`collect_to_file`: one record a recording, and the same bytes whatever happened on the way."""

import json
import os
import stat
from dataclasses import replace

import pytest
from archive.made_work import JOB, deadly, make_tasks, record_of
from hypothesis import given, settings
from hypothesis import strategies as st

from async_tnt.archive.collect import Collected, collect, collect_to_file, journal_of
from async_tnt.archive.executor import Place
from async_tnt.archive.job import Job
from async_tnt.archive.records import failed

NAMES = ["b", "a", "ccc", "dd", "a-b"]
HERE = Place()
FILES = ["r.jsonl", pytest.param("r.parquet", marks=pytest.mark.needs_pyarrow)]


class Stopped(BaseException):
    """As Ctrl-C, or a kill that leaves the journal as it is."""


def stopping_after(n):
    done = []

    def function(task):
        if len(done) == n:
            raise Stopped
        done.append(task.recording)
        return record_of(task)

    return function


def collected_to(out, tasks, function=record_of, place=HERE, **words):
    """The records, and what was counted."""
    counts = Collected()
    return list(collect_to_file(function, tasks, place, out, counts, **words)), counts


def names_of(done):
    def function(task):
        done.append(task.recording)
        return record_of(task)

    return function


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("n", range(len(NAMES) + 1))
def test_stopped_anywhere_the_same_bytes_come_of_it(name, n, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    plain, stopped = tmp_path / f"plain_{name}", tmp_path / name
    records, _ = collected_to(plain, tasks)
    assert [record["recording"] for record in records] == sorted(NAMES)
    if n < len(NAMES):
        with pytest.raises(Stopped):
            collected_to(stopped, tasks, stopping_after(n))
        assert not stopped.exists() and journal_of(stopped).exists() == (n > 0)
    done = []
    again, counts = collected_to(stopped, tasks[::-1], names_of(done))
    kept = n if n < len(NAMES) else 0
    assert (counts.kept, counts.done) == (kept, len(NAMES) - kept) and len(done) == len(NAMES) - kept
    assert stopped.read_bytes() == plain.read_bytes() and not journal_of(stopped).exists()
    without = [{k: v for k, v in record.items() if k != "seconds"} for record in again]
    assert without == [{k: v for k, v in record.items() if k != "seconds"} for record in records]
    assert all(record["seconds"] is not None for record in again)


@pytest.mark.parametrize("name", FILES)
def test_done_is_done(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes(), out.stat().st_mtime_ns
    records, counts = collected_to(out, tasks, lambda task: pytest.fail("done twice"))
    assert (counts.kept, counts.done, len(records)) == (len(NAMES), 0, len(NAMES))
    assert (out.read_bytes(), out.stat().st_mtime_ns) == before and not journal_of(out).exists()


@pytest.mark.parametrize("name", FILES)
def test_new_and_changed_recordings_are_done_and_no_others(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    (tmp_path / "set" / "dd").write_text("longer")
    os.utime(tmp_path / "set" / "a", ns=(1, 10**18))
    tasks = make_tasks(tmp_path / "set", [*NAMES, "new"])
    done = []
    records, counts = collected_to(out, tasks, names_of(done))
    assert sorted(done) == ["a", "dd", "new"]
    assert counts.kept == len(NAMES) - 2
    assert {r["recording"]: r["label"] for r in records} == {**{n: n for n in [*NAMES, "new"]}, "dd": "longer"}
    collected_to(tmp_path / f"fresh_{name}", tasks)
    assert out.read_bytes() == (tmp_path / f"fresh_{name}").read_bytes()


def test_recordings_with_an_error_are_tried_again(tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / "r.jsonl"
    records, _ = collected_to(out, tasks, lambda t: failed(t, "torn") if t.recording == "dd" else record_of(t))
    assert [r["error"] for r in records if r["recording"] == "dd"] == ["torn"]
    done = []
    records, _ = collected_to(out, tasks, names_of(done))
    assert done == ["dd"] and all(record["error"] is None for record in records)


@pytest.mark.parametrize("name", FILES)
def test_a_recording_that_is_gone_leaves_the_result_and_one_that_is_there_does_not(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes()
    with pytest.raises(ValueError, match=r"holds 2 recordings that this command does not name, such as a"):
        collected_to(out, tasks[2:], gone=lambda name: False)
    assert out.read_bytes() == before and not journal_of(out).exists()
    records, counts = collected_to(out, tasks[2:], gone=lambda name: True)
    assert counts.gone == 2 and [r["recording"] for r in records] == sorted(NAMES[2:])


@pytest.mark.parametrize("name", FILES)
def test_other_settings_are_refused_unless_all_is_thrown_away(name, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    other = make_tasks(tmp_path / "set", NAMES, Job("run", "digits", "compiled", {"every_us": 1}, "b" * 64))
    out = tmp_path / name
    collected_to(out, tasks)
    before = out.read_bytes()
    names = r"begun with --every-us 5000 \(now 1\), another model"
    no_names = r"made by another model, .* or selection of pixels, settings \w{12} \(now \w{12}\)"
    with pytest.raises(ValueError, match=f"was ({names if 'parquet' in name else no_names}): give the same again"):
        collected_to(out, other)
    assert out.read_bytes() == before and not journal_of(out).exists()
    collected_to(out, tasks)  # the refused one has left nothing in the way
    _, counts = collected_to(out, other, restart=True)
    assert counts.done == len(NAMES) and out.read_bytes() != before


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_other_peoples_files_stay(name, restart, tmp_path):
    out = tmp_path / name
    out.write_bytes(b"my notes\nof years\n")
    with pytest.raises(ValueError, match=r"no (result of async-tnt|readable Parquet file).* move it away"):
        collected_to(out, make_tasks(tmp_path / "set", NAMES), restart=restart)
    assert out.read_bytes() == b"my notes\nof years\n" and not journal_of(out).exists()


def test_a_poisoned_recording_is_an_error_and_the_others_are_there_once(tmp_path):
    tasks = make_tasks(tmp_path / "set", [*NAMES, "once", "poison"])
    records, _ = collected_to(tmp_path / "r.jsonl", tasks, deadly, Place(2))
    assert [r["recording"] for r in records] == sorted([*NAMES, "once", "poison"])
    assert [r["recording"] for r in records if r["error"]] == ["poison"]
    lines = (tmp_path / "r.jsonl").read_text().splitlines()
    assert len(lines) == len(NAMES) + 2 and all("seconds" not in json.loads(line) for line in lines)


@settings(max_examples=30, deadline=None)
@given(st.permutations(NAMES), st.lists(st.integers(0, len(NAMES)), max_size=3), st.integers(0, 400))
def test_orders_stops_and_torn_ends_give_the_same_bytes(tmp_path_factory, order, stops, torn):
    folder = tmp_path_factory.mktemp("any")
    collected_to(folder / "plain.jsonl", make_tasks(folder / "set", NAMES))
    tasks = make_tasks(folder / "set", order)
    out = folder / "r.jsonl"
    for n in stops:
        try:
            collected_to(out, tasks, stopping_after(n))
        except Stopped:
            if journal_of(out).exists():
                content = journal_of(out).read_bytes()
                journal_of(out).write_bytes(content[: max(0, len(content) - torn)])
    collected_to(out, tasks)
    assert out.read_bytes() == (folder / "plain.jsonl").read_bytes()


def test_a_kill_between_the_file_and_the_end_of_its_journal_changes_nothing(tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    out = tmp_path / "r.jsonl"
    with pytest.raises(Stopped):
        collected_to(out, tasks, stopping_after(4))
    journal = journal_of(out).read_bytes()
    collected_to(out, tasks)
    whole = out.read_bytes()
    journal_of(out).write_bytes(journal)
    _, counts = collected_to(out, tasks)
    assert out.read_bytes() == whole and not journal_of(out).exists()
    assert (counts.kept, counts.done) == (len(NAMES), 0)


@pytest.mark.parametrize("name", FILES)
def test_a_result_of_which_nothing_is_as_it_was_is_not_thrown_away(name, tmp_path):
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
        with pytest.raises(ValueError, match="holds 5 results, none of a recording as it is here: anoth"):
            collected_to(out, theirs)
        assert out.read_bytes() == before and not journal_of(out).exists(), why
        with pytest.raises(Stopped):
            collected_to(tmp_path / f"s_{name}", tasks, stopping_after(3))
        with pytest.raises(ValueError, match="holds 3 results, none of a recording as it is here: anoth"):
            collected_to(tmp_path / f"s_{name}", theirs)
        assert journal_of(tmp_path / f"s_{name}").read_bytes().count(b"\n") == 4, why
        collected_to(tmp_path / f"s_{name}", theirs, restart=True)
        (tmp_path / f"s_{name}").unlink()


def test_errors_are_nothing_to_lose(tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    collected_to(tmp_path / "r.jsonl", tasks, lambda task: failed(task, "torn"))
    _, counts = collected_to(tmp_path / "r.jsonl", make_tasks(tmp_path / "other", ["x"]))
    assert (counts.done, counts.gone) == (1, 5)


@pytest.mark.skipif(os.name == "nt", reason="modes and links of POSIX")
@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("name", FILES)
def test_links_and_modes_stay(name, restart, tmp_path):
    tasks = make_tasks(tmp_path / "set", NAMES)
    (tmp_path / "far").mkdir()
    real, link = tmp_path / "far" / f"real_{name}", tmp_path / name
    link.symlink_to(real)  # to nothing yet
    collected_to(link, tasks[:3])
    assert link.is_symlink() and real.exists() and journal_of(link).parent == real.parent
    new = tmp_path / "new"
    new.touch()
    assert real.stat().st_mode == new.stat().st_mode
    real.chmod(0o600)
    modes = []

    def stopped(task):
        modes.append(stat.S_IMODE(journal_of(link).stat().st_mode))
        return stopping(task)

    stopping = stopping_after(1)
    with pytest.raises(Stopped):
        collected_to(link, tasks, stopped, restart=restart)
    collected_to(link, tasks)
    assert modes == [0o600] * 2 and link.is_symlink() and stat.S_IMODE(real.stat().st_mode) == 0o600
    assert sorted(path.name for path in tmp_path.rglob("*real*")) == [real.name]


def test_in_memory(tmp_path):
    counts = Collected()
    records = collect(record_of, make_tasks(tmp_path / "set", NAMES), HERE, counts)
    assert [record["recording"] for record in records] == sorted(NAMES) and counts.done == len(NAMES)


@pytest.mark.needs_pyarrow
def test_parquet_comes_in_row_groups_and_says_its_settings(tmp_path, monkeypatch):
    import pyarrow.parquet

    from async_tnt.archive import parquet

    monkeypatch.setattr(parquet, "GROUP_ITEMS", 3)
    tasks = make_tasks(tmp_path / "set", NAMES)
    records, _ = collected_to(tmp_path / "r.parquet", tasks)
    file = pyarrow.parquet.ParquetFile(tmp_path / "r.parquet")
    assert file.num_row_groups > 1
    assert json.loads(file.schema_arrow.metadata[b"async_tnt"])["about"] == JOB.about
    rows = file.read().to_pylist()
    assert rows == [{k: v for k, v in record.items() if k != "seconds"} for record in records]
