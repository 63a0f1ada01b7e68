"""The tables of the thesis' experiment, all from one run of `thesis_table.py`, and what follows from them.

A sentence about two rows is written from the paired difference and its interval: one that holds zero is not called a
difference.
"""

from __future__ import annotations

from typing import Any

from async_tnt.resynthesis.calibration import UNITS
from experiments.page_parts import results, table
from experiments.table_numbers import markdown_table, short
from experiments.table_rows import INPUTS, ROWS

GUESS = 0.1
"""The accuracy of guessing among ten digits."""
COMPARED = {
    "Windows moved by up to 4 px in training": [(f"{name}-translated", name, "1/others") for name in INPUTS],
    "TNT, signed": [
        *((f"{name}-translated", "raw-translated", "1/others") for name in ("center", "running", "regressor", "line")),
        ("running-translated", "regressor-translated", "1/others"),
        ("running-translated", "center-translated", "1/others"),
    ],
    "Without the sign": [
        *((f"{name}-unsigned-translated", f"{name}-translated", "1/others") for name in ("raw", "running", "line")),
        ("running-unsigned-translated", "raw-unsigned-translated", "1/others"),
        ("line-unsigned-translated", "running-unsigned-translated", "1/others"),
    ],
    "Simulated motions": [
        *((f"{name}-translated", "raw-translated", "all/sim") for name in ("center", "running", "regressor", "line")),
        *((f"{name}-translated", "raw-translated", "1/sim") for name in ("running", "line")),
        ("line-unsigned-translated", "raw-unsigned-translated", "1/sim"),
    ],
    "t_max 8 against 2": [
        (f"{name}-t8-translated", f"{name}-translated", "1/others") for name in ("center", "running", "regressor")
    ],
}
"""Topic -> (row, against, column), for the sentences."""


def _accuracies() -> dict[str, Any]:
    """Row -> column -> accuracy."""
    return dict(results("table")["table"])


def comparison() -> str:
    """With what a network would have that knows the motion it saw, and guesses in others."""
    lines = markdown_table(_accuracies(), "comparison").splitlines()
    columns = lines[0].strip("| ").split(" | ")
    guessed = {"1/all": _guessed("1/all"), "1/others": GUESS, "1/train": _guessed("1/train"), "1/sim": GUESS}
    cells = [short(guessed[column]) if column in guessed else "" for column in columns]
    return "\n".join([*lines[:2], "| *guessing in other motions* | " + " | ".join(cells) + " |", *lines[2:]])


def _guessed(column: str) -> float:
    """Of a network that knows the first saccade and guesses in the others."""
    known: float = _accuracies()["raw"][column]["per_motion"]["saccade 1"]["mean"]
    return (known + 2 * GUESS) / 3


def conclusions() -> str:
    """What the differences say, topic by topic."""
    found = {(d["row"], d["against"], d["column"]): d for d in results("table")["differences"]}
    lines = []
    for topic, pairs in COMPARED.items():
        columns = dict.fromkeys(column for *_, column in pairs)
        for column in columns:
            said = [difference_in_words(found[pair]) for pair in pairs if pair[2] == column]
            lines.append(f"- **{topic}**, {column}: {'; '.join(said)}.")
    return "\n".join(lines)


def difference_in_words(difference: dict[str, Any]) -> str:
    """A clause: which row is better, by how much, and the 95 % interval; or that neither is shown to be."""
    row, against = (ROWS[difference[name]].title for name in ("row", "against"))
    low, high = (f"{difference[name]:+.3f}".replace("0.", ".", 1) for name in ("low", "high"))
    if difference["low"] <= 0 <= difference["high"]:
        return f"no difference shown between *{row}* and *{against}* ({low} to {high})"
    verb = "gains" if difference["mean"] > 0 else "loses"
    return f"*{row}* {verb} {short(abs(difference['mean']))} over *{against}* ({low} to {high})"


def unseen_motion() -> str:
    """Sentences."""
    n_seeds = len(_accuracies()["raw-translated"]["1/all"]["seeds"])
    of = {name: short(columns["1/all"]["mean"]) for name, columns in _accuracies().items() if "1/all" in columns}
    return (
        f"Trained on the first saccade, tested on all three ({n_seeds} seeds, t_max 2, windows moved by up to 4 px in "
        f"training). With the sign of polarity: untransformed {of['raw-translated']}, `running` "
        f"{of['running-translated']}. Without it: untransformed {of['raw-unsigned-translated']}, `running` "
        f"{of['running-unsigned-translated']}, `line` with its flow removed {of['line-unsigned-translated']}. "
        f"A network that guesses in the other two saccades would score {short(_guessed('1/all'))}. "
        f"[Re-synthesis](docs/guide.md#motions-that-were-not-recorded) of motions, untransformed, not moved and with "
        f"more steps: {of['raw-motions']}."
    )


def learning_curve() -> str:
    """Accuracy against the number of recordings."""
    n_all = results("table")["data"]["training_recordings"]
    rows = []
    for name in ("raw", "running"):
        for row in [row for row in ROWS if row.startswith(f"{name}-translated-")] + [f"{name}-translated"]:
            cells = [short(_accuracies()[row][column]["mean"]) for column in ("1/all", "1/others", "1/sim")]
            rows.append([ROWS[f"{name}-translated"].title, f"{ROWS[row].recordings or n_all:,}", *cells])
    return table(["", "recordings", "1/all", "1/others", "1/sim"], rows)


def simulated_sets() -> str:
    """Accuracy on eight simulated sets; bold where the interval of the difference to raw does not hold zero."""
    found = results("table_sets")
    shown = {
        (d["row"], d["column"])
        for d in found["differences"]
        if d["against"] == "raw-translated" and d["low"] * d["high"] > 0
    }
    rows = []
    for name, parameters in found["data"]["simulated"].items():
        column = f"all/{name}"
        cells = {row: short(columns[column]["mean"]) for row, columns in found["table"].items()}
        rows.append([_set_title(parameters)])
        rows[-1] += [f"**{cell}**" if (row, column) in shown else cell for row, cell in cells.items()]
    return table(["tested on motions", *(ROWS[row].title for row in found["table"])], sorted(rows))


def _set_title(parameters: dict[str, Any]) -> str:
    kind = str(parameters["kind"])
    light = "dark on bright" if parameters["simulator"]["scene"]["dark_on_bright"] else "bright on dark"
    speed, where = kind.split("-")[0], "from the centre" if kind.endswith("from-centre") else "through the centre"
    return f"{speed}, {where}, {light}"


def thesis_rows() -> str:
    return markdown_table(_accuracies(), "thesis")


def resynthesis() -> str:
    return markdown_table(_accuracies(), "motions")


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
