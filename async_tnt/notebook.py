"""What notebooks show of an object: a small HTML table."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

LONGEST = 300  # of a text, such as a list of names


def html_table(rows: Mapping[str, str | float]) -> str:
    """A row for each name with its text, or with a bar for a number from 0 to 1. Any text is shown as it is."""
    cells = [f"<tr><th>{escape(name[:LONGEST])}</th><td>{_cell(value)}</td></tr>" for name, value in rows.items()]
    return f"<table>{''.join(cells)}</table>"


def _cell(value: str | float) -> str:
    if isinstance(value, float):
        return f'<meter value="{value:.4f}"></meter> {value:.1%}'
    return escape(value[:LONGEST])
