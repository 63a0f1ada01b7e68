"""The pages' tables are those of the recorded results, and a page that differs is noticed."""

from __future__ import annotations

import re

import pytest

from experiments import accuracy_tables as tables
from experiments import pages, thesis_tables
from experiments.page_parts import RESULTS


def test_the_pages_show_the_results(capsys):
    assert pages.main(["--check"]) == 0, capsys.readouterr().out
    readme, results, everything = ((pages.ROOT / page).read_text(encoding="utf-8") for page in pages.PAGES)
    shown = [name for name in re.findall(r"<!-- (\w+) -->", readme + results) if name != "end"]
    assert len(shown) == len(set(shown)) and {make.__name__ for make in pages.SHORT} <= set(shown)
    assert all(make() in everything for make in pages.TABLES.values() if make not in pages.SHORT)
    assert len(re.findall(r"^\|---", results, re.MULTILINE)) <= 6


def test_recorded_results_name_the_processor_and_no_path():
    for path in RESULTS.glob("*.json"):
        text = path.read_text(encoding="utf-8")
        assert '"cpu": "' in text, path
        assert not re.search("/home/|/tmp/|/root/", text), path


def test_a_stale_page_is_noticed_and_rewritten(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(pages, "PAGES", {"page.md": pages.written})
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
    with pytest.raises(ValueError, match="no table 'speeds'; there are numbers"):
        pages.written("<!-- speeds -->\n<!-- end -->\n")


@pytest.mark.parametrize(
    ("low", "mean", "high", "words"),
    [
        (-0.01, 0.02, 0.05, "no difference shown between *raw, translated* and *raw* (-.010 to +.050)"),
        (0.0, 0.02, 0.04, "no difference shown between *raw, translated* and *raw* (+.000 to +.040)"),
        (0.01, 0.02, 0.03, "*raw, translated* gains .020 over *raw* (+.010 to +.030)"),
        (-0.03, -0.02, -0.01, "*raw, translated* loses .020 over *raw* (-.030 to -.010)"),
    ],
)
def test_a_difference_is_claimed_only_where_its_interval_does_not_hold_zero(low, mean, high, words):
    found = {"row": "raw-translated", "against": "raw", "low": low, "mean": mean, "high": high}
    assert thesis_tables.difference_in_words(found) == words


def test_statements_of_the_results_page_hold():
    """Sentences that no table makes."""
    decisions, early = tables.results("decisions"), tables.results("early")
    touched = {n: row["multiplications"] for n, row in decisions["touched"].items()}
    assert touched["1"] < 0.1 * touched["whole"] and 0.2 < touched["100"] / touched["whole"] < 0.4
    for mode in ("in_blocks", "call_by_call"):
        us = {n: decisions["network"][n][mode]["us"] for n in ("1", "1300")}
        assert us["1300"]["incremental"]["median"] == pytest.approx(us["1300"]["dense"]["median"], rel=0.2)
        assert us["1"]["incremental"]["median"] < us["1"]["dense"]["median"] / 2
    groups = (early["results"][name] for name in ("confidence", "confidence_every_ms"))
    alone, every_ms = ({row["settings"]["confidence"]: row for row in group} for group in groups)
    for level in (0.9, 0.95, 0.98, 0.99):
        row = alone[level]
        assert 1.2 < float(tables.same_moment_ms(early, row["accuracy"])) / row["mean_ms"] < 1.65
        assert every_ms[level]["accuracy"] >= row["accuracy"]
        assert 5 < row["evaluations_until"] / every_ms[level]["evaluations_until"] < 8.5
        assert row["accuracy"] == pytest.approx(level, abs=0.025)  # calibrated
    noise = {
        kind: {row["settings"]["confidence"]: row["closed_early"] for row in rows}
        for kind, rows in early["noise"].items()
    }
    assert len(noise) == 5 and all(0.02 <= of[0.9] < 0.075 and of[0.99] == 0 for of in noise.values())
    assert early["recordings"] == 1000 and early["windows_a_recording"] == 3
    networks = tables.results("incremental")["networks"]
    for new, least, most in (("1", 5.5, 14.5), ("1300", 1.05, 1.6)):
        ratios = [of["network"][new]["in_blocks"]["ratio"]["dense"] for n, of in networks.items() if n != "thesis"]
        assert all(least < ratio["median"] < most for ratio in ratios), new
    few = {name: tables.results(f"unseen_{name}")["accuracy"] for name in ("saccades", "hands")}
    closed = [f"{tables.share_closed(of)['other motions']:.2f}" for of in few.values()]
    assert closed == ["0.98", "0.84"]
    (scenes,) = tables.results("everywhere")["models"]
    f1 = [
        scenes["three"]["end"],
        scenes["three"]["early"],
        *(scenes[k]["end"] for k in ("eight", "close", "overlapping")),
    ]
    assert [round(share, 3) for share in f1] == [0.983, 0.973, 0.984, 0.982, 0.963] and scenes["noise"] == 0
    assert round(tables.results("car_scenes")["models"][0]["cars"]["end"], 3) == 0.707
    finder = tables.results("map_times")["models"]["digits-everywhere"]
    us = {case: of["median"] for case, of in finder["times_us"]["640x480"].items()}
    assert [round(us[case], -2) for case in ("1,000 events", "dense", "onnxruntime_run")] == [1600, 66_400, 54_700]
    assert round(us["one event"]) == 247 and [round(of, 2) for of in finder["load"].values()] == [0.61, 1.11, 1.29]
    intervals = {(d["row"], d["against"], d["column"]): d for d in tables.results("table")["differences"]}
    for row in ("running-unsigned-translated", "line-unsigned-translated"):
        of = intervals[row, "raw-unsigned-translated", "1/others"]
        assert of["low"] > 0 and of["mean"] > 0.0775
