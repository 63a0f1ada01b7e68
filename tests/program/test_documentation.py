"""The Python snippets of every page in docs/, each page run from the top as one session."""

import doctest
import re
from pathlib import Path

import pytest
from small_sets import write_small_mnist

from async_tnt.cli import main

DOCS = Path(__file__).resolve().parents[2] / "docs"
NEEDS = {"engines.md": ("onnx", "onnxruntime")}
SNIPPETS = {page: re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL) for page in sorted(DOCS.glob("*.md"))}
N_EXAMPLES = {"engines.md": 20, "representations.md": 25}  # at least, so that a page cannot lose them unseen


@pytest.mark.parametrize("page", [page for page in SNIPPETS if SNIPPETS[page]], ids=lambda page: page.name)
def test_snippets_run_and_print_what_the_page_shows(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if page.name == "simulation.md":  # its snippet reads a set that is there
        monkeypatch.setenv("TNT_DATA", str(tmp_path / "none"))  # it shows images of its own, not MNIST's
        (tmp_path / "mnist").mkdir()
        assert main(["simulate", "--mnist", str(write_small_mnist(tmp_path / "mnist", 8)), "--out", "moving"]) == 0
    for package in NEEDS.get(page.name, ()):
        pytest.importorskip(package, reason=f"{package} is not installed (extra `onnx`)")
    session, report, n_examples = {"__name__": "__main__"}, [], 0
    for k, snippet in enumerate(SNIPPETS[page]):
        if ">>>" not in snippet:
            exec(compile(snippet, f"{page.name}, snippet {k}", "exec"), session)
            continue
        test = doctest.DocTestParser().get_doctest(snippet, session, f"snippet {k}", str(page), 0)
        n_examples += doctest.DocTestRunner().run(test, out=report.append, clear_globs=False).attempted
        session = test.globs
    assert not report, "".join(report)
    assert n_examples >= N_EXAMPLES.get(page.name, 0)


def test_there_are_such_pages():
    assert sum(map(len, SNIPPETS.values())) > 15
