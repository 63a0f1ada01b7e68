"""The table's numbers: accuracies brought together over seeds, paired differences, and both as text and Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from experiments.table_rows import COLUMNS, DIFFERENCES, GROUPS, ROWS, THESIS

T_975 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)
"""Student's t, 97.5 %, with 1 to 9 degrees of freedom; for more, the last one, which is a little too wide."""


def aggregate(runs: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Row -> column -> mean, standard deviation and each seed's accuracy; the same for each motion.

    Parameters
    ----------
    runs : results of `table_runs.run_network`.

    Returns
    -------
    {row: {column: {"mean", "deviation", "seeds": {seed: accuracy}, "windows", "per_motion": {motion: {"mean",
    "deviation"}}}}}, with the rows and columns that occur, in the table's order. The deviation is the sample's (n - 1),
    None for a single seed.
    """
    runs = sorted(runs, key=lambda run: int(run["seed"]))
    columns = list(dict.fromkeys([*COLUMNS, *(column for run in runs for column in run["columns"])]))
    table: dict[str, Any] = {}
    for row in ROWS:
        for column in columns:
            found = {
                run["seed"]: run["columns"][column] for run in runs if run["row"] == row and column in run["columns"]
            }
            if not found:
                continue
            seeds = {str(seed): part["accuracy"] for seed, part in found.items()}
            some = next(iter(found.values()))
            table.setdefault(row, {})[column] = {
                **summary(list(seeds.values())),
                "seeds": seeds,
                "windows": some["windows"],
                "per_motion": {
                    m: summary([part["per_motion"][m] for part in found.values()]) for m in some["per_motion"]
                },
            }
    return table


def summary(values: Sequence[float]) -> dict[str, float | None]:
    """Mean and sample deviation (n - 1), for `cell`."""
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1)) if len(values) > 1 else None}


def differences(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Differences of the pairs in `DIFFERENCES`, seed by seed, in each column that both rows have.

    Returns
    -------
    Of each: "row", "against", "column", "seeds" (how many), "mean", and "low" and "high", the 95 % interval of the mean
    by Student's t. Two seeds at least.
    """
    found = []
    for row, against in DIFFERENCES:
        columns = table.get(row, {})
        for column, part in columns.items():
            other = table.get(against, {}).get(column, {"seeds": {}})
            values = [part["seeds"][seed] - other["seeds"][seed] for seed in part["seeds"] if seed in other["seeds"]]
            if len(values) < 2:
                continue
            mean = float(np.mean(values))
            half = T_975[min(len(values) - 1, len(T_975)) - 1] * float(np.std(values, ddof=1)) / len(values) ** 0.5
            ends = {"low": mean - half, "high": mean + half}
            found.append({"row": row, "against": against, "column": column, "seeds": len(values), "mean": mean, **ends})
    return found


def text_table(table: dict[str, Any]) -> str:
    """The table in columns of plain text, a part for each group; the thesis' numbers are below ours."""
    lines = []
    for group in GROUPS:
        rows, columns = _part(table, group)
        headings = [column.replace("confounded", "conf.") for column in columns]

        def line(title: str, cells: Sequence[str], headings: Sequence[str] = headings) -> str:
            widths = (max(16, len(heading) + 2) for heading in headings)
            return f"{title:<40}" + "".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))

        if rows:
            lines += ["", line(group, headings)]
        for row in rows:
            title = "  " + ROWS[row].title.replace("`", "")
            lines.append(line(title, [cell(table[row].get(c)) for c in columns]))
            if row in THESIS:
                numbers = [short(THESIS[row][c]) if c in THESIS[row] else "" for c in columns]
                lines.append(line("    in the thesis", numbers))
    return "\n".join(lines[1:])


def markdown_table(table: dict[str, Any], group: str) -> str:
    """The rows of a group in Markdown; the thesis' numbers follow in brackets."""
    rows, columns = _part(table, group)
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (1 + len(columns)) + "|"]
    for row in rows:
        cells = []
        for column in columns:
            thesis = THESIS.get(row, {}).get(column)
            cells.append(cell(table[row].get(column)) + ("" if thesis is None else f" ({short(thesis)})"))
        lines.append(f"| {ROWS[row].title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _part(table: dict[str, Any], group: str) -> tuple[list[str], list[str]]:
    """The rows of a group and their columns: those of `COLUMNS`, and of other simulated sets."""
    rows = [row for row in table if row in ROWS and ROWS[row].group == group]
    found = dict.fromkeys(column for row in rows for column in table[row])
    return rows, [*(c for c in COLUMNS if c in found), *(c for c in found if c not in COLUMNS)]


def cell(part: dict[str, Any] | None) -> str:
    """.957 ± .004, or a dash where nothing was measured."""
    if part is None:
        return "-"
    deviation = "" if part["deviation"] is None else f" ± {short(part['deviation'])}"
    return short(part["mean"]) + deviation


def short(number: float) -> str:
    """.957"""
    return f"{number:.3f}".replace("0.", ".", 1)
