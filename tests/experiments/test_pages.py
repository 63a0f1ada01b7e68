"""The pages' tables are those of the recorded results, and a page that differs is noticed."""

from __future__ import annotations

import json
import re

import pytest

from experiments import pages
from experiments.records import files
from experiments.tables import differences, parts, runs, sections, thesis
from experiments.tables.parts import RESULTS
from experiments.thesis.numbers import signed
from experiments.thesis.rows import QUESTIONS, ROWS, runs_of
from experiments.thesis.table import recorded_networks, recorded_table


def test_the_pages_show_the_results(capsys):
    assert pages.main(["--check"]) == 0, capsys.readouterr().out
    *some, everything = [(pages.ROOT / page).read_text(encoding="utf-8") for page in pages.PAGES]
    shown = [name for name in re.findall(r"<!-- (\w+) -->", "".join(some)) if name != "end"]
    assert len(shown) == len(set(shown))
    assert {make.__name__ for make in pages.SHORT} <= set(shown)
    assert all(make() in everything for make in pages.TABLES.values() if make not in pages.SHORT)


def test_every_result_is_on_the_page_with_its_run(monkeypatch):
    read = []

    def read_numbers(path):
        read.append(path.stem)
        return files.read_numbers(path)

    monkeypatch.setattr(parts, "read_numbers", read_numbers)
    for section in sections.SECTIONS:
        read.clear()
        for make in section.tables:
            make()
        # the files in the folder of the thesis' table are read once for all sections
        shown = set(section.results if section.tables else ()) - {"thesis"}
        assert set(read) == shown, section.title
    named = {name for section in sections.SECTIONS for name in section.results}
    assert named == {path.stem for path in RESULTS.glob("*.json")} | {"thesis"}


def test_runs_of_the_same_code_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(runs, "RESULTS", tmp_path)
    machine = {"cpu": "Z80", "cores": 1, "load_1min": 0.25}
    run = {"version": "1.0", "commit": "c0ffee0123", "date": "2026-01-02 03:04", "machine": machine}
    busy = {**run, "date": "2026-01-05 00:00", "machine": {**machine, "load_1min": 3.0}}
    older = {**run, "version": "0.9", "note": "from the history"}
    made = {"a": run, "b": older, "c": busy}
    content = {name: {"run": made[name], "numbers": {}, "sha256": ""} for name in made}
    (tmp_path / "speeds.json").write_text(json.dumps(content), encoding="utf-8")
    assert runs.about_runs(["speeds"]).splitlines() == [
        "- `speeds`, 1 of 3: version 0.9, commit c0ffee01; 2026-01-02; Z80, load 0.2 of 1 cores; "
        "commit and day are those with which the numbers were committed.",
        "- `speeds`, 2 of 3: version 1.0, commit c0ffee01; 2026-01-02 to 2026-01-05; "
        "Z80, load 0.2 to 3.0 of 1 cores.",
    ]


def test_recorded_results_name_the_processor_and_no_path():
    for path in RESULTS.rglob("*.json"):
        text = path.read_text(encoding="utf-8")
        assert '"cpu": "' in text, path
        assert not re.search("/home/|/tmp/|/root/", text), path


def test_a_stale_page_is_noticed_and_rewritten(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(pages, "PAGES", {"page.md": pages.written})
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.setattr(pages, "TABLES", {"numbers": lambda: "| a |\n|---|\n| 2 |"})
    page = tmp_path / "page.md"
    table = "<!-- numbers -->\n| a |\n|---|\n| 1 |\n<!-- end -->"
    stale = f"Above.\n\n{table}\n\nBelow, <!-- a remark --> and more.\n"
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
    said = differences.answer(question, [])
    assert said == f"{question}: not measured yet, with two seeds or more."


def test_the_commands_of_the_thesis_table_train_the_recorded_networks():
    trained = []
    for command in f"{thesis.thesis_command()}\n{thesis.motions_command()}".splitlines():
        options = {part.split()[0]: part.split()[1:] for part in command.split(" --")[1:]}
        runs = runs_of(options["rows"], options["trained-on"], list(map(int, options["seeds"])))
        trained += [run.name for run in runs]
    recorded = [
        f"{network['row']}-{network['trained_on']}-seed{network['seed']}"
        for network in recorded_networks()
    ]
    assert sorted(trained) == sorted(recorded)


def rows_of(table):
    """The head of a Markdown table and its rows, as lists of cells."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table]
    return lines[0], lines[2:]


def test_every_difference_that_a_page_claims_holds_and_none_that_holds_is_left_out():
    """Read back from the tables of RESULTS.md, against the results."""
    recorded = recorded_table()["differences"]
    titles = {row.title: name for name, row in ROWS.items()}
    everything = (pages.ROOT / "experiments/RESULTS.md").read_text(encoding="utf-8")
    claimed = set()
    for question, lines in re.findall(
        r"^(.+): \d+ of \d+ differences hold\.\n\n((?:\|.*\n)+)", everything, re.MULTILINE
    ):
        head, rows = rows_of(lines.splitlines())
        for pair, trained_on, *means in rows:
            title, other = pair.split(" - ")
            for test, mean in zip(head[2:], means, strict=True):
                if mean:
                    column = f"{trained_on}/{test}"
                    claimed.add((question, titles[title], titles[other], column, mean))
    holding = {
        (d["question"], d["row"], d["against"], d["column"], signed(d["mean"]))
        for d in recorded
        if d["holm"] < 0.05
    }
    assert claimed == holding
    assert {question for question, *_ in claimed} <= set(QUESTIONS)


def test_the_thesis_question_is_answered_with_sign_and_interval_also_where_it_loses(monkeypatch):
    found = [
        difference("thesis-tnt", 0.1654, 0.049) | {"low": 0.1, "high": 0.2, "seeds": 3},
        difference("thesis-tnt", -0.02, 0.5, "1/all") | {"low": -0.1, "high": 0.06, "seeds": 3},
        difference("thesis-regress", -0.3, 0.01) | {"low": -0.4, "high": -0.2, "seeds": 2},
    ]
    monkeypatch.setattr(differences, "_differences", lambda: found)
    sentence, _, head, _, *rows = differences.thesis_answers().splitlines()
    assert sentence.startswith("Of 3 differences to the Baseline, 2 hold: gains 1, losses 1 (2 or")
    assert head.startswith("| tested on | TNT, all saccades | TNT+regress, all saccades | TNT, the")
    assert rows == [
        "| all |  |  | -.020 (-.100 to +.060) |  |",
        "| sim | **+.165** (+.100 to +.200) | **-.300** (-.400 to -.200) |  |  |",
    ]
    monkeypatch.setattr(differences, "_differences", lambda: [])
    assert "Not measured yet" in differences.thesis_answers()
