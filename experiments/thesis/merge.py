"""Put the results of some rows of the table into a file that has more rows.

So a day of training can be several runs.

A result is a row's numbers in a column, a difference or an effect. A new result replaces the old
one. An old difference is left out if one of its numbers is replaced. Then p is adjusted again over
all differences of a question.
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


def merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The record `old` with the results of `new`. Neither record is changed.

    The settings and the machine are those of `new`.
    """
    record = {**old, **new}
    record |= {name: {**old[name], **new[name]} for name in BY_NAME}
    for row in old["rows"].keys() & new["rows"].keys():
        # one entry for each saccade that the row is trained on
        motions = {**old["rows"][row]["motions"], **new["rows"][row]["motions"]}
        record["rows"][row] = {**record["rows"][row], "motions": motions}

    commands = [*old["command"].split("; "), *new["command"].split("; ")]
    record["command"] = "; ".join(dict.fromkeys(commands))
    record["seeds"] = sorted({*old["seeds"], *new["seeds"]})
    record["table"] = {}
    for row in ROWS:
        columns = old["table"].get(row, {}) | new["table"].get(row, {})
        if columns:
            record["table"][row] = {column: columns[column] for column in in_order(columns)}

    record["differences"] = _merged_differences(old, new)
    effects = _replaced(old["effects"], new["effects"], EFFECT)
    effects.sort(key=lambda e: (TRAINED_ON.index(e["trained_on"]), list(ROWS).index(e["row"])))
    record["effects"] = _adjusted(effects)
    return record


def _merged_differences(old: dict[str, Any], new: dict[str, Any]) -> list[dict[str, Any]]:
    """The differences of both records by question, without old differences of replaced numbers."""
    replaced_numbers = {
        (row, column) for row, columns in new["table"].items() for column in columns
    }
    kept = []
    for difference in old["differences"]:
        column = difference["column"]
        if replaced_numbers.isdisjoint(
            {(difference["row"], column), (difference["against"], column)}
        ):
            kept.append(difference)
    differences = _replaced(kept, new["differences"], QUESTION)

    columns = in_order(difference["column"] for difference in differences)
    order: list[tuple[str, ...]] = []
    for question, pairs in QUESTIONS.items():
        for pair in pairs:
            order += [(question, *pair, column) for column in columns]
    differences.sort(key=lambda difference: order.index(_named(difference, QUESTION)))
    adjusted = []
    for _, question_differences in groupby(
        differences, key=lambda difference: difference["question"]
    ):
        adjusted += _adjusted(list(question_differences))
    return adjusted


def _replaced(
    old: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]], names: tuple[str, ...]
) -> list[dict[str, Any]]:
    """The results of `old` and of `new`.

    A result of `new` replaces the result of `old` that has the same values of `names`.
    """
    return list({_named(result, names): result for result in (*old, *new)}.values())


def _named(result: dict[str, Any], names: tuple[str, ...]) -> tuple[Any, ...]:
    """The values of some entries of a result."""
    return tuple(result[name] for name in names)


def _adjusted(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The differences of a question, or all effects, with p adjusted over all of them."""
    adjusted = holm([result["p"] for result in results])
    return [{**result, "holm": p} for result, p in zip(results, adjusted, strict=True)]
