"""What pages say: sentences whose numbers are compared with results."""

from __future__ import annotations

import re

from experiments.records.run import ROOT


def text_of(page: str) -> str:
    """The text of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def numbers_said(sentence: str, page: str) -> list[float]:
    """The numbers that the text of a page says where `sentence` has #.

    A line break of the page counts as a space. The numbers are read from the page, so that a
    changed sentence is noticed as a changed result is.
    """
    pattern = re.escape(sentence).replace(r"\#", r"([+-]?[\d,]*\.?\d+)")
    found = list(re.finditer(pattern, " ".join(page.split())))
    assert len(found) == 1, f"the page says this {len(found)} times: {sentence}"
    return [float(number.replace(",", "")) for number in found[0].groups()]
