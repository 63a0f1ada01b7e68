"""The pages' tables are those of the recorded results, and a page that differs is noticed."""

from __future__ import annotations

import re

import pytest

from experiments import pages
from experiments.tables import accuracy as tables
from experiments.tables import differences
from experiments.tables.parts import RESULTS
from experiments.thesis.factors import FACTORS
from experiments.thesis.numbers import signed
from experiments.thesis.rows import IMAGES, INPUTS, QUESTIONS, ROWS, SETS


def test_the_pages_show_the_results(capsys):
    assert pages.main(["--check"]) == 0, capsys.readouterr().out
    readme, results, everything = (
        (pages.ROOT / page).read_text(encoding="utf-8") for page in pages.PAGES
    )
    shown = [name for name in re.findall(r"<!-- (\w+) -->", readme + results) if name != "end"]
    assert len(shown) == len(set(shown)) and {make.__name__ for make in pages.SHORT} <= set(shown)
    assert all(make() in everything for make in pages.TABLES.values() if make not in pages.SHORT)


def test_recorded_results_name_the_processor_and_no_path():
    for path in RESULTS.glob("*.json"):
        text = path.read_text(encoding="utf-8")
        assert path.stem == "early" or '"cpu": "' in text, path  # what `async-tnt evaluate` prints
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


def difference(row, mean, holm, column="all/sim"):
    question = "The thesis' rows against its Baseline"
    return {
        "question": question,
        "row": row,
        "against": "thesis-baseline",
        "column": column,
        "mean": mean,
        "holm": holm,
    }


def test_what_holds_is_said_and_nothing_else():
    found = [difference("thesis-tnt", 0.1654, 0.049), difference("thesis-tnt", 0.2, 0.05, "1/sim")]
    found.append(difference("thesis-regress", -0.02, 0.001, "1/bell"))
    question = found[0]["question"]
    assert differences.answer(question, found).splitlines() == [
        f"{question}: 2 of 3 differences hold.",
        "",
        "| difference | trained on | sim | bell |",
        "|---|---|---|---|",
        "| TNT - Baseline | all | +.165 |  |",
        "| TNT+regress - Baseline | 1 |  | -.020 |",
    ]
    assert differences.answer(question, found[1:2]) == f"{question}: 0 of 1 differences hold."
    assert differences.answer(question, []) == f"{question}: not measured yet."


def rows_of(table):
    """The head of a Markdown table and its rows, as lists of cells."""
    head, _, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in table)
    return head, rows


def test_every_difference_that_a_page_claims_holds_and_none_that_holds_is_left_out():
    """Read back from the tables of RESULTS.md, against the results."""
    recorded = tables.results("table")["differences"]
    titles = {row.title: name for name, row in ROWS.items()}
    everything = (pages.ROOT / "experiments/RESULTS.md").read_text(encoding="utf-8")
    claimed = set()
    for question, lines in re.findall(
        r"^(.+): \d+ of \d+ differences hold\.\n\n((?:\|.*\n)+)", everything, re.MULTILINE
    ):
        head, rows = rows_of(lines.splitlines())
        for pair, trained_on, *means in rows:
            row, against = (titles[title] for title in pair.split(" - "))
            for test, mean in zip(head[2:], means, strict=True):
                if mean:
                    claimed.add((question, row, against, f"{trained_on}/{test}", mean))
    holding = {
        (d["question"], d["row"], d["against"], d["column"], signed(d["mean"]))
        for d in recorded
        if d["holm"] < 0.05
    }
    assert claimed == holding
    assert {question for question, *_ in claimed} == set(QUESTIONS)


def test_the_page_of_results_shows_all_that_holds_of_the_thesis_question():
    asked = [
        d
        for d in tables.results("table")["differences"]
        if d["against"] == "thesis-baseline" and d["column"].split("/")[1] in SETS
    ]
    page = (pages.ROOT / "docs/results.md").read_text(encoding="utf-8")
    [(n_asked, lines)] = re.findall(
        r"^Of (\d+) differences to the Baseline .*\n\n((?:\|.*\n)+)", page, re.MULTILINE
    )
    head, rows = rows_of(lines.splitlines())
    trained_on = {"all saccades": "all", "the first saccade": "1"}
    shown = {
        (*title.split(", "), name, mean)
        for name, *means in rows
        for title, mean in zip(head[1:], means, strict=True)
        if mean
    }
    assert int(n_asked) == len(asked)
    assert {(title, f"{trained_on[on]}/{name}", mean) for title, on, name, mean in shown} == {
        (ROWS[d["row"]].title, d["column"], signed(d["mean"])) for d in asked if d["holm"] < 0.05
    }


def test_statements_of_the_results_page_hold():
    """Sentences that no table makes."""
    decisions = tables.results("decisions")
    early = tables.results("early")
    for mode in ("in_blocks", "call_by_call"):
        us = {n: decisions["network"][n][mode]["us"] for n in ("1", "1300")}
        assert us["1300"]["incremental"]["median"] == pytest.approx(
            us["1300"]["dense"]["median"], rel=0.2
        )
        assert us["1"]["incremental"]["median"] < us["1"]["dense"]["median"] / 2
    levels = {row["level"]: row for row in early["confidence"]}
    assert [round(levels[level]["accuracy"], 3) for level in (0.9, 0.95, 0.99)] == [
        0.949,
        0.977,
        0.995,
    ]
    after = {row["time_us"]: row["accuracy"] for row in early["accuracy_against_time"]}
    assert levels[0.99]["median_ms"] == 25.2 and levels[0.99]["window_accuracy"] >= after[52_500]
    moments = {
        kind: row["at_some_moment"]
        for kind, row in tables.results("nothing")["rows"].items()
        if len(row) > 2
    }
    for kind in ("noise", "noise of one polarity", "pairs"):
        assert 0.03 <= moments[kind]["0.9"] <= 0.05 and moments[kind]["0.99"] == 0
    assert all(
        0.4 < moments[kind]["0.9"] < 0.65 for kind in moments if re.search("edge|corner|disc", kind)
    )
    assert early["recordings"] == 1000
    networks = tables.results("incremental")["networks"]
    for new, least, most in (("1", 5.5, 14.5), ("1300", 1.05, 1.6)):
        ratios = [
            of["network"][new]["in_blocks"]["ratio"]["dense"]
            for n, of in networks.items()
            if n != "thesis"
        ]
        assert all(least < ratio["median"] < most for ratio in ratios), new
    few = {name: tables.results(f"unseen_{name}")["accuracy"] for name in ("saccades", "hands")}
    closed = [f"{tables.share_closed(of)['other motions']:.2f}" for of in few.values()]
    assert closed == ["0.98", "0.84"]
    whole = tables.results("unseen_whole")["accuracy"]["resynthesized"]
    assert [round(whole[test]["mean"], 3) for test in ("all saccades", "simulated motions")] == [
        0.984,
        0.985,
    ]
    scenes, *others = tables.results("everywhere")["models"]
    told = [
        ("three", "end"),
        ("three", "early"),
        *((k, "end") for k in ("eight", "close", "overlapping")),
    ]
    assert [round(scenes[k][moment], 3) for k, moment in told] == [0.986, 0.972, 0.986, 0.98, 0.96]
    assert (
        all(one[k][moment] >= scenes[k][moment] for one in others for k, moment in told)
        and len(others) == 4
    )
    assert {one["noise"] for one in (scenes, *others)} == {0}
    assert round(tables.results("car_scenes")["models"][0]["cars"]["end"], 3) == 0.707
    differences = {
        (d["row"], d["against"], d["column"]): d for d in tables.results("table")["differences"]
    }
    for column, hold in (("1/all", {"time_surface"}), ("1/sim", {"mean_time", "time_surface"})):
        names = [name for name in (*INPUTS, *IMAGES) if name != "raw"]
        of = {
            name: differences[f"{name}-translated", "raw-translated", column]["holm"]
            for name in names
        }
        assert {name for name, p in of.items() if p < 0.05} == hold
    for row, against, n_columns, held in (
        ("line", "raw", 22, 17),
        ("line-translated", "raw-translated", 22, 6),
    ):
        of_pair = [d for key, d in differences.items() if key[:2] == (row, against)]
        gains = [d["mean"] > 0 for d in of_pair if d["holm"] < 0.05]
        assert len(of_pair) == n_columns and len(gains) == held and all(gains)
    of_motions = {
        key[2]: d["mean"] > 0 and d["holm"] < 0.05
        for key, d in differences.items()
        if key[1] == "raw-8000"
    }
    assert len(of_motions) == 32 and {
        column for column, gains in of_motions.items() if not gains
    } == {"all/all"}
    beyond = [
        round(differences["raw-motions", "raw-8000", f"{on}/beyond"]["mean"], 3)
        for on in ("1", "all")
    ]
    assert beyond == [0.643, 0.361]
    after = {
        key[2]: d
        for key, d in differences.items()
        if key[0] == "running-motions" and d["holm"] < 0.05
    }
    gains = {column.removeprefix("1/"): round(d["mean"], 3) for column, d in after.items()}
    assert {gains.pop(f"{name} bright") for name in ("sim", "centre", "bell", "bell centre")} >= {
        0.105,
        0.137,
    }
    assert gains == {"train": 0.002, "centre": 0.009, "bell centre": 0.012}
    moved = [
        d for key, d in differences.items() if key[0] == "line-translated" and d["holm"] < 0.05
    ]
    bright = [d for d in moved if d["against"] == "raw-translated"]
    assert all(d["column"].endswith(" bright") for d in bright)
    assert [round(f(d["mean"] for d in bright), 3) for f in (min, max)] == [0.136, 0.174]
    effects = {
        (e["trained_on"], e["row"], e["effect"]): e for e in tables.results("table")["effects"]
    }
    polarity, start, _, distance = FACTORS
    for row, effect, mean in (
        ("thesis-tnt", polarity, 0.166),
        ("thesis-tnt", start, 0.122),
        ("thesis-tnt", distance, 0.079),
        ("thesis-regress", start, 0.1),
        ("thesis-regress", distance, 0.058),
    ):
        assert (
            round(effects["all", row, effect]["mean"], 3) == mean
            and effects["all", row, effect]["holm"] < 0.05
        )
    assert not effects["all", "thesis-regress", polarity]["holm"] < 0.05
    for name, low, high in (("centre bright", 0.034, 0.139), ("bell centre bright", 0.083, 0.206)):
        found = differences["thesis-tnt", "thesis-baseline", f"all/{name}"]
        assert (round(found["low"], 3), round(found["high"], 3)) == (low, high) and not found[
            "holm"
        ] < 0.05
    found = differences["thesis-regress", "thesis-baseline", "all/centre bright"]
    assert [round(found[name], 3) for name in ("mean", "low", "high")] == [-0.043, -0.161, 0.075]
    assert round(differences["thesis-tnt", "thesis-baseline", "1/all"]["mean"], 3) == 0.014
    assert not differences["thesis-tnt", "thesis-baseline", "1/all"]["holm"] < 0.05
    for name, (_, dark) in SETS.items():
        found = differences["thesis-tnt", "thesis-baseline", f"all/{name}"]
        assert not dark or (found["mean"] < 0 and found["holm"] < 0.05), name
    for row, against, column, mean in (
        ("thesis-regress", "thesis-baseline", "1/all", 0.048),
        ("thesis-regress", "thesis-baseline", "1/others", 0.079),
        ("raw-translated", "raw", "1/all", 0.093),
        ("line", "raw", "all/centre bright", 0.277),
        ("center-1000-events", "center", "all/centre bright", 0.247),
        ("thesis-tnt", "thesis-baseline", "all/all", -0.015),
        ("thesis-regress", "thesis-baseline", "all/all", -0.012),
    ):
        found = differences[row, against, column]
        assert round(found["mean"], 3) == mean and found["holm"] < 0.05
    assert not differences["regressor-translated", "raw-translated", "1/all"]["holm"] < 0.05
    finder = tables.results("map_times")["models"]["digits-everywhere"]
    us = {case: of["median"] for case, of in finder["times_us"]["640x480"].items()}
    assert [round(us[case], -2) for case in ("1,000 events", "dense", "onnxruntime_run")] == [
        600,
        26_600,
        20_100,
    ]
    assert round(us["one event"]) == 60 and [round(of, 2) for of in finder["load"].values()] == [
        0.22,
        0.38,
        0.43,
    ]
