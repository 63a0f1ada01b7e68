"""Parts of all tables: reading of recorded results, Markdown, and the text of numbers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any

from experiments.records.files import RESULTS, read_numbers

Table = Callable[..., str]
"""A function that makes a table in Markdown."""

REPORT_OF: dict[Table, str] = {}
"""Table -> the recorded run that it is made of, without ".json"."""


def results(name: str) -> dict[str, Any]:
    """The numbers of the recorded run `name`, see `records.files.read_numbers`."""
    return read_numbers(RESULTS / f"{name}.json")


def of_report(name: str) -> Callable[[Callable[[Any], str]], Table]:
    """A decorator for functions that make a table of a report.

    If a function is called without a report, it takes the recorded run `name`.
    """

    def decorated(make: Callable[[Any], str]) -> Table:
        @functools.wraps(make)
        def made(report: dict[str, Any] | None = None) -> str:
            return make(results(name) if report is None else report)

        REPORT_OF[made] = name
        return made

    return decorated


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    cells = [list(head), *map(list, rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    lines.insert(1, "|---" * len(cells[0]) + "|")
    return "\n".join(lines)


def short(value: float) -> str:
    """The text of a number, such as 11.3 or 1,024."""
    return f"{value:.1f}" if value < 20 else f"{value:,.0f}"


def percent(share: float) -> str:
    """The text of a share, such as 99.2 %."""
    return f"{100 * share:.1f} %"


def about_machine(*reports: dict[str, Any], threads: str = "one thread") -> str:
    """A sentence on the machine of reports: processor, threads, load and versions.

    All reports must be from one machine; their loads may differ.

    threads : how many threads or processes worked.
    """
    settings = reports[0]["machine"]
    loads = sorted({report["machine"]["load_1min"] for report in reports})
    load = f"{loads[0]}" if len(loads) == 1 else f"{loads[0]} to {loads[-1]}"

    names = {
        "torch": "torch",
        "onnxruntime": "onnxruntime",
        "openvino": "OpenVINO",
        "eventcv": "eventcv",
    }
    versions = [
        f"Python {settings['python']}",
        f"NumPy {settings['numpy']}",
        f"Numba {settings['numba']}",
        *(f"{title} {settings[name]}" for name, title in names.items() if settings.get(name)),
    ]
    return f"{settings['cpu']}, {threads}, load {load}; {', '.join(versions)}."
