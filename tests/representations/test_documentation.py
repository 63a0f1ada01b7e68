"""The snippets of docs/representations.md, run from the top as one session."""

import doctest
import re
from pathlib import Path

from async_tnt import representations

PAGE = Path(__file__).resolve().parents[2] / "docs" / "representations.md"


def test_the_snippets_print_what_the_page_shows():
    session, report, n_examples = {}, [], 0
    for k, snippet in enumerate(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)):
        test = doctest.DocTestParser().get_doctest(snippet, session, f"snippet {k}", str(PAGE), 0)
        n_examples += doctest.DocTestRunner().run(test, out=report.append, clear_globs=False).attempted
        session = test.globs
    assert not report, "".join(report)
    assert n_examples > 25


def test_the_page_names_all_there_is():
    page = PAGE.read_text()
    assert [name for name in representations.__all__ if name.islower() and name not in page] == []
