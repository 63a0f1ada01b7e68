"""What docs/engines.md says besides its snippets, which are run with those of all pages."""

import re
from pathlib import Path

import pytest

from async_tnt import networks as engines
from async_tnt.cli import main

pytest.importorskip("onnx", reason="onnx is not installed (extra `onnx`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `onnx`)")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "engines.md"


def test_the_commands_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^async-tnt ([^#\n]+)", PAGE.read_text(), re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        assert main(command.split()) == 0, capsys.readouterr().err
    assert (tmp_path / "digits.onnx").is_file()


def test_the_page_names_all_there_is():
    page = PAGE.read_text()
    assert [name for name in engines.__all__ if name not in page] == []


def test_the_differences_are_as_small_as_the_page_says(capsys, tmp_path):
    (stated,) = re.findall(r"within ([\d.e-]+) of the compiled", " ".join(PAGE.read_text().split()))
    assert main(["export", "digits", "--out", str(tmp_path / "d.onnx")]) == 0
    (measured,) = re.findall(r"logits within ([\d.e-]+),", capsys.readouterr().out)
    assert float(measured) < 5 * float(stated)  # another machine's vector registers sum in another order
