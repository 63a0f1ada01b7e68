"""Type checkers find no fault in README's snippets, and a mistyped setting before it runs.

Extra `dev`.
"""

import doctest
import json
import re
import subprocess
import sys

import pytest
from pages.snippets import ROOT, blocks

import async_tnt
from async_tnt import sources, training

OPTIONS = {
    "mypy": ["--follow-imports=silent", f"--cache-dir={ROOT / '.mypy_cache' / 'snippets'}"],
    "basedpyright": ["--level=error", f"--pythonpath={sys.executable}"],
}
ALL_NAMES = [
    f"from {p.__name__} import {name}" for p in (async_tnt, sources, training) for name in p.__all__
]
TYPOS = """
import async_tnt
async_tnt.TNTConfig(landmark="runing")
async_tnt.TNTConfig(polarity="sined", transform="none")
model = async_tnt.load_model("digits")
async_tnt.stream([], model, every_ms=4)
async_tnt.stream([], model, every_us=4, late="drop")
async_tnt.Processor(model, late="dorp")
"""


@pytest.mark.parametrize("checker", OPTIONS)
def test_snippets_and_public_names_are_typed_and_a_mistyped_setting_is_found(checker, tmp_path):
    pytest.importorskip(checker, reason=f"{checker} is not installed (extra `dev`)")
    snippets = blocks((ROOT / "README.md").read_text(encoding="utf-8"), "python")
    assert len(snippets) > 2
    programs = [doctest.script_from_examples(part) if ">>>" in part else part for part in snippets]
    text = "\n".join([*programs, *ALL_NAMES, TYPOS])
    (tmp_path / "program.py").write_text(text, encoding="utf-8")
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({"typeCheckingMode": "standard"}))
    command = [sys.executable, "-m", checker, *OPTIONS[checker], "program.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    lines = sorted({int(line) for line in re.findall(r"program\.py:(\d+).* error: ", done.stdout)})
    found = [text.splitlines()[line - 1] for line in lines]
    typos = re.findall("runing|sined|every_ms|dorp", "".join(found))
    assert typos == ["runing", "sined", "every_ms", "dorp"]
    assert len(found) == 4, done.stdout + done.stderr
