"""The numbers of the thesis' table: means over seeds, differences of rows, and tables of them.

Differences are taken seed by seed and digit by digit. Both are drawn at random: other seeds and
other digits would give other numbers. With d the (S, I) differences of S seeds and I digits, the
variance of their mean is estimated by

    var_seeds(mean of d over digits) / S + var_digits(mean of d over seeds) / I

A bootstrap that draws seeds and digits independently has this variance, if both are many (Owen
2007, The Pigeonhole Bootstrap, arXiv:0712.1111). Because seeds are few, intervals and p are
Student's, with Satterthwaite's degrees of freedom. All differences of a question, in all of its
columns, are tested together by Holm's method. We claim the differences that hold at .05.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.thesis.rows import COLUMNS, FOREIGN, QUESTIONS, ROWS, SETS, THESIS

Right = Mapping[tuple[str, str], Mapping[int, np.ndarray]]
"""(row, column) -> seed -> which windows are right: int8, (motions, digits). 1 is right, 0 is
wrong, and -1 means that the digit has no window in the motion."""

LEVEL = 0.05
"""Level of significance of Holm's method."""

UNDRAWN = (*tuple(SETS)[1:], FOREIGN)
"""Sets whose accuracies by motion are in no figure. They are left out of the results."""


def aggregate(runs: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The accuracies of each row and column over its seeds.

    Parameters
    ----------
    runs : results of `runs.run_network`.

    Returns
    -------
    {row: {column: {"mean", "deviation", "seeds": {seed: accuracy}, "windows", "per_motion":
    {motion: mean}, "against_time_ms": {ms: mean}}}}. Rows and columns are those that occur, in the
    table's order. The motions of sets in `UNDRAWN` are left out. The deviation is the sample's
    (n - 1); it is None for a single seed.
    """
    runs = sorted(runs, key=lambda run: int(run["seed"]))
    table: dict[str, Any] = {}
    for row in ROWS:
        row_runs = [run for run in runs if run["row"] == row]
        for column in in_order(column for run in row_runs for column in run["columns"]):
            results_by_seed = {
                run["seed"]: run["columns"][column] for run in row_runs if column in run["columns"]
            }
            first = next(iter(results_by_seed.values()))
            is_drawn = column.split("/")[1] not in UNDRAWN
            per_motion = _means(results_by_seed, "per_motion") if is_drawn else {}
            table.setdefault(row, {})[column] = {
                **summary([part["accuracy"] for part in results_by_seed.values()]),
                "seeds": {str(seed): part["accuracy"] for seed, part in results_by_seed.items()},
                "windows": first["windows"],
                "per_motion": per_motion,
                "against_time_ms": _means(results_by_seed, "against_time_ms"),
            }
    return table


def _means(results_by_seed: Mapping[int, dict[str, Any]], name: str) -> dict[str, float]:
    """The mean over the seeds of each entry in the dictionary `name` of the results."""
    parts = [part[name] for part in results_by_seed.values()]
    return {entry: round(float(np.mean([part[entry] for part in parts])), 5) for entry in parts[0]}


def in_order(columns: Iterable[str]) -> list[str]:
    """Columns, each once, in the table's order: tests on recordings, then simulated sets."""
    wanted = set(columns)
    trained_on = dict.fromkeys(column.split("/")[0] for column in COLUMNS)
    order = [*COLUMNS, *(f"{on}/{name}" for name in (*SETS, FOREIGN) for on in trained_on)]
    return [column for column in order if column in wanted]


def summary(values: Sequence[float]) -> dict[str, float | None]:
    """Mean and sample deviation (n - 1) of numbers, which `cell` makes into text."""
    return {
        "mean": float(np.mean(values)),
        "deviation": float(np.std(values, ddof=1)) if len(values) > 1 else None,
    }


def shares(right: np.ndarray) -> np.ndarray:
    """The share of each digit's windows that are right, shape (digits,).

    right : (motions, digits), see `Right`.
    """
    has_window = right >= 0
    return np.where(has_window, right, 0).sum(0) / has_window.sum(0)


def interval(values: np.ndarray) -> dict[str, float]:
    """The mean of differences (S, I), with its interval and p.

    There are S seeds and I digits, at least two each. The dict has "mean", its 95 % interval
    from "low" to "high", and "p".
    """
    # imported here, because scripts that only print tables need no SciPy
    from scipy import stats

    mean = float(values.mean())
    # The variance of the mean has two parts. The mean over the seeds, axis 0, leaves that of the
    # digits. The mean over the digits, axis 1, leaves that of the seeds.
    sizes = [values.shape[1], values.shape[0]]
    parts = [values.mean(axis).var(ddof=1) / sizes[axis] for axis in (0, 1)]
    error = float(sum(parts)) ** 0.5
    if error == 0.0:
        return {"mean": mean, "low": mean, "high": mean, "p": float(mean == 0.0)}
    # Satterthwaite's degrees of freedom
    degrees_of_freedom = error**4 / sum(
        part**2 / (n - 1) for part, n in zip(parts, sizes, strict=True)
    )
    half = float(stats.t.ppf(0.975, degrees_of_freedom)) * error
    p = float(2 * stats.t.sf(abs(mean) / error, degrees_of_freedom))
    return {"mean": mean, "low": mean - half, "high": mean + half, "p": p}


def differences(right: Right) -> list[dict[str, Any]]:
    """The differences of the pairs in `QUESTIONS`, with their intervals.

    A pair has a difference in each column in which both rows have at least two seeds in common.

    Returns
    -------
    Dictionaries with "question", "row", "against", "column", "seeds" (how many), what `interval`
    gives, and "holm": p adjusted for all differences of the question.
    """
    all_differences: list[dict[str, Any]] = []
    for question, pairs in QUESTIONS.items():
        question_differences: list[dict[str, Any]] = []
        for row, against in pairs:
            for column in in_order(column for name, column in right if name == row):
                row_right = right[row, column]
                other_right = right.get((against, column), {})
                seeds = [seed for seed in row_right if seed in other_right]
                if len(seeds) > 1:
                    values = np.stack(
                        [shares(row_right[seed]) - shares(other_right[seed]) for seed in seeds]
                    )
                    names = {"question": question, "row": row, "against": against, "column": column}
                    question_differences.append({**names, "seeds": len(seeds), **interval(values)})
        adjusted = holm([difference["p"] for difference in question_differences])
        for difference, p in zip(question_differences, adjusted, strict=True):
            difference["holm"] = p
        all_differences += question_differences
    return all_differences


def holm(p: Sequence[float]) -> list[float]:
    """The adjusted p of several hypotheses (Holm 1979).

    All hypotheses whose adjusted p is below a level can be rejected together at that level.

    Examples
    --------
    >>> holm([0.04, 0.01, 0.03])
    [0.06, 0.03, 0.06]
    """
    adjusted = [0.0] * len(p)
    least = 0.0
    for k, i in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        least = max(least, min(1.0, (len(p) - k) * p[i]))
        adjusted[i] = least
    return adjusted


def markdown_table(
    table: dict[str, Any],
    groups: Sequence[str],
    columns: Sequence[str] = (),
    *,
    with_networks: bool = False,
) -> str:
    """A table in Markdown of the rows of some groups, in some columns or in all.

    The thesis' numbers follow in brackets.

    with_networks : whether a column has the number of networks.
    """
    rows = [row for group in groups for row in table if row in ROWS and ROWS[row].group == group]
    if not rows:
        return "Not measured yet."
    columns = columns or in_order(column for row in rows for column in table[row])
    head = ["networks", *columns] if with_networks else columns
    lines = ["| | " + " | ".join(head) + " |", "|---" * (1 + len(head)) + "|"]
    for row in rows:
        cells = [networks_of(table[row])] if with_networks else []
        for column in columns:
            thesis = THESIS.get(row, {}).get(column)
            cells.append(
                cell(table[row].get(column)) + ("" if thesis is None else f" ({short(thesis)})")
            )
        lines.append(f"| {ROWS[row].title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def networks_of(columns: Mapping[str, Any]) -> str:
    """The text of the number of networks of a row of `aggregate`, such as 3.

    If the numbers differ by what the networks are trained on, it is such as 2 (all), 3 (1).
    """
    numbers: dict[str, int] = {}
    for column, part in columns.items():
        trained_on = column.partition("/")[0]
        numbers[trained_on] = max(numbers.get(trained_on, 0), len(part["seeds"]))
    if len(set(numbers.values())) == 1:
        return str(next(iter(numbers.values())))
    return ", ".join(f"{n} ({trained_on})" for trained_on, n in numbers.items())


def cell(part: dict[str, Any] | None) -> str:
    """The text of an accuracy, such as .957 ± .004. It is a dash if nothing was measured."""
    if part is None:
        return "-"
    deviation = "" if part["deviation"] is None else f" ± {short(part['deviation'])}"
    return short(part["mean"]) + deviation


def short(number: float) -> str:
    """The text of a number, such as .957."""
    return f"{number:.3f}".replace("0.", ".", 1)


def with_range(numbers: Sequence[float]) -> str:
    """The text of the mean of numbers and their range, such as .957 (.951 to .963).

    A single number has no range.
    """
    mean = short(float(np.mean(numbers)))
    if len(numbers) == 1:
        return mean
    return f"{mean} ({short(min(numbers))} to {short(max(numbers))})"


def signed(number: float) -> str:
    """The text of a number with its sign, such as +.165."""
    return f"{number:+.3f}".replace("0.", ".", 1)
