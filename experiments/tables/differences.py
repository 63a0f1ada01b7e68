"""The differences between rows of the thesis' experiment, and which of them hold.

No table picks its differences: it has all of a question that hold by Holm's method, gains and
losses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from experiments.tables.parts import results, table
from experiments.thesis.numbers import LEVEL, cell, in_order, signed
from experiments.thesis.rows import QUESTIONS, ROWS, SETS

DIFFERENCES = ("all/all", "1/others", "all/sim", "1/sim", "all/bell", "1/bell")
"""Columns of the table `differences`, each as "trained on/tested on"."""

BASELINE = "thesis-baseline"
"""The thesis' row that its other rows are compared with."""

TRANSFORMED = ("thesis-tnt", "thesis-regress")
"""The thesis' rows that transform events."""

Difference = dict[str, Any]
"""A difference as `thesis.numbers.differences` makes it: "question", "row", "against", "column",
"mean", "low", "high" and "holm"."""


def thesis_sets() -> str:
    """The thesis' rows on each simulated set; bold where the difference to the Baseline holds."""
    accuracies = results("table")["table"]
    held = {
        (difference["row"], difference["column"])
        for difference in _differences()
        if holds(difference)
    }
    shown = [(on, row) for on in ("all", "1") for row in (BASELINE, *TRANSFORMED)]

    body = []
    for name, (kind, dark) in SETS.items():
        cells = []
        for on, row in shown:
            column = f"{on}/{name}"
            text = cell(accuracies.get(row, {}).get(column))
            cells.append(f"**{text}**" if (row, column) in held else text)
        colours = "dark on bright" if dark else "bright on dark"
        body.append([f"{name}: {kind}, {colours}", *cells])
    return table(["tested on", *(f"{on}: {ROWS[row].title}" for on, row in shown)], body)


def effects() -> str:
    """What the gain over the Baseline depends on; bold where it holds."""
    found = results("table")["effects"]
    columns = list(
        dict.fromkeys((found_effect["trained_on"], found_effect["row"]) for found_effect in found)
    )
    body = []
    for effect in dict.fromkeys(found_effect["effect"] for found_effect in found):
        of_effect = {
            (found_effect["trained_on"], found_effect["row"]): found_effect
            for found_effect in found
            if found_effect["effect"] == effect
        }
        body.append([effect, *(_with_interval(of_effect[column]) for column in columns)])
    head = ["gain over the Baseline", *(f"{on}: {ROWS[row].title}" for on, row in columns)]
    return table(head, body)


def differences() -> str:
    """Every pair of every question; bold where the difference holds."""
    found = {
        (difference["row"], difference["against"], difference["column"]): difference
        for difference in _differences()
    }
    body = []
    for question, pairs in QUESTIONS.items():
        known = [pair for pair in pairs if any((*pair, column) in found for column in DIFFERENCES)]
        if known:
            body.append([f"*{question}*", *[""] * len(DIFFERENCES)])
        for row, against in known:
            cells = []
            for column in DIFFERENCES:
                difference = found.get((row, against, column))
                cells.append("-" if difference is None else _with_interval(difference))
            body.append([_pair(row, against), *cells])
    return table(["difference", *DIFFERENCES], body)


def conclusions() -> str:
    """All that holds, a table for each question."""
    return "\n\n".join(answer(question, _differences()) for question in QUESTIONS)


def answer(question: str, measured: Sequence[Difference]) -> str:
    """A table of a question's differences that hold.

    It has a row for each pair and what it was trained on, and a column for each test.
    """
    asked = [difference for difference in measured if difference["question"] == question]
    if not asked:
        return f"{question}: not measured yet."
    held = [difference for difference in asked if holds(difference)]
    sentence = f"{question}: {len(held)} of {len(asked)} differences hold."
    if not held:
        return sentence

    tests = list(dict.fromkeys(_test(column) for column in in_order(d["column"] for d in held)))
    means: dict[tuple[str, str, str], dict[str, str]] = {}
    for difference in held:
        trained_on = difference["column"].partition("/")[0]
        of_row = means.setdefault((difference["row"], difference["against"], trained_on), {})
        of_row[_test(difference["column"])] = signed(difference["mean"])
    body = [
        [_pair(row, against), trained_on, *(of_row.get(test, "") for test in tests)]
        for (row, against, trained_on), of_row in means.items()
    ]
    return f"{sentence}\n\n{table(['difference', 'trained on', *tests], body)}"


def thesis_answers() -> str:
    """The thesis' own question on the simulated sets: all that holds."""
    asked = [
        difference
        for difference in _differences()
        if difference["against"] == BASELINE and _test(difference["column"]) in SETS
    ]
    means = {
        (difference["row"], difference["column"]): signed(difference["mean"])
        for difference in asked
        if holds(difference)
    }
    shown = {"all": "all saccades", "1": "the first saccade"}

    body = []
    for name in SETS:
        cells = [means.get((row, f"{on}/{name}"), "") for on in shown for row in TRANSFORMED]
        if any(cells):
            body.append([name, *cells])
    titles = [f"{ROWS[row].title}, {words}" for words in shown.values() for row in TRANSFORMED]
    sentence = (
        f"Of {len(asked)} differences to the Baseline on simulated sets these hold. Columns: the "
        "row and what it was trained on."
    )
    return f"{sentence}\n\n{table(['simulated set', *titles], body)}"


def holds(difference: Difference) -> bool:
    """Whether a difference holds among all of its question, by Holm's method."""
    adjusted: float = difference["holm"]
    return adjusted < LEVEL


def _differences() -> list[Difference]:
    return list(results("table")["differences"])


def _test(column: str) -> str:
    """Return "sim" of the column "1/sim"."""
    return column.partition("/")[2]


def _pair(row: str, against: str) -> str:
    return f"{ROWS[row].title} - {ROWS[against].title}"


def _with_interval(difference: Difference) -> str:
    """A difference and its interval, such as +.165 (+.064 to +.266); bold where it holds."""
    mean = signed(difference["mean"])
    shown = f"**{mean}**" if holds(difference) else mean
    return f"{shown} ({signed(difference['low'])} to {signed(difference['high'])})"
