"""The differences between rows of the thesis' experiment, and which of them hold.

A difference holds if it is significant at .05 by Holm's method among all differences of its
question. No table picks its differences: a table has all differences that hold, gains and losses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from experiments.tables.parts import table
from experiments.thesis.numbers import LEVEL, cell, in_order, signed
from experiments.thesis.rows import QUESTIONS, ROWS, SETS
from experiments.thesis.table import recorded_table

SHOWN_COLUMNS = ("all/all", "1/others", "all/sim", "1/sim", "all/bell", "1/bell")
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
    accuracies = recorded_table()["table"]
    held = {
        (difference["row"], difference["column"])
        for difference in _differences()
        if holds(difference)
    }
    shown_columns = [
        (trained_on, row) for trained_on in ("all", "1") for row in (BASELINE, *TRANSFORMED)
    ]

    body = []
    for name, (kind, is_dark) in SETS.items():
        cells = []
        for trained_on, row in shown_columns:
            column = f"{trained_on}/{name}"
            text = cell(accuracies.get(row, {}).get(column))
            cells.append(f"**{text}**" if (row, column) in held else text)
        colours = "dark on bright" if is_dark else "bright on dark"
        body.append([f"{name}: {kind}, {colours}", *cells])
    return table(
        ["tested on", *(f"{trained_on}: {ROWS[row].title}" for trained_on, row in shown_columns)],
        body,
    )


def effects() -> str:
    """A table of the effects of factors on the gain over the Baseline.

    Effects that hold are bold.
    """
    by_name: dict[str, dict[tuple[str, str], Difference]] = {}
    for effect in recorded_table()["effects"]:
        by_name.setdefault(effect["effect"], {})[effect["trained_on"], effect["row"]] = effect
    columns = list(dict.fromkeys(column for effect in by_name.values() for column in effect))
    if not columns:
        return "Not measured yet: effects need networks of two seeds."
    body = []
    for name, effect_by_column in by_name.items():
        body.append([name, *(_with_interval(effect_by_column[column]) for column in columns)])
    head = [
        "gain over the Baseline",
        *(f"{trained_on}: {ROWS[row].title}" for trained_on, row in columns),
    ]
    return table(head, body)


def differences() -> str:
    """A table of the differences of all pairs of all questions. Differences that hold are bold."""
    difference_by_pair = {
        (difference["row"], difference["against"], difference["column"]): difference
        for difference in _differences()
    }
    body = []
    for question, pairs in QUESTIONS.items():
        measured_pairs = [
            pair
            for pair in pairs
            if any((*pair, column) in difference_by_pair for column in SHOWN_COLUMNS)
        ]
        if measured_pairs:
            body.append([f"*{question}*", *[""] * len(SHOWN_COLUMNS)])
        for row, against in measured_pairs:
            cells = []
            for column in SHOWN_COLUMNS:
                difference = difference_by_pair.get((row, against, column))
                cells.append("-" if difference is None else _with_interval(difference))
            body.append([_pair(row, against), *cells])
    return table(["difference", *SHOWN_COLUMNS], body)


def conclusions() -> str:
    """All differences that hold, in a table for each question."""
    return "\n\n".join(answer(question, _differences()) for question in QUESTIONS)


def answer(question: str, measured: Sequence[Difference]) -> str:
    """A sentence on a question, and a table of its differences that hold.

    The table has a row for each pair and what it was trained on, and a column for each test.
    """
    question_differences = [
        difference for difference in measured if difference["question"] == question
    ]
    if not question_differences:
        return f"{question}: not measured yet, with two seeds or more."
    held = [difference for difference in question_differences if holds(difference)]
    sentence = f"{question}: {len(held)} of {len(question_differences)} differences hold."
    if not held:
        return sentence

    tests = list(dict.fromkeys(_test(column) for column in in_order(d["column"] for d in held)))
    means: dict[tuple[str, str, str], dict[str, str]] = {}
    for difference in held:
        trained_on = difference["column"].partition("/")[0]
        row_means = means.setdefault((difference["row"], difference["against"], trained_on), {})
        row_means[_test(difference["column"])] = signed(difference["mean"])
    body = [
        [_pair(row, against), trained_on, *(row_means.get(test, "") for test in tests)]
        for (row, against, trained_on), row_means in means.items()
    ]
    return f"{sentence}\n\n{table(['difference', 'trained on', *tests], body)}"


def thesis_answers() -> str:
    """A table of all differences between rows that transform events and the thesis' Baseline.

    The columns are the rows and what they were trained on; there is a line for each test. Each
    difference has its interval, and is bold if it holds. A sentence above counts those that hold,
    gains and losses.
    """
    to_baseline = [difference for difference in _differences() if difference["against"] == BASELINE]
    if not to_baseline:
        return "Not measured yet: a difference needs networks of two seeds."
    n_gains = sum(holds(difference) and difference["mean"] > 0 for difference in to_baseline)
    n_losses = sum(holds(difference) and difference["mean"] < 0 for difference in to_baseline)
    seeds = sorted({difference["seeds"] for difference in to_baseline})
    sentence = (
        f"Of {len(to_baseline)} differences to the Baseline, {n_gains + n_losses} hold: "
        f"gains {n_gains}, losses {n_losses} ({' or '.join(map(str, seeds))} seeds). All of "
        "them, with 95 % intervals, those that hold in bold:"
    )
    by_cell = {(difference["row"], difference["column"]): difference for difference in to_baseline}
    tests = list(
        dict.fromkeys(
            _test(column) for column in in_order(difference["column"] for difference in to_baseline)
        )
    )
    titles_of_training = {"all": "all saccades", "1": "the first saccade"}
    shown_columns = [(row, trained_on) for trained_on in titles_of_training for row in TRANSFORMED]
    body = []
    for test in tests:
        found = (by_cell.get((row, f"{trained_on}/{test}")) for row, trained_on in shown_columns)
        cells = ["" if difference is None else _with_interval(difference) for difference in found]
        body.append([test, *cells])
    head = [f"{ROWS[row].title}, {titles_of_training[on]}" for row, on in shown_columns]
    return f"{sentence}\n\n{table(['tested on', *head], body)}"


def holds(difference: Difference) -> bool:
    """Whether a difference holds among all differences of its question, by Holm's method."""
    adjusted: float = difference["holm"]
    return adjusted < LEVEL


def _differences() -> list[Difference]:
    """All differences of the recorded networks."""
    return list(recorded_table()["differences"])


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
