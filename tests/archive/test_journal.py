"""The journal: what a kill, garbage or another program leaves of it."""

import json
import os

import pytest
from archive.made_work import JOB, make_tasks, record_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from async_tnt.archive.journal import Journal, other_settings
from async_tnt.archive.results import is_record

ABOUT = JOB.about


def valid(record):
    return is_record(record, "run")


def opened(path, about=ABOUT, **words):
    return Journal(path, about, valid, path.with_name("r.jsonl"), **words)


@pytest.fixture(autouse=True)
def no_sync(monkeypatch):
    """What it is for, a loss of power, is not tested; it only takes time."""
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.fixture
def written(tmp_path):
    """A journal of three records, one of them twice, closed."""
    journal = opened(tmp_path / "j")
    records = [record_of(task) for task in make_tasks(tmp_path / "set", ["b", "a", "ccc"])]
    for record in (*records, {**records[0], "late": 7}):
        journal.append(record)
    journal.close()
    return tmp_path / "j", records


@pytest.fixture
def content(written):
    return written[0].read_bytes()


def test_records_are_read_back_and_the_newest_counts(written):
    path, records = written
    journal = opened(path)
    assert journal.where.keys() == {"a", "b", "ccc"}
    assert journal.read("a") == records[1] and journal.read("b")["late"] == 7
    journal.append({**records[1], "late": 9})  # after reads in between
    assert journal.read("a")["late"] == 9 and journal.read("ccc") == records[2]
    journal.close()
    journal = opened(path)
    assert journal.read("a")["late"] == 9
    journal.close()


def test_cut_anywhere_it_holds_its_whole_lines(written):
    path, _ = written
    content = path.read_bytes()
    ends = [k + 1 for k, byte in enumerate(content) if byte == ord("\n")]
    names = ["b", "a", "ccc", "b"]
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        journal = opened(path)
        whole = sum(end <= length for end in ends)
        assert journal.where.keys() == set(names[: max(0, whole - 1)]), length
        assert path.read_bytes() == content[: ends[max(whole, 1) - 1]], length
        for name in journal.where:
            assert journal.read(name)["recording"] == name
        journal.close()
        assert path.exists() == (whole > 1)


@given(
    st.binary(max_size=200)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda s: st.lists(s) | st.dictionaries(st.text(), s),
        max_leaves=8,
    ).map(lambda made: json.dumps(made).encode() + b"\n"),
    st.integers(0, 4),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200)
def test_garbage_is_cut_off_and_nothing_before_it(written, content, garbage, line):
    path, records = written
    lines = content.splitlines(keepends=True)
    kept = b"".join(lines[: line + 1])
    path.write_bytes(kept + garbage + b"\n" + b"".join(lines[line + 1 :]))
    journal = opened(path)
    assert path.read_bytes().startswith(kept) or not line
    assert journal.where.keys() == set(["b", "a", "ccc", "b"][:line])
    journal.append(records[2])
    journal.close()
    journal = opened(path)
    assert journal.read("ccc") == records[2]
    journal.close()


@pytest.mark.parametrize("line", ["[" * 100_000, "{}", '{"recording": 3}', "9" * 5000, "NaN", '{"recording": "x"}'])
def test_lines_that_are_no_records_are_cut_off(written, line):
    path, _ = written
    content = path.read_bytes()
    path.write_bytes(content + line.encode() + b"\n")
    journal = opened(path)
    assert path.read_bytes() == content and len(journal.where) == 3
    journal.close()


def test_other_settings_are_refused_with_their_names(written):
    path, _ = written
    content = path.read_bytes()
    with pytest.raises(ValueError, match=r"r\.jsonl was begun with --every-us 5000 \(now 6000\), another model: give"):
        opened(path, {**ABOUT, "every_us": 6000, "model_sha256": "b"})
    assert path.read_bytes() == content
    more = {"every_us": None, "confidence": 0.9, "activity": {"threshold": 60.0, "leak_us": 4e3, "charge": 1.0}}
    told = "--every-us 5000 (now not given), --confidence not given (now 0.9), --activity not given (now 60:4000)"
    assert f"was begun with {told}: give" in other_settings(path, ABOUT, {**ABOUT, **more})
    told = "folder /a (now /b)"
    assert f"was begun with {told}: give" in other_settings(path, {**ABOUT, "folder": "/a"}, {**ABOUT, "folder": "/b"})
    told = "was begun with command run (now evaluate): give"
    assert told in other_settings(path, ABOUT, {**ABOUT, "command": "evaluate", "every_us": 10_500})
    journal = opened(path, {**ABOUT, "every_us": 6000}, restart=True)
    assert not journal.where
    journal.close()
    assert not path.exists()


def test_a_header_alone_binds_nobody(tmp_path):
    path = tmp_path / "j"
    path.write_bytes(json.dumps({"async_tnt_journal": 1, "about": {"every_us": 3}}).encode() + b"\n")
    opened(path).close()


@pytest.mark.parametrize("content", [b"my notes", b"my notes\n", b'{"a": 1}\n', b"\x00\xff\n\n", b"[]\n"])
@pytest.mark.parametrize("restart", [False, True])
def test_other_peoples_files_stay(tmp_path, content, restart):
    path = tmp_path / "j"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="is no journal of async-tnt: move it away"):
        opened(path, restart=restart)
    assert path.read_bytes() == content


def test_two_at_once_are_refused(written):
    path, _ = written
    first = opened(path)
    with pytest.raises(OSError, match=r"r\.jsonl: another program is writing it"):
        opened(path)
    first.close()
    opened(path).close()


def test_a_journal_deleted_while_waiting_for_its_lock_is_not_taken(written, monkeypatch):
    """Opened, then locked: in between, the other program may have finished and deleted the file."""
    from async_tnt.archive import journal as module

    path, _ = written
    lock = module._lock
    deleted = []

    def lock_late(file):
        if not deleted:
            deleted.append(path.unlink())
        lock(file)

    monkeypatch.setattr(module, "_lock", lock_late)
    journal = opened(path)
    assert not journal.where and path.exists()
    journal.close()
