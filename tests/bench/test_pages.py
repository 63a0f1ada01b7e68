"""The pages' tables are those of the recorded results, and a page that differs is noticed."""

from __future__ import annotations

import json
import re

import pytest
from bench.scripts import load_benchmark


@pytest.fixture
def pages():
    return load_benchmark("pages")


def test_the_pages_show_the_results(pages, capsys):
    assert pages.main(["--check"]) == 0, capsys.readouterr().out


def test_every_table_is_on_one_page(pages):
    text = "".join((pages.ROOT / page).read_text(encoding="utf-8") for page in pages.PAGES)
    found = re.findall(r"<!-- (\w+) -->", text)
    names = [name for name in found if name != "end"]
    assert sorted(names) == sorted(pages.TABLES)
    assert found.count("end") == len(names)


def test_a_stale_page_is_noticed_and_rewritten(pages, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(pages, "PAGES", ("page.md",))
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.setattr(pages, "TABLES", {"numbers": lambda: "| a |\n|---|\n| 2 |"})
    page = tmp_path / "page.md"
    stale = "Above.\n\n<!-- numbers -->\n| a |\n|---|\n| 1 |\n<!-- end -->\n\nBelow, <!-- a remark --> and more.\n"
    page.write_text(stale, encoding="utf-8")
    assert pages.main(["--check"]) == 1
    assert page.read_text(encoding="utf-8") == stale
    assert "page.md: differs from the results" in capsys.readouterr().out
    assert pages.main([]) == 0
    assert page.read_text(encoding="utf-8") == stale.replace("| 1 |", "| 2 |")
    assert pages.main(["--check"]) == 0


def test_an_unknown_table_is_named(pages):
    with pytest.raises(ValueError, match="no table 'speeds'; there are accuracy, early, "):
        pages.written("<!-- speeds -->\n<!-- end -->\n")


def test_cells_by_hand(pages, monkeypatch):
    tables = pages.decision_tables
    row = {
        "us": {"ours": {"median": 9.96, "p99": 21.4}, "torch": {"median": 432.1, "p99": 1234.5}},
        "ratio": {"torch": {"median": 34.94}},
    }
    monkeypatch.setattr(tables, "results", lambda name: {"end_to_end": {"1": {"in_blocks": row}}})
    assert tables.end_to_end_in_blocks().splitlines() == [
        "|  | 1 new event |",
        "|---|---|",
        "| async_tnt: `push`, `fire` | 10.0 (21) |",
        "| torch: the whole window's volume, its network | 432 (1,234) 34.9x |",
    ]


def test_the_time_of_the_same_accuracy_is_interpolated(pages):
    moments = [(10_000, 0.2), (20_000, 0.6), (40_000, 1.0)]
    found = {
        "window_us": 50_000,
        "results": {"moment": [{"settings": {"every_us": us}, "accuracy": accuracy} for us, accuracy in moments]},
    }
    assert pages.accuracy_tables.same_moment_ms(found, 0.4) == "15.0"
    assert pages.accuracy_tables.same_moment_ms(found, 0.9) == "35"
    assert pages.accuracy_tables.same_moment_ms(found, 1.1) == ""


def test_statements_beside_the_tables_hold(pages):
    """Sentences of docs/results.md that no table makes."""
    decisions, early = (pages.accuracy_tables.results(name) for name in ("decisions", "early"))
    touched = decisions["touched"]
    assert touched["1"]["multiplications"] < 0.1 * touched["whole"]["multiplications"]
    assert 0.35 < touched["100"]["multiplications"] / touched["whole"]["multiplications"] < 0.6
    for way in ("in_blocks", "call_by_call"):
        us = {n: decisions["network"][n][way]["us"] for n in ("1", "1300")}
        assert us["1300"]["incremental"]["median"] == pytest.approx(us["1300"]["dense"]["median"], rel=0.2)
        assert us["1"]["incremental"]["median"] < us["1"]["dense"]["median"] / 2
    rows = {
        group: {r["settings"]["confidence"]: r for r in early["results"][group]}
        for group in ("confidence", "confidence_every_ms")
    }
    alone, every_ms = rows["confidence"], rows["confidence_every_ms"]
    for level in (0.8, 0.9):
        assert (
            1.2
            < float(pages.accuracy_tables.same_moment_ms(early, alone[level]["accuracy"])) / alone[level]["mean_ms"]
            < 1.55
        )
    assert every_ms[0.95]["accuracy"] >= alone[0.95]["accuracy"] - 0.001
    assert 9 < alone[0.95]["evaluations_until"] / every_ms[0.95]["evaluations_until"] < 12
    assert 0.9 < every_ms[0.95]["mean_ms"] - alone[0.95]["mean_ms"] < 2.1
    assert alone[0.99]["at_end"] > 0.5
    assert all(alone[level]["soon"] < 0.03 and alone[level]["soon_accuracy"] == 1 for level in (0.8, 0.9, 0.95))
    noise = {r["settings"]["confidence"]: r["closed_early"] for r in early["noise"]}
    assert noise[0.5] > 0.9 and noise[0.95] < 0.05


def test_early_results_are_of_all_test_recordings(pages):
    early = pages.accuracy_tables.results("early")
    assert early["recordings"] == 1000 and early["windows_a_recording"] == 3
    assert all(r["windows"] == 3000 for group in early["results"].values() for r in group)
    assert json.dumps(early)  # plain JSON: no infinity
