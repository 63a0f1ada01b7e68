"""The tables of the thesis' experiment, all from one run of `thesis_table.py`, and the sentences
that follow from them.

No sentence picks its differences: it names all of a question that hold by Holm's method, gains and
losses.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from async_tnt.resynthesis.calibration import UNITS
from experiments.tables.parts import of_report, results, table
from experiments.thesis.numbers import LEVEL, cell, in_order, markdown_table, short, signed
from experiments.thesis.rows import QUESTIONS, ROWS, SETS, THESIS_SET

GUESS = 0.1
"""The accuracy of guessing among ten digits."""
THESIS_COLUMNS = ("all/all", "1/all", "1/train", f"all/{THESIS_SET}", f"1/{THESIS_SET}")
COLUMNS = ("all/all", "1/all", "1/others", "1/train", "all/sim", "1/sim", "all/bell", "1/bell")
DIFFERENCES = ("all/all", "1/others", "all/sim", "1/sim", "all/bell", "1/bell")
MOTIONS_COLUMNS = (
    *("all/all", "1/all", "1/others", "confounded/all"),
    *("all/sim", "1/sim", "confounded/sim", "1/beyond", "confounded/beyond", f"1/{THESIS_SET}"),
)
THESIS_ROWS = ("thesis-baseline", "thesis-tnt", "thesis-regress")
EARLY = (
    *THESIS_ROWS,
    "raw-translated",
    "running-translated",
    "line-unsigned-translated",
    "time_surface-translated",
    "raw-motions",
)
"""Rows of `against_time`."""
STEPS = 1_000, 3_000, 8_000, 20_000, 40_000, 60_000
"""Of `curves`."""


def _accuracies() -> dict[str, Any]:
    """Row -> column -> accuracy."""
    return dict(results("table")["table"])


def thesis_rows() -> str:
    """The thesis' rows, in brackets its own numbers."""
    return markdown_table(_accuracies(), ("thesis", "long"), THESIS_COLUMNS)


def thesis_sets() -> str:
    """The same rows on each simulated set; bold where the difference to the Baseline holds."""
    holds = {(d["row"], d["column"]) for d in _differences() if d["holm"] < LEVEL}
    shown = [(on, row) for on in ("all", "1") for row in THESIS_ROWS]
    rows = []
    for name, (kind, dark) in SETS.items():
        cells = []
        for on, row in shown:
            text = cell(_accuracies().get(row, {}).get(f"{on}/{name}"))
            cells.append(f"**{text}**" if (row, f"{on}/{name}") in holds else text)
        rows.append([f"{name}: {kind}, {'dark on bright' if dark else 'bright on dark'}", *cells])
    return table(["tested on", *(f"{on}: {ROWS[row].title}" for on, row in shown)], rows)


def effects() -> str:
    """What the gain over the Baseline depends on; bold where it holds."""
    found = results("table")["effects"]
    columns = list(dict.fromkeys((e["trained_on"], e["row"]) for e in found))
    rows = []
    for effect in dict.fromkeys(e["effect"] for e in found):
        of = {(e["trained_on"], e["row"]): e for e in found if e["effect"] == effect}
        rows.append([effect, *(_difference(of[column]) for column in columns)])
    return table(
        ["gain over the Baseline", *(f"{on}: {ROWS[row].title}" for on, row in columns)], rows
    )


def comparison() -> str:
    """With what a network would have that knows the motion it saw, and guesses in others."""
    lines = markdown_table(_accuracies(), ("comparison", "spans"), COLUMNS).splitlines()
    guessed = {
        "1/all": _guessed("1/all"),
        "1/others": GUESS,
        "1/train": _guessed("1/train"),
        "1/sim": GUESS,
    }
    cells = [short(guessed[column]) if column in guessed else "" for column in COLUMNS]
    return "\n".join(
        [*lines[:2], "| *guessing in other motions* | " + " | ".join(cells) + " |", *lines[2:]]
    )


def _guessed(column: str) -> float:
    """Of a network that knows the first saccade and guesses in the others."""
    known: float = _accuracies()["raw"][column]["per_motion"]["saccade 1"]
    return (known + 2 * GUESS) / 3


def differences() -> str:
    """Every pair of every question; bold where the difference holds."""
    found = {(d["row"], d["against"], d["column"]): d for d in _differences()}
    rows = []
    for question, pairs in QUESTIONS.items():
        known = [pair for pair in pairs if any((*pair, column) in found for column in DIFFERENCES)]
        rows += [[f"*{question}*", *[""] * len(DIFFERENCES)]] * bool(known)
        for row, against in known:
            of = (found.get((row, against, column)) for column in DIFFERENCES)
            title = f"{ROWS[row].title} - {ROWS[against].title}"
            rows.append([title, *("-" if d is None else _difference(d) for d in of)])
    return table(["difference", *DIFFERENCES], rows)


def _difference(of: dict[str, Any]) -> str:
    """+.165 (+.064 to +.266), bold where it holds."""
    mean = signed(of["mean"])
    return f"{f'**{mean}**' if of['holm'] < LEVEL else mean} ({signed(of['low'])} to {signed(of['high'])})"


def _differences() -> list[dict[str, Any]]:
    return list(results("table")["differences"])


def conclusions() -> str:
    """All that holds, question by question."""
    return "\n".join(f"- {answer(question, _differences())}" for question in QUESTIONS)


def thesis_answers() -> str:
    """The thesis' own question, on the simulated sets: all that holds."""
    found = {
        (d["row"], d["column"]): d for d in _differences() if d["question"] == next(iter(QUESTIONS))
    }
    sentences = []
    for on, words in (("all", "all saccades"), ("1", "the first saccade")):
        for row in THESIS_ROWS[1:]:
            held = {
                name: d
                for name in SETS
                if (d := found.get((row, f"{on}/{name}"))) and d["holm"] < LEVEL
            }
            for verb, sign in (("gains", 1), ("loses", -1)):
                listed = [
                    f"*{name}* {signed(d['mean'])}"
                    for name, d in held.items()
                    if sign * d["mean"] > 0
                ]
                of = f"Trained on {words}, *{ROWS[row].title}* {verb} on {', '.join(listed)}"
                sentences += [of] * bool(listed)
    n = sum(column.split("/")[1] in SETS for _, column in found)
    return f"Against the Baseline, of {n} differences on simulated sets these hold. {'. '.join(sentences)}."


def answer(question: str, every: Iterable[dict[str, Any]]) -> str:
    """One question's differences that hold, of each pair of rows in each column."""
    if not (found := [d for d in every if d["question"] == question]):
        return f"**{question}**: not measured yet."
    pairs: dict[tuple[str, str], dict[str, str]] = {}
    for d in found:
        if d["holm"] < LEVEL:
            pairs.setdefault((d["row"], d["against"]), {})[d["column"]] = signed(d["mean"])
    n_held = sum(map(len, pairs.values()))
    parts = []
    for (row, against), means in pairs.items():
        listed = ", ".join(f"{means[column]} in {column}" for column in in_order(means))
        parts.append(f"*{ROWS[row].title}* against *{ROWS[against].title}* {listed}")
    return (
        f"**{question}**: {n_held} of {len(found)} hold"
        + ("".join(f"; {part}" for part in parts))
        + "."
    )


def unseen_motion() -> str:
    """Sentences."""
    n_seeds = len(_accuracies()["raw-translated"]["1/all"]["seeds"])
    of = {
        name: " / ".join(short(columns[column]["mean"]) for column in ("1/all", "1/sim"))
        for name, columns in _accuracies().items()
        if "1/all" in columns
    }
    return (
        f"Trained on the first saccade, tested on all three / in 30 simulated motions ({n_seeds} "
        "seeds, t_max 2, "
        f"windows moved by up to 4 px in training). With the sign of polarity: untransformed "
        f"{of['raw-translated']}, "
        f"`running` {of['running-translated']}. Without it: untransformed "
        f"{of['raw-unsigned-translated']}, `running` "
        f"{of['running-unsigned-translated']}, `line` with its flow removed "
        f"{of['line-unsigned-translated']}. "
        f"A network that guesses in other motions would score {short(_guessed('1/all'))} / "
        f"{short(GUESS)}. "
        f"With [re-synthesized motions](docs/guide.md#motions-that-were-not-recorded) "
        "(untransformed, windows not "
        f"moved, more steps): {of['raw-motions']}."
    )


def against_time() -> str:
    """Accuracy in unseen motions by the time since a window's start."""
    rows = []
    for column in ("1/others", "1/sim"):
        for row in EARLY:
            of = _accuracies().get(row, {}).get(column, {})
            if of.get("against_time_ms"):
                early = [short(accuracy) for accuracy in of["against_time_ms"].values()]
                rows.append([f"{column}: {ROWS[row].title}", *early, short(of["mean"])])
    times = next(
        of for part in _accuracies().values() for c in part.values() if (of := c["against_time_ms"])
    )
    return table(["", *(f"{ms} ms" for ms in times), "105 ms"], rows)


def curves() -> str:
    """Of the long trainings: how many held-out windows are right, and their loss, after so many
    steps."""
    rows = []
    for name, history in results("table")["curves"].items():
        row, trained_on, _ = name.rsplit("-", 2)
        at = [next(epoch for epoch in history if epoch["iterations"] >= steps) for steps in STEPS]
        cells = (
            f"{short(epoch['per_window'])} / {short(epoch['validation_loss'])}" for epoch in at
        )
        rows.append([f"{trained_on}: {ROWS[row].title}", *cells])
    return table(["trained on", *(f"{steps:,} steps" for steps in STEPS)], rows)


@of_report("equivariance")
def equivariance(report: dict[str, Any]) -> str:
    """How far each layer is from moving along with the flow."""
    rows = [
        [name, layer, *(f"{error:.2f}" for error in errors)]
        for name, of_layer in report["errors"].items()
        for layer, errors in of_layer.items()
    ]
    return table(["input", "layer", *(f"{flow} px" for flow in report["flows_px"])], rows)


def resynthesis() -> str:
    return markdown_table(_accuracies(), ("motions",), MOTIONS_COLUMNS)


def resynthesis_match() -> str:
    """How well the recorded motion is matched, and how many paths were found."""
    motions = results("table")["rows"]["raw-motions"]["motions"]["1"]
    names = [name for name in motions["match"]["recorded"] if not name.startswith("ON - OFF")]
    units = {
        name: f", {UNITS[name.split(',')[0]]}" if name.split(",")[0] in UNITS else ""
        for name in names
    }
    rows = [
        [
            name + units[name],
            *(f"{motions['match'][part][name]:.2f}" for part in ("recorded", "resynthesized")),
        ]
        for name in names
    ]
    found = f"A path was found in {motions['with_path']:,} of {motions['windows']:,} windows.\n\n"
    return found + table(["first saccade", "recorded", "simulated again"], rows)
