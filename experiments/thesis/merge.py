"""The results of some rows of the table put into a file that has more: a day of training need not
be one run.

What was measured again replaces what is there: a row's numbers in a column, a difference, an
effect. p is adjusted again over all that a question then has. A difference from numbers that are
replaced is left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from experiments.thesis.numbers import holm, in_order
from experiments.thesis.rows import QUESTIONS, ROWS, TRAINED_ON

BY_NAME = "rows", "validation", "curves"
QUESTION = ("question", "row", "against", "column")
EFFECT = ("trained_on", "row", "effect")


def merged(there: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The record `there` with the results of `new`; neither is changed. Its settings and machine
    are those of `new`."""
    record = {**there, **new}
    record |= {name: {**there[name], **new[name]} for name in BY_NAME}
    for row in there["rows"].keys() & new["rows"].keys():
        # of what it is trained on
        motions = {**there["rows"][row]["motions"], **new["rows"][row]["motions"]}
        record["rows"][row] = {**record["rows"][row], "motions": motions}
    record["command"] = "; ".join(
        dict.fromkeys([*there["command"].split("; "), *new["command"].split("; ")])
    )
    record["seeds"] = sorted({*there["seeds"], *new["seeds"]})
    table = {row: there["table"].get(row, {}) | new["table"].get(row, {}) for row in ROWS}
    record["table"] = {row: {c: of[c] for c in in_order(of)} for row, of in table.items() if of}
    again = {(row, column) for row, of in new["table"].items() for column in of}
    kept = [
        d
        for d in there["differences"]
        if again.isdisjoint((d[r], d["column"]) for r in ("row", "against"))
    ]
    differences = _replaced(kept, new["differences"], QUESTION)
    columns = in_order(d["column"] for d in differences)
    names = [
        (question, *pair, c)
        for question, pairs in QUESTIONS.items()
        for pair in pairs
        for c in columns
    ]
    differences.sort(key=lambda d: names.index(tuple(d[name] for name in QUESTION)))
    questions = groupby(differences, key=lambda d: d["question"])
    record["differences"] = [
        d for _, of_question in questions for d in _adjusted(list(of_question))
    ]
    effects = _replaced(there["effects"], new["effects"], EFFECT)
    effects.sort(key=lambda e: (TRAINED_ON.index(e["trained_on"]), list(ROWS).index(e["row"])))
    record["effects"] = _adjusted(effects)
    return record


def _replaced(
    there: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]], names: tuple[str, ...]
) -> list[dict[str, Any]]:
    """All, those of `new` in the place of those with the same values of `names`."""
    return list({tuple(one[name] for name in names): one for one in (*there, *new)}.values())


def _adjusted(of_question: list[dict[str, Any]]) -> list[dict[str, Any]]:
    adjusted = holm([one["p"] for one in of_question])
    return [{**one, "holm": p} for one, p in zip(of_question, adjusted, strict=True)]
