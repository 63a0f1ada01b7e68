"""Results say which run made them, and a result that was edited is noticed."""

from __future__ import annotations

import json
import subprocess

import pytest

from experiments.records import run
from experiments.records.files import (
    add_result,
    problem_of,
    problems,
    read_numbers,
    result_of,
    write_result,
)

HEAD = run.git("rev-parse", "HEAD")
IS_WHOLE = run.git("rev-parse", "--is-shallow-repository") == "false"
"""Whether the checkout has its whole history."""


@pytest.fixture
def committed(monkeypatch):
    """As if the code had no changes that are not committed."""
    monkeypatch.setattr(run, "commit", lambda: HEAD or "0" * 40)


def made(**numbers):
    return result_of({**numbers, "machine": {"cpu": "a processor"}}, "python -m experiments.x")


def test_numbers_come_back_with_their_machine(committed, tmp_path):
    path = tmp_path / "one.json"
    write_result(path, made(right=0.5, sizes=(1, 2)))
    assert read_numbers(path) == {
        "right": 0.5,
        "sizes": [1, 2],
        "machine": {"cpu": "a processor"},
    }
    several = tmp_path / "several.json"
    add_result(several, "a", made(right=1))
    add_result(several, "b", made(right=2))
    add_result(several, "a", made(right=3))
    assert {name: part["right"] for name, part in read_numbers(several).items()} == {"a": 3, "b": 2}
    assert problems(tmp_path) == []


def edited(change):
    result = made(right=0.5)
    change(result)
    return result


@pytest.mark.parametrize(
    "change, problem",
    [
        (lambda r: r["numbers"].update(right=0.6), "it was changed after its run"),
        (lambda r: r["run"].update(command="python -m another"), "it was changed after its run"),
        (lambda r: r["run"].pop("commit"), "its run does not say commit"),
        (lambda r: r["run"].update(machine={}), "its run does not say machine"),
        (lambda r: r["run"].pop("command"), "its run does not say command"),
        (lambda r: r.pop("sha256"), "no result: it must have"),
        (lambda r: r["run"].update(commit="1234+"), "code that was not committed"),
    ],
)
def test_a_result_without_its_run_or_changed_is_refused(committed, change, problem):
    assert problem in problem_of(edited(change))


def test_a_result_of_a_commit_that_the_history_does_not_have_is_refused(monkeypatch, tmp_path):
    if not IS_WHOLE:
        pytest.skip("needs the history of the checkout")
    for commit, is_known in (("0" * 40, False), (HEAD, True)):
        monkeypatch.setattr(run, "commit", lambda commit=commit: commit)
        write_result(tmp_path / "one.json", made(right=1))
        found = problems(tmp_path)
        assert found == (
            [] if is_known else [f"one.json: its commit {commit!r} is not in this history"]
        )


def test_the_recorded_results_are_as_their_runs_wrote_them():
    assert problems() == []


def test_changes_that_are_not_committed_are_told(monkeypatch, tmp_path):
    """In a checkout of its own, of one file that counts as code and one that does not."""
    for words in (["init", "-q"], ["config", "user.email", "a@b"], ["config", "user.name", "a"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    (tmp_path / "experiments" / "results").mkdir(parents=True)
    code = tmp_path / "experiments" / "a.py"
    recorded = tmp_path / "experiments" / "results" / "a.json"
    code.write_text("1")
    recorded.write_text("{}")
    subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
    subprocess.run(["git", "commit", "-qm", "a"], cwd=tmp_path, check=True)
    monkeypatch.setattr(run, "ROOT", tmp_path)
    monkeypatch.setattr(run.async_tnt, "__file__", str(tmp_path / "async_tnt" / "__init__.py"))
    commit = run.commit.__wrapped__
    head = commit()
    assert len(head) == 40
    recorded.write_text('{"a": 1}')
    assert commit() == head
    code.write_text("2")
    assert commit() == head + "+"
    monkeypatch.setattr(run.async_tnt, "__file__", "/elsewhere/async_tnt/__init__.py")
    assert commit() == ""


def test_a_command_shows_no_folder_of_the_machine():
    words = ["--nmnist", "/data/of/mine/nmnist", "--out", "table", "--rows", "a b"]
    assert run.command_line("experiments.x", words) == (
        "python -m experiments.x --nmnist nmnist --out table --rows 'a b'"
    )


def test_a_damaged_file_is_named(tmp_path):
    path = tmp_path / "one.json"
    path.write_text("{")
    with pytest.raises(ValueError, match=r"one\.json is no report"):
        problems(tmp_path)
    path.write_text(json.dumps({"a": 1}))
    assert problems(tmp_path) == [
        "one.json: a: no result: it must have the entries run, numbers and sha256"
    ]
