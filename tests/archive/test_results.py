"""The file that records are appended to: what a kill, garbage, an earlier version or another program leaves of it."""

import os

import pytest
from archive.made_work import JOB, make_tasks, record_of

from async_tnt.archive import results
from async_tnt.archive.job import Job
from async_tnt.archive.results import ResultFile, lines_path

NAMES = ["b", "a", "ccc", "b"]  # the newest line of a recording is the valid one


@pytest.fixture(params=["r.jsonl", pytest.param("r.parquet", marks=pytest.mark.needs_pyarrow)])
def out(request, tmp_path):
    """An unfinished result file of three recordings, one of them twice."""
    out = tmp_path / request.param
    with ResultFile(out, JOB) as file:
        for late, task in enumerate(make_tasks(tmp_path / "set", NAMES)):
            record = record_of(task) | {"late": late}
            del record["seconds"]
            file.append(record)
    return out


def test_cut_anywhere_it_holds_its_whole_lines(out):
    path = lines_path(out)
    content = path.read_bytes()
    ends = [0, *(k + 1 for k, byte in enumerate(content) if byte == ord("\n"))]
    near = {end + k for end in ends for k in range(-20, 21)}
    for length in sorted({*range(0, len(content), 23), *near} & {*range(len(content) + 1)}):
        path.write_bytes(content[:length])
        n = sum(end <= length for end in ends) - 1
        with ResultFile(out, JOB) as file:
            assert file.versions.keys() == set(NAMES[:n]), length
            assert path.read_bytes() == content[: ends[n]], length


@pytest.mark.parametrize("tail", [b"\x00" * 90, b"\xff", b'{"recording": "x", "er', b"[" * 100_000])
def test_whatever_follows_the_last_whole_line_is_cut_off(tail, out):
    path = lines_path(out)
    content = path.read_bytes()
    path.write_bytes(content + tail)
    with ResultFile(out, JOB) as file:
        assert file.versions.keys() == set(NAMES)
    assert path.read_bytes() == content


def test_the_newest_line_of_a_recording_counts(out):
    with ResultFile(out, JOB) as file:
        assert not file.is_finished({"a", "b", "ccc"})
        file.finish({"a", "b", "ccc"})
    records = list(results.read_results(out, JOB))
    assert [(record["recording"], record["late"]) for record in records] == [("a", 1), ("b", 3), ("ccc", 2)]
    with ResultFile(out, JOB) as file:
        assert file.is_finished({"a", "b", "ccc"}) and not file.is_finished({"a", "b"})


@pytest.mark.parametrize(
    "line",
    [b"[" * 100_000, b"{}", b'{"recording": 3}', b"9" * 5000, b"NaN", b'{"recording": "x"}', b"\xff", b""],
)
def test_a_damaged_line_is_refused(line, out):
    path = lines_path(out)
    lines = path.read_bytes().splitlines(keepends=True)
    content = b"".join([*lines[:2], line + b"\n", *lines[2:]])
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"is not a result of async-tnt run, or is damaged: move it away"):
        ResultFile(out, JOB)
    assert path.read_bytes() == content
    with ResultFile(out, JOB, restart=True) as file:
        assert not file.versions


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("content", [b"my notes", b"my notes\n", b'{"a": 1}\n', b"\x00\xff\n\n", b"[]\n"])
def test_files_of_others_stay(content, restart, out):
    path = lines_path(out)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"is not a result of async-tnt.*: move it away"):
        ResultFile(out, JOB, restart=restart)
    assert path.read_bytes() == content


def test_other_settings_are_refused(out):
    content = lines_path(out).read_bytes()
    with pytest.raises(ValueError, match=rf"was made with another model, .* settings {JOB.id} \(now \w{{12}}\): give"):
        ResultFile(out, Job("run", "digits", "compiled"))
    assert lines_path(out).read_bytes() == content


def test_an_unfinished_file_of_an_earlier_version_is_refused(out):
    former = out.with_name(out.name + ".partial")
    former.write_text('{"async_tnt_journal": 1}\n')
    with pytest.raises(ValueError, match=r"\.partial was left by an earlier version, .* delete it"):
        ResultFile(out, JOB)
    assert former.exists()


def test_two_programs_at_once_are_refused(out):
    with ResultFile(out, JOB), pytest.raises(OSError, match=r"r\.\w+: another program is writing it"):
        ResultFile(out, JOB)
    ResultFile(out, JOB).close()


@pytest.mark.parametrize("replaced", [False, True])
def test_a_file_that_goes_before_it_is_locked_is_not_written(replaced, out, monkeypatch):
    """Opened, then locked: in between the program that had locked it may have finished."""
    lock, path = results._lock, lines_path(out)
    gone = []

    def lock_late(file):
        if not gone:
            gone.append(path.rename(path.with_name("gone")))
            if replaced:
                path.touch()
        lock(file)

    monkeypatch.setattr(results, "_lock", lock_late)
    with ResultFile(out, JOB) as file:
        assert not file.versions and path.exists()
    if os.name == "posix":
        assert (path.with_name("gone")).stat().st_size > 0
