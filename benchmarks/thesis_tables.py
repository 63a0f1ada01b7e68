"""The tables of the thesis' experiment, all from one run of `async-tnt table`, and what follows from them.

A sentence about a difference is written by `more` or `less`, which refuse one whose interval holds zero.
"""

from __future__ import annotations

from typing import Any

from page_parts import results, table

from async_tnt.simulation.statistics import UNITS
from async_tnt.training.table import markdown_table, short
from async_tnt.training.table_rows import DIFFERENCES, INPUTS, ROWS

GUESS = 0.1
"""The accuracy of guessing among ten digits."""


def accuracy_of(row: str, column: str) -> float:
    """A row's mean over seeds."""
    return float(results("table")["table"][row][column]["mean"])


def comparison() -> str:
    """With what a network would have that knows the motion it saw, and guesses in others."""
    known = results("table")["table"]["raw"]["1/all"]["per_motion"]["saccade 1"]["mean"]
    lines = markdown_table(results("table")["table"], "comparison").splitlines()
    columns = lines[0].strip("| ").split(" | ")
    guessed = {"1/all": (known + 2 * GUESS) / 3, "1/others": GUESS, "1/train": (known + 2 * GUESS) / 3, "1/sim": GUESS}
    cells = [short(guessed[column]) if column in guessed else "" for column in columns]
    return "\n".join([*lines[:2], "| *guessing in other motions* | " + " | ".join(cells) + " |", *lines[2:]])


def thesis_rows() -> str:
    return markdown_table(results("table")["table"], "thesis")


def resynthesis() -> str:
    return markdown_table(results("table")["table"], "motions")


def differences() -> str:
    """Differences between rows of the comparison, of the networks trained on the first saccade."""
    columns = ("1/others", "1/sim", "all/sim")
    found = {(d["row"], d["against"], d["column"]): d for d in results("table")["differences"]}
    rows = []
    for row, against in DIFFERENCES:
        if ROWS[row].group == "comparison":
            cells = [_difference(found.get((row, against, column))) for column in columns]
            rows.append([ROWS[row].title, ROWS[against].title, *cells])
    return table(["", "less", *columns], rows)


def _difference(found: dict[str, Any] | None) -> str:
    """**+.12** (.10 to .14); bold where the interval does not hold zero."""
    if found is None:
        return ""
    mean, low, high = (f"{found[name]:+.3f}".replace("0.", ".", 1) for name in ("mean", "low", "high"))
    return f"**{mean}** ({low} to {high})" if found["low"] * found["high"] > 0 else f"{mean} ({low} to {high})"


def simulated_sets() -> str:
    """Accuracy on every simulated set, of the rows with translations."""
    described = results("table")["data"]["simulated"]
    titles = {name: _set_title(parameters) for name, parameters in described.items()}
    columns = [f"{name}-translated" for name in INPUTS] + ["line-unsigned-translated", "raw-motions"]
    found = results("table")["table"]
    rows = []
    for on in ("1", "all"):
        for name in described:
            column = f"{on}/{name}"
            cells = [short(found[row][column]["mean"]) if column in found.get(row, {}) else "" for row in columns]
            rows.append([on, titles[name], *cells])
    return table(["trained on", "tested on motions", *(ROWS[row].title for row in columns)], rows)


def _set_title(parameters: dict[str, Any]) -> str:
    kind = str(parameters["kind"])
    light = "dark on bright" if parameters["simulator"]["scene"]["dark_on_bright"] else "bright on dark"
    speed, where = kind.split("-")[0], "from the centre" if kind.endswith("from-centre") else "through the centre"
    return f"{speed}, {where}, {light}"


def learning_curve() -> str:
    """Accuracy against the number of recordings."""
    found, n_all = results("table")["table"], results("table")["data"]["training_recordings"]
    rows = []
    for name in ("raw", "running"):
        for row in [row for row in ROWS if row.startswith(f"{name}-translated-")] + [f"{name}-translated"]:
            if row in found:
                cells = [short(found[row][column]["mean"]) for column in ("1/all", "1/others", "1/sim")]
                rows.append([ROWS[f"{name}-translated"].title, f"{ROWS[row].recordings or n_all:,}", *cells])
    return table(["", "recordings", "1/all", "1/others", "1/sim"], rows)


def resynthesis_worst() -> str:
    """The motion of the simulated set that each network knows least, mean over seeds."""
    rows = []
    for name, columns in results("table")["table"].items():
        for column in columns:
            if ROWS[name].group == "motions" and column.endswith("/sim"):
                motions = {motion: part["mean"] for motion, part in columns[column]["per_motion"].items()}
                worst = min(motions, key=lambda motion: motions[motion])
                rows.append([ROWS[name].title, column, worst, short(motions[worst])])
    return table(["", "", "worst motion", "accuracy"], rows)


def resynthesis_match() -> str:
    """How well the recorded motion is matched, and how many paths were found."""
    motions = results("table")["rows"]["raw-motions"]["motions"]["1"]
    names = [name for name in motions["match"]["recorded"] if not name.startswith("ON - OFF")]
    units = {name: f", {UNITS[name.split(',')[0]]}" if name.split(",")[0] in UNITS else "" for name in names}
    rows = [
        [name + units[name], *(f"{motions['match'][part][name]:.2f}" for part in ("recorded", "resynthesized"))]
        for name in names
    ]
    found = f"A path was found in {motions['with_path']:,} of {motions['windows']:,} windows.\n\n"
    return found + table(["first saccade", "recorded", "simulated again"], rows)


def edges() -> str:
    """Events by the angle between edge and motion."""
    found = results("edges")
    angles = found["angles_deg"]
    rows = [
        [
            f"{low}-{high}°",
            f"{found['events_per_gradient'][k] / found['events_per_gradient'][0]:.2f}",
            f"{found['cosine'][k] / found['cosine'][0]:.2f}",
            f"{100 * found['polarity_as_expected'][k]:.0f} %",
        ]
        for k, (low, high) in enumerate(zip(angles[:-1], angles[1:], strict=True))
    ]
    return table(["between gradient and motion", "events", "cosine", "of the expected polarity"], rows)


def polarity() -> str:
    """How signed and unsigned images of two saccades correlate."""
    rows = [
        [pair.replace("-", " and "), f"{of['angle_deg']:.0f}°"]
        + [f"{of[name]:+.2f}".replace("0.", ".", 1) for name in ("signed", "expected", "unsigned")]
        for pair, of in results("edges")["between_saccades"].items()
    ]
    return table(["saccades", "angle", "signed", "of -v · grad L", "unsigned"], rows)


TABLES = (
    comparison,
    thesis_rows,
    differences,
    simulated_sets,
    learning_curve,
    resynthesis,
    resynthesis_worst,
    resynthesis_match,
    edges,
    polarity,
)
