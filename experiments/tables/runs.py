"""The runs that made the results of a section: version, commit, day, machine and load."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from experiments.records.files import RESULTS, read_runs

SHOWN_DIGITS = 8
"""Number of digits of a commit that are shown."""


def about_runs(names: Sequence[str]) -> str:
    """A list of the runs of recorded results, in Markdown.

    Parameters
    ----------
    names : files in `RESULTS` without ".json", or folders.
    """
    lines = []
    for name in names:
        path = RESULTS / name
        runs = read_runs(path if path.is_dir() else path.with_suffix(".json"))
        for what_ran, same in groupby(sorted(runs, key=_what_ran), key=_what_ran):
            lines.append(f"- {_line(name, what_ran, list(same), len(runs))}")
    return "\n".join(lines)


def _what_ran(run: dict[str, Any]) -> tuple[str, str, str, bool]:
    """What runs of a line share: version, commit, processor, and whether they are older files."""
    return run["version"], run["commit"][:SHOWN_DIGITS], run["machine"]["cpu"], "note" in run


def _line(
    name: str, what_ran: tuple[str, str, str, bool], runs: list[dict[str, Any]], n: int
) -> str:
    """A line of runs of the same code on the same kind of machine.

    n : number of all runs of this result.
    """
    version, commit, cpu, is_older = what_ran
    parts = [f"`{name}`: version {version}, commit {commit}"]
    if len(runs) < n:
        parts[0] = f"`{name}`, {len(runs)} of {n}: version {version}, commit {commit}"
    days = sorted({run["date"].split()[0] for run in runs})
    parts.append(days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}")
    loads = sorted({run["machine"]["load_1min"] for run in runs})
    load = f"{loads[0]:.1f}" if len(loads) == 1 else f"{loads[0]:.1f} to {loads[-1]:.1f}"
    parts.append(f"{cpu}, load {load} of {runs[0]['machine']['cores']} cores")
    if is_older:
        parts.append("commit and day are those with which the numbers were committed")
    return "; ".join(parts) + "."
