"""The thesis' results table: rows (how events become a network's input), columns (trained on / tested on), numbers.

The thesis' rows are Baseline, TNT and TNT+regress. The others are the streaming landmarks. All rows share the
network, the optimizer and the augmentation, which thins events at random and moves nothing: a network that is
trained on one motion must see no other. Only TNT+regress gets random translations, as in the thesis.

Rows with re-synthesis also see their training windows under other motions (`resynthesis`). That is augmentation, which
the thesis does not have: they show what recordings of one motion can teach, not what a network infers by itself.

`t_max` is the same in all rows: of 2, 3, 4 and 8 the one with the lowest loss on held-out digits of the training motion
(docs/results.md has the numbers); the thesis has B - 1 = 8.

References
----------
Wang 2019, arXiv:1911.12801, the table of N-MNIST and N-MOVING-MNIST: the numbers in `Row.thesis`. "1/train" we read as:
trained on the first motion, tested on all three motions of the training digits.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.training.augment import Augmentation
from async_tnt.training.moved_windows import MotionSettings

T_MAX = 2.0
AUGMENTATION = Augmentation(start_ms=0, shift_px=0, rotation_deg=0, scale=0, shear=0, drop=0.3, partial=0)

RAW = TNTConfig(transform="none", landmark="center")

COLUMNS = {
    "all/all": "trained on all three saccades, tested on all three",
    "1/all": "trained on the first saccade, tested on all three",
    "1/train": "trained on the first saccade, tested on all three of the training digits",
    "all/sim": "trained on all three saccades, tested on 30 simulated motions",
    "1/sim": "trained on the first saccade, tested on 30 simulated motions",
    "confounded/all": "trained on each digit in one saccade only (0-3: first, 4-6: second, 7-9: third), tested on all",
    "confounded/sim": "the same, tested on 30 simulated motions",
}


@dataclass(frozen=True)
class Row:
    """One way from events to a network's input.

    Parameters
    ----------
    name : for the command line and for files.
    title : in the table.
    config : how events become volumes.
    thesis : the thesis' accuracies in the order of `COLUMNS`; empty for our own rows.
    augmentation : of the training windows.
    motions : how they are re-synthesized; None: they are not.
    """

    name: str
    title: str
    config: TNTConfig
    thesis: tuple[float, ...] = ()
    augmentation: Augmentation = AUGMENTATION
    motions: MotionSettings | None = None


ROWS = {
    row.name: row
    for row in (
        Row("baseline", "Baseline", RAW, (0.991, 0.437, 0.442, 0.396, 0.207)),
        Row(
            "tnt", "TNT (image centre)", TNTConfig(landmark="center", t_max=T_MAX), (0.981, 0.468, 0.464, 0.592, 0.318)
        ),
        Row(
            "regress",
            "TNT+regress",
            TNTConfig(landmark="regressor", t_max=T_MAX),
            (0.981, 0.485, 0.481, 0.566, 0.324),
            replace(AUGMENTATION, translate_px=4),
        ),
        Row("running", "`running`", TNTConfig(landmark="running", t_max=T_MAX)),
        Row(
            "line",
            "`line`, flow removed, unsigned",
            TNTConfig(landmark="line", remove_flow=True, polarity="unsigned", t_max=T_MAX),
        ),
        Row("baseline-motions", "Baseline + re-synthesis", RAW, motions=MotionSettings()),
        Row("baseline-shared", "Re-synthesis, shared path", RAW, motions=MotionSettings(shared_path=True)),
        Row("baseline-moved", "Re-synthesis only", RAW, motions=MotionSettings(recorded=0.0)),
        Row(
            "running-motions",
            "`running` + re-synthesis",
            TNTConfig(landmark="running", t_max=T_MAX),
            motions=MotionSettings(),
        ),
    )
}
TRAINED_ON = tuple(dict.fromkeys(column.split("/")[0] for column in COLUMNS))


def columns_of(trained_on: str) -> tuple[str, ...]:
    """The columns of networks trained on one of `TRAINED_ON`."""
    return tuple(column for column in COLUMNS if column.split("/")[0] == trained_on)


def aggregate(runs: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Row -> column -> mean, standard deviation and each seed's accuracy; the same for each motion.

    Parameters
    ----------
    runs : results of `table_runs.run_network`.

    Returns
    -------
    {row: {column: {"mean", "deviation", "seeds": {seed: accuracy}, "windows", "per_motion": {motion: {"mean",
    "deviation"}}, "thesis"}}}, with the rows and columns that occur, in the table's order. The deviation is the
    sample's (n - 1), None for a single seed.
    """
    runs = sorted(runs, key=lambda run: int(run["seed"]))
    table: dict[str, Any] = {}
    for row in ROWS.values():
        for place, column in enumerate(COLUMNS):
            found = {
                run["seed"]: run["columns"][column]
                for run in runs
                if run["row"] == row.name and column in run["columns"]
            }
            if not found:
                continue
            seeds = {str(seed): part["accuracy"] for seed, part in found.items()}
            motions = next(iter(found.values()))["per_motion"]
            table.setdefault(row.name, {})[column] = {
                **_summary(list(seeds.values())),
                "seeds": seeds,
                "windows": next(iter(found.values()))["windows"],
                "per_motion": {m: _summary([part["per_motion"][m] for part in found.values()]) for m in motions},
                "thesis": row.thesis[place] if place < len(row.thesis) else None,
            }
    return table


def _summary(values: list[float]) -> dict[str, float | None]:
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1)) if len(values) > 1 else None}


def text_table(table: dict[str, Any]) -> str:
    """The table in columns of plain text; the thesis' numbers are below ours."""
    shown = _columns_in(table)
    lines = [f"{'':<32}" + "".join(f"{column:>16}" for column in shown)]
    for name, columns in table.items():
        row = ROWS[name]
        lines.append(f"{row.title.replace('`', ''):<32}" + "".join(f"{_cell(columns.get(c)):>16}" for c in shown))
        if row.thesis:
            numbers = [_short(row.thesis[place]) if place < len(row.thesis) else "" for place in shown.values()]
            lines.append(f"{'  the thesis':<32}" + "".join(f"{number:>16}" for number in numbers))
    return "\n".join(lines)


def markdown_table(table: dict[str, Any]) -> str:
    """The table in Markdown; the thesis' numbers follow in brackets."""
    shown = _columns_in(table)
    lines = ["| | " + " | ".join(shown) + " |", "|---" * (1 + len(shown)) + "|"]
    for name, columns in table.items():
        row = ROWS[name]
        cells = []
        for column, place in shown.items():
            thesis = f" ({_short(row.thesis[place])})" if place < len(row.thesis) else ""
            cells.append(_cell(columns.get(column)) + thesis)
        lines.append(f"| {row.title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _columns_in(table: dict[str, Any]) -> dict[str, int]:
    """The thesis' columns and those of ours that occur -> their place."""
    n_thesis = max(len(row.thesis) for row in ROWS.values())
    occur = {column for columns in table.values() for column in columns}
    return {column: place for place, column in enumerate(COLUMNS) if place < n_thesis or column in occur}


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
