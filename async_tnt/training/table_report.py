"""The table as text: for the terminal, and as Markdown for a page."""

from __future__ import annotations

from typing import Any

from async_tnt.training.table_rows import COLUMNS, ROWS


def text_table(table: dict[str, Any]) -> str:
    """The table in columns of plain text; the thesis' numbers stand below ours."""
    lines = [f"{'':<32}" + "".join(f"{column:>16}" for column in COLUMNS)]
    for name, columns in table.items():
        row = ROWS[name]
        lines.append(f"{row.title.replace('`', ''):<32}" + "".join(f"{_cell(columns.get(c)):>16}" for c in COLUMNS))
        if row.thesis:
            lines.append(f"{'  the thesis':<32}" + "".join(f"{number:>16.3f}" for number in row.thesis))
    return "\n".join(lines)


def markdown_table(table: dict[str, Any]) -> str:
    """The table in Markdown; the thesis' numbers stand in brackets behind ours."""
    lines = ["| | " + " | ".join(COLUMNS) + " |", "|---" * (1 + len(COLUMNS)) + "|"]
    for name, columns in table.items():
        row = ROWS[name]
        cells = []
        for place, column in enumerate(COLUMNS):
            thesis = f" ({_short(row.thesis[place])})" if row.thesis else ""
            cells.append(_cell(columns.get(column)) + thesis)
        lines.append(f"| {row.title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def motions_table(table: dict[str, Any], column: str) -> str:
    """A column's accuracies by motion, in Markdown: a line for each motion, mean over the seeds."""
    rows = {name: columns[column]["per_motion"] for name, columns in table.items() if column in columns}
    lines = ["| motion | " + " | ".join(ROWS[name].title for name in rows) + " |", "|---" * (1 + len(rows)) + "|"]
    for motion in next(iter(rows.values()), {}):
        lines.append(f"| {motion} | " + " | ".join(_short(motions[motion]["mean"]) for motions in rows.values()) + " |")
    return "\n".join(lines)


def _cell(part: dict[str, Any] | None) -> str:
    """.957 ± .004, or a dash where nothing was measured."""
    if part is None:
        return "-"
    deviation = "" if part["deviation"] is None else f" ± {_short(part['deviation'])}"
    return _short(part["mean"]) + deviation


def _short(number: float) -> str:
    return f"{number:.3f}".removeprefix("0")
