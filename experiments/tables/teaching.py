"""Tables of digits that were taught to networks of the nine others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from experiments.tables.parts import of_report, percent, table

COMPARED = {"again": "everything again", "fine": "trained further"}
"""What taught networks are compared with: prefix of the entry -> title."""

NOT_MEASURED = "Not measured in this run."
"""What stands in the place of a table if a report has none of its entries."""


def _with(report: dict[str, Any], prefix: str) -> list[dict[str, Any]]:
    """The entries of a report whose names begin with a word."""
    return [entry for name, entry in report.items() if name.split(" ")[0] == prefix]


def _taught(entries: Iterable[dict[str, Any]], k: str, key: str) -> list[float]:
    """A score of each digit: its mean over draws."""
    return [float(np.mean([row[key] for row in entry["taught"][k]])) for entry in entries]


def _share(values: Iterable[float]) -> str:
    """A mean as text, such as .941."""
    return f"{np.mean(list(values)):.3f}".removeprefix("0")


def _cells(score: Callable[[str], list[float]]) -> list[str]:
    """Windows, and then recordings, as new / old / mean of ten."""
    cells = []
    for suffix in ("", "_recordings"):
        cells.append(" / ".join(_share(score(f"{key}{suffix}")) for key in ("new", "old", "mean")))
    return cells


@of_report("teaching")
def teaching(report: dict[str, Any]) -> str:
    """Windows and recordings right, by the number of recordings of the new class."""
    digits = _with(report, "without")
    if not digits:
        return NOT_MEASURED
    rows = []
    for k in digits[0]["taught"]:
        scores = _cells(lambda key, k=k: _taught(digits, k, key))  # type: ignore[misc]
        rows.append([f"taught, {k}", str(len(digits)), *scores])
        for prefix, title in COMPARED.items():
            others = [entry for entry in _with(report, prefix) if str(entry["k"]) == k]
            if others:
                named = {entry["digit"] for entry in others}
                same = [entry for entry in digits if entry["digit"] in named]
                scores = _cells(lambda key, o=others: [entry[key] for entry in o])  # type: ignore[misc]
                rows.append([f"{title}, {k}", str(len(others)), *scores])
                first = _cells(
                    lambda key, s=same, k=k: [entry["taught"][k][0][key] for entry in s]  # type: ignore[misc]
                )
                rows.append([f"taught, {k}, the same recordings", str(len(same)), *first])
    base = [
        f"- / {_share(entry['base']['old'] for entry in digits)} / -",
        f"- / {_share(entry['base']['old_recordings'] for entry in digits)} / -",
    ]
    head = ("way, recordings of the new class", "digits", "windows", "recordings")
    return table(head, [["network of nine", str(len(digits)), *base], *rows])


def _ways_of(entries: list[dict[str, Any]]) -> list[tuple[str, list[str]]]:
    """Pairs of a way and its cells, for the classes of a set that were left out."""
    base = [
        f"- / {_share(entry['base'][key] for entry in entries)} / -"
        for key in ("old", "old_recordings")
    ]
    ways = [("network without the class", base)]
    for k in entries[0]["taught"]:
        ways.append((f"taught, {k}", _cells(partial(_taught, entries, k))))
    most = str(entries[0]["again"]["k"])
    again = _cells(lambda key: [entry["again"][key] for entry in entries])
    ways.append((f"everything again, {most}", again))
    first = _cells(lambda key: [entry["taught"][most][0][key] for entry in entries])
    ways.append((f"taught, {most}, the same recordings", first))
    return ways


@of_report("teaching")
def teaching_others(report: dict[str, Any]) -> str:
    """Windows and recordings right on data sets beside N-MNIST; "" without them."""
    rows = []
    by_title: dict[str, list[dict[str, Any]]] = {}
    for entry in report.values():
        if "title" in entry:
            by_title.setdefault(entry["title"], []).append(entry)
    for title, entries in by_title.items():
        for way, cells in _ways_of(entries):
            rows.append([f"{title}: {way}", str(len(entries)), *cells])
    if not rows:
        return ""
    return table(("way, recordings of the new class", "classes", "windows", "recordings"), rows)


@of_report("teaching")
def teaching_by_digit(report: dict[str, Any]) -> str:
    """Windows of each digit that was left out, and of the nine others."""
    if not _with(report, "without"):
        return NOT_MEASURED
    rows = []
    for entry in sorted(_with(report, "without"), key=lambda entry: str(entry["digit"])):
        row = [entry["digit"], _share([entry["base"]["old"]])]
        for k in entry["taught"]:
            new = _share(_taught([entry], k, "new"))
            old = _share(_taught([entry], k, "old"))
            row.append(f"{new} / {old}")
        rows.append(row)
    counts = _with(report, "without")[0]["taught"]
    return table(("digit", "the nine alone", *(f"{k}: new / old" for k in counts)), rows)


@of_report("teaching")
def teaching_costs(report: dict[str, Any]) -> str:
    """What a taught class takes of others, how sure it is, and how long teaching takes."""
    digits = _with(report, "without")
    if not digits:
        return NOT_MEASURED
    base = [
        "network of nine",
        f"- / {_share(entry['base']['old_early'] for entry in digits)}",
        "-",
        "-",
        percent(float(np.mean([entry["base"]["sure_of_nothing"] for entry in digits]))),
        "-",
        _share(entry["base"]["calibration_error"] for entry in digits),
        "-",
    ]
    rows = [base]
    for k in digits[0]["taught"]:
        early = " / ".join(_share(_taught(digits, k, f"{key}_early")) for key in ("new", "old"))
        shares = [
            percent(float(np.mean(_taught(digits, k, key))))
            for key in ("told", "taken", "sure_of_nothing", "nothing_taken")
        ]
        error = _share(_taught(digits, k, "calibration_error"))
        seconds = f"{np.mean(_taught(digits, k, 'seconds')):.2f} s"
        rows.append([f"taught, {k}", early, *shares, error, seconds])
    head = (
        "",
        "before the end: new / old",
        "taken of the nine, told",
        "counted",
        "sure of nothing",
        "nothing called the new class",
        "calibration error",
        "processor time",
    )
    return table(head, rows)


@of_report("teaching")
def teaching_settings(report: dict[str, Any]) -> str:
    """Windows of held-out recordings of Train with other settings."""
    entries = _with(report, "settings")
    if not entries:
        return NOT_MEASURED
    rows = []
    for i, setting in enumerate(entries[0]["rows"]):
        name = ", ".join(
            f"{key} {setting[key]:g}" for key in ("ridge", "share", "margin", "components")
        )
        cells = []
        for k in setting["scores"]:
            found = [entry["rows"][i]["scores"][k] for entry in entries]
            new = _share(one["new"] for one in found)
            cells.append(f"{new} / {_share(one['old'] for one in found)}")
        rows.append([name, *cells])
    counts = entries[0]["rows"][0]["scores"]
    return table(("setting", *(f"{k}: new / old" for k in counts)), rows)
