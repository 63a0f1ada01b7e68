"""Type checkers find no fault in README's snippets, and a mistyped setting before it runs. Extra `dev`."""

import doctest
import json
import re
import subprocess
import sys

import pytest
from pages.snippets import ROOT, blocks

import async_tnt
from async_tnt import sources, training

OPTIONS = {"mypy": ["--follow-imports=silent"], "basedpyright": ["--level=error", f"--pythonpath={sys.executable}"]}
ALL_NAMES = [f"from {p.__name__} import {name}" for p in (async_tnt, sources, training) for name in p.__all__]
TYPOS = """
import async_tnt
async_tnt.TNTConfig(landmark="runing")
async_tnt.TNTConfig(polarity="sined", transform="none")
model = async_tnt.load_model("digits")
async_tnt.stream([], model, every_ms=4)
async_tnt.stream([], model, every_us=4, late="drop")
async_tnt.Processor(model, late="dorp")
"""


@pytest.fixture(params=OPTIONS)
def lines_at_fault(request, tmp_path):
    """A function: the lines of a program in which the checker finds errors."""
    pytest.importorskip(request.param, reason=f"{request.param} is not installed (extra `dev`)")
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({"typeCheckingMode": "standard"}))

    def check(text):
        (tmp_path / "program.py").write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", request.param, *OPTIONS[request.param], "program.py"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        found = {int(line) for line in re.findall(r"program\.py:(\d+).* error: ", done.stdout)}
        assert done.returncode == bool(found), done.stdout + done.stderr
        return [text.splitlines()[line - 1] for line in sorted(found)]

    return check


def test_snippets_and_public_names_are_typed(lines_at_fault):
    snippets = blocks((ROOT / "README.md").read_text(encoding="utf-8"), "python")
    assert len(snippets) > 2
    programs = [doctest.script_from_examples(part) if ">>>" in part else part for part in snippets]
    assert lines_at_fault("\n".join(programs + ALL_NAMES)) == []


def test_a_mistyped_setting_is_found(lines_at_fault):
    found = lines_at_fault(TYPOS)
    assert re.findall("runing|sined|every_ms|dorp", "".join(found)) == ["runing", "sined", "every_ms", "dorp"]
    assert len(found) == 4
