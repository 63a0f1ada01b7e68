"""docs/representations.md is complete; its snippets are run with those of all pages."""

from pathlib import Path

from async_tnt import representations

PAGE = Path(__file__).resolve().parents[2] / "docs" / "representations.md"


def test_the_page_names_all_there_is():
    page = PAGE.read_text()
    assert [name for name in representations.__all__ if name.islower() and name not in page] == []
