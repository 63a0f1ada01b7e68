"""Runs brought together: mean and deviation over seeds, for each row, column and motion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from async_tnt.training.table_rows import COLUMNS, ROWS


def aggregate(runs: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Row -> column -> mean, standard deviation and each seed's accuracy; the same for each motion.

    Parameters
    ----------
    runs : what `run.do_run` returned.

    Returns
    -------
    {row: {column: {"mean", "deviation", "seeds": {seed: accuracy}, "windows", "per_motion": {motion: {"mean",
    "deviation"}}, "thesis"}}}, with the rows and columns that occur, in the table's order. The deviation is that of
    a sample (n - 1), None for a single seed.
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
                "thesis": row.thesis[place] if row.thesis else None,
            }
    return table


def _summary(values: list[float]) -> dict[str, float | None]:
    return {
        "mean": float(np.mean(values)),
        "deviation": float(np.std(values, ddof=1)) if len(values) > 1 else None,
    }
