"""The tables of the thesis' experiment: accuracies, all from one run of `thesis_table`."""

from __future__ import annotations

from typing import Any

from async_tnt.resynthesis.calibration import UNITS
from experiments.tables.differences import BASELINE, TRANSFORMED
from experiments.tables.parts import of_report, results, table
from experiments.thesis.numbers import markdown_table, short
from experiments.thesis.rows import ROWS, THESIS_SET

GUESS = 0.1
"""Accuracy of guessing among ten digits."""

THESIS_COLUMNS = ("all/all", "1/all", "1/train", f"all/{THESIS_SET}", f"1/{THESIS_SET}")
"""Columns of `thesis_rows`, each as "trained on/tested on"."""

COLUMNS = ("all/all", "1/all", "1/others", "1/train", "all/sim", "1/sim", "all/bell", "1/bell")
"""Columns of `comparison`."""

MOTIONS_COLUMNS = (
    "all/all",
    "1/all",
    "1/others",
    "confounded/all",
    "all/sim",
    "1/sim",
    "confounded/sim",
    "1/beyond",
    "confounded/beyond",
    f"1/{THESIS_SET}",
)
"""Columns of `resynthesis`."""

UNSEEN_COLUMNS = ("1/all", "1/sim")
"""Columns of `unseen_motion`."""

UNSEEN_ROWS = {
    "raw-translated": "signed, untransformed",
    "running-translated": "signed, `running`",
    "raw-unsigned-translated": "unsigned, untransformed",
    "running-unsigned-translated": "unsigned, `running`",
    "line-unsigned-translated": "unsigned, `line` with its flow removed",
}
"""Row of the thesis' table -> its title in `unseen_motion`."""

EARLY_ROWS = (
    BASELINE,
    *TRANSFORMED,
    "raw-translated",
    "running-translated",
    "line-unsigned-translated",
    "time_surface-translated",
    "raw-motions",
)
"""Rows of `against_time`."""

STEPS = (1_000, 3_000, 8_000, 20_000, 40_000, 60_000)
"""Steps of the optimizer that `curves` shows."""


def _accuracies() -> dict[str, Any]:
    """Row -> column -> accuracies, from the recorded run."""
    return dict(results("table")["table"])


def thesis_rows() -> str:
    """A table of the thesis' rows, with the thesis' own numbers in brackets."""
    return markdown_table(_accuracies(), ("thesis", "long"), THESIS_COLUMNS)


def comparison() -> str:
    """The table of the comparison.

    One row has the accuracies of a network that knows the motion it saw and guesses in all other
    motions.
    """
    lines = markdown_table(_accuracies(), ("comparison", "spans"), COLUMNS).splitlines()
    guess_by_column = {
        "1/all": _guessed("1/all"),
        "1/others": GUESS,
        "1/train": _guessed("1/train"),
        "1/sim": GUESS,
    }
    cells = [
        short(guess_by_column[column]) if column in guess_by_column else "" for column in COLUMNS
    ]
    lines.insert(2, f"| *guessing in other motions* | {' | '.join(cells)} |")
    return "\n".join(lines)


def _guessed(column: str) -> float:
    """Accuracy of a network that knows the first saccade and guesses in the other two."""
    known: float = _accuracies()["raw"][column]["per_motion"]["saccade 1"]
    return (known + 2 * GUESS) / 3


def unseen_motion() -> str:
    """README's table of the networks that saw the first saccade only, below a sentence on it."""
    accuracies = _accuracies()
    n_seeds = len(accuracies["raw-translated"]["1/all"]["seeds"])

    def cells(row: str) -> list[str]:
        return [short(accuracies[row][column]["mean"]) for column in UNSEEN_COLUMNS]

    body = [[title, *cells(row)] for row, title in UNSEEN_ROWS.items()]
    body.append(["*a guess in motions that were not seen*", short(_guessed("1/all")), short(GUESS)])
    body.append(["signed, untransformed, re-synthesized motions", *cells("raw-motions")])
    head = ["volume", "right in all three saccades", "right in 30 simulated motions"]
    sentence = (
        f"Trained on the first saccade: {n_seeds} seeds, t_max 2, windows moved by up to 4 px in "
        "training; with re-synthesized motions, windows not moved and more steps."
    )
    return f"{sentence}\n\n{table(head, body)}"


def against_time() -> str:
    """A table of the accuracy in unseen motions, by the time since a window's start."""
    accuracies = _accuracies()
    body = []
    for column in ("1/others", "1/sim"):
        for row in EARLY_ROWS:
            entry = accuracies.get(row, {}).get(column, {})
            against_time = entry.get("against_time_ms")
            if against_time:
                early_accuracies = [short(accuracy) for accuracy in against_time.values()]
                body.append(
                    [f"{column}: {ROWS[row].title}", *early_accuracies, short(entry["mean"])]
                )
    times = accuracies[EARLY_ROWS[0]]["1/others"]["against_time_ms"]
    return table(["", *(f"{ms} ms" for ms in times), "105 ms"], body)


def curves() -> str:
    """A table of held-out windows right and their loss, by steps of the long trainings."""
    body = []
    for name, history in results("table")["curves"].items():
        row, trained_on, _ = name.rsplit("-", 2)
        cells = []
        for steps in STEPS:
            epoch = next(epoch for epoch in history if epoch["iterations"] >= steps)
            cells.append(f"{short(epoch['per_window'])} / {short(epoch['validation_loss'])}")
        body.append([f"{trained_on}: {ROWS[row].title}", *cells])
    return table(["trained on", *(f"{steps:,} steps" for steps in STEPS)], body)


@of_report("equivariance")
def equivariance(report: dict[str, Any]) -> str:
    """A table of the equivariance errors by input, layer and flow."""
    body = [
        [name, layer, *(f"{error:.2f}" for error in errors)]
        for name, errors_by_layer in report["errors"].items()
        for layer, errors in errors_by_layer.items()
    ]
    return table(["input", "layer", *(f"{flow} px" for flow in report["flows_px"])], body)


def resynthesis() -> str:
    """A table of accuracies with re-synthesis, and of controls with the same number of steps."""
    return markdown_table(_accuracies(), ("motions",), MOTIONS_COLUMNS)


def resynthesis_match() -> str:
    """A sentence on the paths that were found, and a table of statistics of their simulations.

    The windows of the first saccade are simulated again along their own paths. The table compares
    their statistics with those of the recorded windows.
    """
    motions = results("table")["rows"]["raw-motions"]["motions"]["1"]
    match = motions["match"]
    body = []
    for name, recorded in match["recorded"].items():
        if name.startswith("ON - OFF"):
            continue
        unit = UNITS.get(name.split(",")[0])
        title = name if unit is None else f"{name}, {unit}"
        body.append([title, f"{recorded:.2f}", f"{match['resynthesized'][name]:.2f}"])
    sentence = f"A path was found in {motions['with_path']:,} of {motions['windows']:,} windows."
    return f"{sentence}\n\n{table(['first saccade', 'recorded', 'simulated again'], body)}"
