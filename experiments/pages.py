"""Write the tables of the pages, and RESULTS.md, from the JSON files in experiments/results.

    python -m experiments.pages [--check]

A table of a page stands between `<!-- NAME -->` and `<!-- end -->`, where NAME is one of `TABLES`.
RESULTS.md is written as a whole. `--check` changes nothing, and exits with 1 if a file differs from
the results, or if a result is not as a run of a known commit wrote it. A test makes the same check.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from async_tnt.base.files import write_text
from experiments.records.files import problems
from experiments.records.run import ROOT
from experiments.scripts.options import exit_with, plain_parser
from experiments.tables import (
    accuracy,
    datasets,
    decisions,
    differences,
    published,
    scales,
    sections,
    thesis,
)

SHORT = (
    accuracy.accuracy,
    accuracy.published_weights,
    published.zoo_in_short,
    datasets.cars_in_short,
    decisions.speed,
    thesis.unseen_motion,
    differences.thesis_answers,
    scales.object_scales_in_short,
)
"""Tables of README and of the page of results that RESULTS.md does not have."""

TABLES = {
    make.__name__: make
    for make in (*SHORT, *(t for part in sections.SECTIONS for t in part.tables))
}
"""Name between the markers of a page -> function that writes the table."""

BLOCK = re.compile(r"(<!-- (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
"""A table of a page, between its markers."""


def written(page: str) -> str:
    """The text of a page, with its tables written from the results.

    Raises
    ------
    ValueError : a table is not in `TABLES`.
    """

    def replaced(block: re.Match[str]) -> str:
        if block[2] not in TABLES:
            raise ValueError(f"no table {block[2]!r}; there are {', '.join(TABLES)}")
        return f"{block[1]}{TABLES[block[2]]()}\n{block[3]}"

    return BLOCK.sub(replaced, page)


PAGES: dict[str, Callable[[str], str]] = {
    "README.md": written,
    "docs/results.md": written,
    "experiments/RESULTS.md": lambda before: sections.page(),
}
"""Path of a page -> function that makes its new text of its present text."""


def main(argv: list[str] | None = None) -> int:
    """Write the pages, or check them."""
    parser = plain_parser("pages", __doc__)
    parser.add_argument(
        "--check", action="store_true", help="change nothing; exit code 1 if something would change"
    )
    args = parser.parse_args(argv)
    wrong = problems()
    for problem in wrong:
        print(problem)
    stale = False
    for page, make in PAGES.items():
        path = ROOT / page
        before = path.read_text(encoding="utf-8")
        after = make(before)
        if after == before:
            continue
        stale = True
        print(f"{page}: {'differs from the results' if args.check else 'written'}")
        if not args.check:
            write_text(path, after)
    return int(args.check and (stale or bool(wrong)))


if __name__ == "__main__":
    exit_with(main)
