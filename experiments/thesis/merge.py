"""Put the results of some rows of the table into a file that has more rows.

So a day of training can be several runs.

A new result replaces the old one: a row's numbers in a column, a difference, an effect. An old
difference is left out if one of its numbers is replaced. p is adjusted again over all differences
that a question then has.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from experiments.thesis.numbers import holm, in_order
from experiments.thesis.rows import QUESTIONS, ROWS, TRAINED_ON

BY_NAME = ("rows", "validation", "curves")
"""Parts of a record that have an entry for each row or network."""

QUESTION = ("question", "row", "against", "column")
"""Entries that identify a difference."""

EFFECT = ("trained_on", "row", "effect")
"""Entries that identify an effect."""


def merged(there: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The record `there` with the results of `new`. Neither of the two is changed.

    The settings and the machine are those of `new`.
    """
    record = {**there, **new}
    record |= {name: {**there[name], **new[name]} for name in BY_NAME}
    for row in there["rows"].keys() & new["rows"].keys():
        # one entry for each saccade that the row is trained on
        motions = {**there["rows"][row]["motions"], **new["rows"][row]["motions"]}
        record["rows"][row] = {**record["rows"][row], "motions": motions}

    commands = [*there["command"].split("; "), *new["command"].split("; ")]
    record["command"] = "; ".join(dict.fromkeys(commands))
    record["seeds"] = sorted({*there["seeds"], *new["seeds"]})
    record["table"] = {}
    for row in ROWS:
        columns = there["table"].get(row, {}) | new["table"].get(row, {})
        if columns:
            record["table"][row] = {column: columns[column] for column in in_order(columns)}

    record["differences"] = _merged_differences(there, new)
    effects = _replaced(there["effects"], new["effects"], EFFECT)
    effects.sort(key=lambda e: (TRAINED_ON.index(e["trained_on"]), list(ROWS).index(e["row"])))
    record["effects"] = _adjusted(effects)
    return record


def _merged_differences(there: dict[str, Any], new: dict[str, Any]) -> list[dict[str, Any]]:
    """The differences of both records by question, without old ones of replaced numbers."""
    again = {(row, column) for row, columns in new["table"].items() for column in columns}
    kept = []
    for difference in there["differences"]:
        column = difference["column"]
        if again.isdisjoint({(difference["row"], column), (difference["against"], column)}):
            kept.append(difference)
    differences = _replaced(kept, new["differences"], QUESTION)

    columns = in_order(difference["column"] for difference in differences)
    order: list[tuple[str, ...]] = []
    for question, pairs in QUESTIONS.items():
        for pair in pairs:
            order += [(question, *pair, column) for column in columns]
    differences.sort(key=lambda difference: order.index(_named(difference, QUESTION)))
    adjusted = []
    for _, of_question in groupby(differences, key=lambda difference: difference["question"]):
        adjusted += _adjusted(list(of_question))
    return adjusted


def _replaced(
    there: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]], names: tuple[str, ...]
) -> list[dict[str, Any]]:
    """The results of `there` and of `new`.

    A result of `new` replaces the result of `there` with the same values of `names`.
    """
    return list({_named(result, names): result for result in (*there, *new)}.values())


def _named(result: dict[str, Any], names: tuple[str, ...]) -> tuple[Any, ...]:
    """The values of some entries of a result."""
    return tuple(result[name] for name in names)


def _adjusted(of_question: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The differences of a question, or all effects, with p adjusted over all of them."""
    adjusted = holm([difference["p"] for difference in of_question])
    return [{**difference, "holm": p} for difference, p in zip(of_question, adjusted, strict=True)]
