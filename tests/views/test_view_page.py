"""The Python snippets of docs/view.md, in the order of the page."""

import re
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra `view`)")
pytest.importorskip("rerun.chunk", reason="this rerun-sdk reads no .rrd files back")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "view.md"


def test_snippets_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    snippets = re.findall(r"```py\n(.*?)```", PAGE.read_text(), re.DOTALL)
    session = {"__name__": "__main__"}
    for k, snippet in enumerate(snippets):
        exec(compile(snippet, f"view.md, snippet {k}", "exec"), session)
    assert len(snippets) == 2
    assert capsys.readouterr().out.splitlines()[:3] == ["7 every_us", "7 every_us", "7 window"]
