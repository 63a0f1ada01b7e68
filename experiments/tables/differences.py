"""The differences between rows of the thesis' experiment, and which of them hold.

A difference holds if it is significant at .05 by Holm's method among all differences of its
question. No table picks its differences: it has all that hold, gains and losses.
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
    """A table of the thesis' rows on each simulated set.

    An accuracy is bold if its difference to the Baseline holds.
    """
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
    """A table of the effects of factors on the gain over the Baseline. Those that hold are bold."""
    by_name: dict[str, dict[tuple[str, str], Difference]] = {}
    for found in results("table")["effects"]:
        by_name.setdefault(found["effect"], {})[found["trained_on"], found["row"]] = found
    columns = list(dict.fromkeys(column for found in by_name.values() for column in found))
    body = []
    for name, of_column in by_name.items():
        body.append([name, *(_with_interval(of_column[column]) for column in columns)])
    head = ["gain over the Baseline", *(f"{on}: {ROWS[row].title}" for on, row in columns)]
    return table(head, body)


def differences() -> str:
    """A table of the differences of every pair of every question. Those that hold are bold."""
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
    """All differences that hold, in a table for each question."""
    return "\n\n".join(answer(question, _differences()) for question in QUESTIONS)


def answer(question: str, measured: Sequence[Difference]) -> str:
    """A sentence on a question, and a table of its differences that hold.

    The table has a row for each pair and what it was trained on, and a column for each test.
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
    """A table of all differences to the thesis' Baseline on simulated sets that hold."""
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
    """Whether a difference holds among all differences of its question, by Holm's method."""
    adjusted: float = difference["holm"]
    return adjusted < LEVEL


def _differences() -> list[Difference]:
    """All recorded differences."""
    return list(results("table")["differences"])


def _test(column: str) -> str:
    """The test of a column, such as "sim" of "1/sim"."""
    return column.partition("/")[2]


def _pair(row: str, against: str) -> str:
    """The title of a difference: the titles of its two rows."""
    return f"{ROWS[row].title} - {ROWS[against].title}"


def _with_interval(difference: Difference) -> str:
    """The text of a difference, such as +.165 (+.064 to +.266). It is bold if it holds."""
    mean = signed(difference["mean"])
    shown = f"**{mean}**" if holds(difference) else mean
    return f"{shown} ({signed(difference['low'])} to {signed(difference['high'])})"
