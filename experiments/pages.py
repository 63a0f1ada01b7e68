"""Write the tables of the pages from the JSON files in experiments/results.

    python -m experiments.pages [--check]

A table stands between `<!-- NAME -->` and `<!-- end -->`, where NAME is one of `TABLES`. `--check` changes nothing, and
exits with 1 if a page differs from the results; a test does that, too.
"""

from __future__ import annotations

import re

from async_tnt.files import write_text
from experiments import accuracy_tables, dataset_tables, decision_tables, stream_tables, thesis_tables, volume_tables
from experiments.page_parts import ROOT
from experiments.script_options import exit_with, plain_parser

PAGES = ("README.md", "docs/results.md")
BLOCK = re.compile(r"(<!-- (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
MODULES = (
    accuracy_tables,
    dataset_tables,
    thesis_tables,
    decision_tables,
    volume_tables,
    stream_tables,
)
TABLES = {make.__name__: make for module in MODULES for make in module.TABLES}


def written(page: str) -> str:
    """A page with its tables written from the results.

    Raises
    ------
    ValueError : a table is not in `TABLES`.
    """

    def replaced(block: re.Match[str]) -> str:
        if block[2] not in TABLES:
            raise ValueError(f"no table {block[2]!r}; there are {', '.join(TABLES)}")
        return f"{block[1]}{TABLES[block[2]]()}\n{block[3]}"

    return BLOCK.sub(replaced, page)


def main(argv: list[str] | None = None) -> int:
    """Write the pages, or check them."""
    parser = plain_parser("pages", __doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 if something would change")
    args = parser.parse_args(argv)
    stale = False
    for page in PAGES:
        path = ROOT / page
        before = path.read_text(encoding="utf-8")
        after = written(before)
        if after == before:
            continue
        stale = True
        print(f"{page}: {'differs from the results' if args.check else 'written'}")
        if not args.check:
            write_text(path, after)
    return int(stale and args.check)


if __name__ == "__main__":
    exit_with(main)
