"""The tables of the thesis' experiment: accuracies, from the results of its networks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from async_tnt.resynthesis.calibration import UNITS
from experiments.tables.differences import BASELINE
from experiments.tables.parts import of_report, table
from experiments.thesis.numbers import cell, markdown_table, networks_of, short, summary
from experiments.thesis.rows import CONTROLS, FOREIGN, ROWS, T_MAX, THESIS_SET, TRAINED_ON
from experiments.thesis.table import recorded_networks, recorded_table

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
    "all/sim",
    "1/sim",
    f"1/{FOREIGN}",
    "1/bell",
    "1/beyond",
    f"1/{THESIS_SET}",
)
"""Columns of `resynthesis`."""

UNSEEN_COLUMNS = ("1/all", "1/sim", f"1/{FOREIGN}")
"""Columns of `unseen_motion`."""

UNSEEN_ROWS = {
    "thesis-baseline": "untransformed, the thesis' Baseline, 8,000 steps",
    "thesis-tnt": "TNT about the centre, the thesis' TNT, 8,000 steps",
    "thesis-regress": "TNT about a regressed landmark, the thesis' TNT+regress, 8,000 steps",
    "raw-translated": "untransformed, 3,000 steps",
    "running-translated": "TNT, `running`, 3,000 steps",
    "line-translated": "TNT, `line` with its flow removed, 3,000 steps",
    "raw-8000": "untransformed, thinned, 8,000 steps",
    "raw-reversed": "the same, recordings also reversed in time",
    "raw-all-ways": "the same without polarity, turned, reversed and flipped",
    "raw-motions": "untransformed, re-synthesized motions, 8,000 steps",
}
"""Row of the thesis' table -> its title in `unseen_motion`."""

EARLY_ROWS = (
    "raw-translated",
    "running-translated",
    "line-translated",
    "time_surface-translated",
    "raw-motions",
)
"""Rows of `against_time`."""


def _accuracies() -> dict[str, Any]:
    """Row -> column -> accuracies, of the recorded networks."""
    return dict(recorded_table()["table"])


def _measured(groups: Sequence[str], columns: Sequence[str]) -> list[str]:
    """Those of some columns in which a row of some groups has a number."""
    rows = [parts for name, parts in _accuracies().items() if ROWS[name].group in groups]
    return [column for column in columns if any(column in parts for parts in rows)]


def _of_groups(groups: Sequence[str], columns: Sequence[str]) -> str:
    """A table of the rows of some groups, in those of some columns that were measured."""
    return markdown_table(_accuracies(), groups, _measured(groups, columns), with_networks=True)


def commands(groups: Sequence[str]) -> str:
    """The commands that train the recorded networks of some groups, a line each."""
    seeds: dict[tuple[str, str], list[int]] = {}
    for network in recorded_networks():
        if ROWS[network["row"]].group in groups:
            seeds.setdefault((network["row"], network["trained_on"]), []).append(network["seed"])
    # the rows with the same networks are trained by one command
    rows_of: dict[tuple[tuple[str, ...], tuple[int, ...]], list[str]] = {}
    for row in ROWS:
        trainings: dict[tuple[int, ...], list[str]] = {}
        for trained_on in TRAINED_ON:
            if (row, trained_on) in seeds:
                its_seeds = tuple(sorted(seeds[row, trained_on]))
                trainings.setdefault(its_seeds, []).append(trained_on)
        for its_seeds, parts in trainings.items():
            rows_of.setdefault((tuple(parts), its_seeds), []).append(row)
    lines = []
    for (trained_on_sets, its_seeds), rows in rows_of.items():
        words = ["experiments.thesis_table --nmnist N-MNIST --mnist MNIST --v2e V2E"]
        words += ["--rows", *_by_group(rows), "--trained-on", *trained_on_sets]
        words += ["--seeds", *map(str, its_seeds), "--into experiments/results/thesis"]
        lines.append(" ".join(words))
    return "\n".join(lines)


def _by_group(rows: Sequence[str]) -> list[str]:
    """Names of rows, or of their groups where all rows of a group are among them."""
    names = []
    for row in rows:
        group = ROWS[row].group
        members = [name for name, other in ROWS.items() if other.group == group]
        names.append(group if set(members) <= set(rows) else row)
    return list(dict.fromkeys(names))


def thesis_command() -> str:
    """The commands that train the recorded networks, but for those of re-synthesis."""
    return commands(("thesis", "comparison", "t_max", "representations"))


def motions_command() -> str:
    """The commands that train the recorded networks of re-synthesis and its controls."""
    return commands(("motions",))


def thesis_rows() -> str:
    """A table of the thesis' rows, with the thesis' own numbers in brackets."""
    return _of_groups(("thesis",), THESIS_COLUMNS)


def comparison() -> str:
    """The table of the comparison.

    One row has the accuracies of a network that knows the motion it saw and guesses in all other
    motions.
    """
    accuracies = _accuracies()
    if BASELINE not in accuracies:
        return "Not measured yet."
    groups = ("comparison", "representations")
    columns = _measured(groups, COLUMNS)
    lines = _of_groups(groups, COLUMNS).splitlines()
    guess_by_column = {
        "1/all": _guessed("1/all"),
        "1/others": GUESS,
        "1/train": _guessed("1/train"),
        "1/sim": GUESS,
    }
    cells = [
        short(guess_by_column[column]) if column in guess_by_column else "" for column in columns
    ]
    lines.insert(2, f"| *guessing in other motions* |  | {' | '.join(cells)} |")
    return "\n".join(lines)


def _guessed(column: str) -> float:
    """Accuracy of a network that knows the first saccade and guesses in the other two.

    It knows the first saccade as the thesis' Baseline does.
    """
    known: float = _accuracies()[BASELINE][column]["per_motion"]["saccade 1"]
    return (known + 2 * GUESS) / 3


def t_max() -> str:
    """A table of the loss on held-out digits of the first saccade, by t_max.

    The loss and the accuracy are means over the seeds, with their standard deviation.
    """
    loss_by_t_max: dict[float, list[float]] = {}
    right_by_t_max: dict[float, list[float]] = {}
    for network in recorded_networks():
        row = ROWS[network["row"]]
        if network["trained_on"] == "1" and (row.group == "t_max" or row.name == "running"):
            value = row.config.t_max
            loss_by_t_max.setdefault(value, []).append(network["validation"]["validation_loss"])
            right_by_t_max.setdefault(value, []).append(network["validation"]["per_window"])
    values = sorted(loss_by_t_max)
    rows = [
        ["held-out loss", *(cell(summary(loss_by_t_max[value])) for value in values)],
        ["held-out windows right", *(cell(summary(right_by_t_max[value])) for value in values)],
        ["networks", *(str(len(loss_by_t_max[value])) for value in values)],
    ]
    assert not values or T_MAX in values
    return table(["", *(f"t_max {value:g}" for value in values)], rows)


def unseen_motion() -> str:
    """README's table of the networks that saw the first saccade only, below a sentence on it."""
    accuracies = _accuracies()
    if BASELINE not in accuracies:
        return "Not measured yet."
    measured = {row: title for row, title in UNSEEN_ROWS.items() if row in accuracies}
    seeds = sorted({len(accuracies[row]["1/all"]["seeds"]) for row in measured})

    def cells(row: str) -> list[str]:
        return [cell(accuracies[row].get(column)) for column in UNSEEN_COLUMNS]

    body = [[title, *cells(row)] for row, title in measured.items()]
    guesses = [short(_guessed("1/all")), short(GUESS), short(GUESS)]
    body.append(["*a guess in motions that were not seen*", *guesses])
    head = [
        "volume",
        "right in all three saccades",
        "right in 30 simulated motions",
        "the same by v2e's pixels",
    ]
    sentence = (
        f"Trained on the first saccade of N-MNIST alone ({' or '.join(map(str, seeds))} seeds, "
        "mean and standard deviation):"
    )
    return f"{sentence}\n\n{table(head, body)}"


def against_time() -> str:
    """A table of the accuracy in unseen motions, by the time since a window's start."""
    accuracies = _accuracies()
    body = []
    times: dict[str, float] = {}
    for column in ("1/others", "1/sim"):
        for row in EARLY_ROWS:
            entry = accuracies.get(row, {}).get(column, {})
            against_time = entry.get("against_time_ms")
            if against_time:
                times = against_time
                early_accuracies = [short(accuracy) for accuracy in against_time.values()]
                title = f"{column}: {ROWS[row].title}"
                n = str(len(entry["seeds"]))
                body.append([title, n, *early_accuracies, short(entry["mean"])])
    return table(["", "networks", *(f"{ms} ms" for ms in times), "105 ms"], body)


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
    return _of_groups(("motions",), MOTIONS_COLUMNS)


def controls() -> str:
    """A sentence on the best control of re-synthesis, in each of the columns of `unseen_motion`."""
    accuracies = _accuracies()
    measured = [name for name in CONTROLS if f"raw-{name}" in accuracies]
    if not measured or "raw-motions" not in accuracies:
        return "Not measured yet."
    sentences = []
    for column in UNSEEN_COLUMNS:
        means = {name: accuracies[f"raw-{name}"][column]["mean"] for name in measured}
        best = max(means, key=lambda name: means[name])
        without = accuracies.get("raw-8000", {}).get(column)
        sentences.append(
            f"{column}: re-synthesis {short(accuracies['raw-motions'][column]['mean'])}, the best "
            f"of the cheap ways {short(means[best])} ({ROWS[f'raw-{best}'].title}), none of them "
            f"{'-' if without is None else short(without['mean'])}."
        )
    return "\n".join(f"- {sentence}" for sentence in sentences)


def foreign() -> str:
    """A table of the accuracy in the motions of *sim*, by the pixels that see them."""
    accuracies = _accuracies()
    body = []
    for name, columns in accuracies.items():
        for trained_on in ("all", "1"):
            own = columns.get(f"{trained_on}/sim")
            other = columns.get(f"{trained_on}/{FOREIGN}")
            if own is not None and other is not None:
                n = networks_of({trained_on: own})
                body.append([f"{trained_on}: {ROWS[name].title}", n, cell(own), cell(other)])
    return table(["trained on", "networks", "our pixels", "those of v2e"], body)


def resynthesis_match() -> str:
    """A sentence on the paths that were found, and a table of statistics of their simulations.

    The windows of the first saccade are simulated again along their own paths. The table compares
    their statistics with those of the recorded windows.
    """
    found = [
        network["motions"]
        for network in recorded_networks()
        if (network["row"], network["trained_on"]) == ("raw-motions", "1")
    ]
    if not found:
        return "Not measured yet."
    motions = found[0]
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
