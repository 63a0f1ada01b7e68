"""The pages show the table that was committed with its settings, and it keeps what the pages say of it."""

import json
from pathlib import Path

import pytest

from async_tnt.training.table import COLUMNS, ROWS, aggregate, markdown_table

ROOT = Path(__file__).resolve().parents[2]
RECORD = json.loads((ROOT / "benchmarks" / "results" / "table.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", ["README.md", "docs/table.md"])
def test_the_page_shows_the_committed_table(page):
    assert markdown_table(RECORD["table"]) in (ROOT / page).read_text(encoding="utf-8")


def test_the_committed_rows_are_the_rows_of_the_code():
    assert set(RECORD["rows"]) == set(ROWS)
    for name, row in ROWS.items():
        assert RECORD["rows"][name]["config"] == row.config.to_dict()
    assert len(RECORD["seeds"]) == 3
    assert RECORD["command"] in (ROOT / "docs" / "table.md").read_text(encoding="utf-8").replace(
        "moving-mnist", "MOVING-MNIST"
    )


def test_means_are_those_of_the_seeds():
    for name, columns in RECORD["table"].items():
        assert list(columns) == list(COLUMNS)
        for column, part in columns.items():
            runs = [
                {
                    "row": name,
                    "trained_on": column.split("/")[0],
                    "seed": int(seed),
                    "columns": {column: {"accuracy": a, "windows": part["windows"], "per_motion": {}}},
                }
                for seed, a in part["seeds"].items()
            ]
            again = aggregate(runs)[name][column]
            assert (again["mean"], again["deviation"]) == pytest.approx((part["mean"], part["deviation"]))
