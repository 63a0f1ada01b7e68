"""Files of results.

A result is a JSON object with three entries:

    run      commit, version, date, command and machine, see `run.run_now`
    numbers  what was measured
    sha256   digest of both

A file holds one result, or an object of named results that were made by different runs. Results are
never edited: a new run replaces them. `problems` names each result that was.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from async_tnt.base.files import write_text
from experiments.records.run import CHANGED, ROOT, git, run_now

RESULTS = ROOT / "experiments" / "results"
"""Folder of the recorded runs."""

RUN = ("commit", "version", "date", "command", "machine")
"""What a result says of its run."""


def result_of(numbers: dict[str, Any], command: str) -> dict[str, Any]:
    """A result that was made just now. The entry "machine" of `numbers` becomes part of its run."""
    others = {name: value for name, value in numbers.items() if name != "machine"}
    # as JSON would give them back, which makes tuples lists and keys strings
    others = json.loads(json.dumps(others))
    run = run_now(command, numbers["machine"])
    return {"run": run, "numbers": others, "sha256": digest(run, others)}


def digest(run: dict[str, Any], numbers: Any) -> str:
    """SHA-256 of a run and its numbers, for any order of their entries."""
    text = json.dumps({"run": run, "numbers": numbers}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_result(path: Path, result: dict[str, Any]) -> None:
    """Write a file of one result."""
    write_text(path, json.dumps(result, indent=1) + "\n")


def add_result(path: Path, name: str, result: dict[str, Any]) -> None:
    """Add a named result to a file, which is made if it is missing. It replaces one of this name.

    Other results of the file are kept as they are.
    """
    results = read_json(path) if path.exists() else {}
    results[name] = result
    write_result(path, results)


def read_numbers(path: Path) -> dict[str, Any]:
    """The numbers of a file: those of its result, or name -> those of this result.

    Each has the entry "machine" of its run, too.
    """
    content = read_json(path)
    if _is_result(content):
        return _numbers(content)
    return {name: _numbers(result) for name, result in content.items()}


def read_runs(path: Path) -> list[dict[str, Any]]:
    """The runs that made a file of results, or the files in a folder; one for each result."""
    paths = sorted(path.glob("*.json")) if path.is_dir() else [path]
    return [result["run"] for one in paths for _, result in _named_results(one)]


def read_json(path: Path) -> dict[str, Any]:
    """The object in a file. If the file is damaged, the ValueError names it."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except ValueError as error:
        raise ValueError(f"{path} is no report: {error}") from None


def problems(folder: Path = RESULTS) -> list[str]:
    """Why results of a folder are not to be trusted, a line each: nothing, if all are.

    A result must say which run made it, must be as this run wrote it, and its commit must be in the
    history of this checkout. Without its whole history, commits are not looked up.
    """
    found = []
    is_known: dict[str, bool] = {}
    has_history = git("rev-parse", "--is-shallow-repository") == "false"
    for path in sorted(folder.rglob("*.json")):
        for name, result in _named_results(path):
            problem = problem_of(result)
            if not problem and has_history:
                commit = result["run"]["commit"]
                if commit not in is_known:
                    is_known[commit] = (
                        git("merge-base", "--is-ancestor", commit, "HEAD") is not None
                    )
                if not is_known[commit]:
                    problem = f"its commit {commit!r} is not in this history"
            if problem:
                found.append(f"{path.relative_to(folder)}{name}: {problem}")
    return found


def problem_of(result: Any) -> str:
    """Why a result is not as a run wrote it; empty if it is."""
    if not isinstance(result, dict) or not _is_result(result):
        return "no result: it must have the entries run, numbers and sha256"
    run = result["run"]
    missing = [name for name in RUN if not run.get(name)]
    if missing:
        return f"its run does not say {', '.join(missing)}"
    if run["commit"].endswith(CHANGED):
        return "it was made by code that was not committed"
    if result["sha256"] != digest(run, result["numbers"]):
        return "it was changed after its run"
    return ""


def _named_results(path: Path) -> Iterator[tuple[str, Any]]:
    """Pairs (": name", result) of a file; the name is empty where a file holds one result."""
    content = read_json(path)
    if _is_result(content):
        yield "", content
        return
    for name, result in content.items():
        yield f": {name}", result


def _is_result(content: dict[str, Any]) -> bool:
    return set(content) == {"run", "numbers", "sha256"}


def _numbers(result: dict[str, Any]) -> dict[str, Any]:
    return {**result["numbers"], "machine": result["run"]["machine"]}
