"""The record of the thesis' experiment: how its networks were trained, and what they got right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from experiments.moving_set.manifest import MovingMnist
from experiments.speed.timing import machine
from experiments.thesis.data import RealData
from experiments.thesis.factors import effects
from experiments.thesis.numbers import Right, aggregate, differences
from experiments.thesis.rows import ROWS, Run


def record_of(
    runs: Sequence[Run],
    results: Sequence[dict[str, Any]],
    right: Right,
    data: RealData,
    simulated: Mapping[str, MovingMnist],
    *,
    iterations: int | None,
    command: str,
) -> dict[str, Any]:
    """The content of `results/table.json`, from the results of all networks.

    Parameters
    ----------
    runs : the networks.
    results : results of the networks, by `runs.run_networks`.
    right : which windows the networks had right.
    data, simulated : data that the networks were trained and tested on.
    iterations : steps of every network; None: those of its row.
    command : command that repeats the experiment.
    """
    table = aggregate(results)
    by_name = {
        Run(result["row"], result["trained_on"], result["seed"]).name: result for result in results
    }
    return {
        "command": command,
        "data": {
            **data.description,
            "simulated": {
                name: simulated_set.parameters for name, simulated_set in simulated.items()
            },
        },
        "rows": {name: _about(name, results, iterations) for name in table},
        "settings": {
            name: value for name, value in results[0]["settings"].items() if name != "iterations"
        },
        "seeds": list(dict.fromkeys(run.seed for run in runs)),
        "machine": machine("torch"),
        "table": table,
        "differences": differences(right),
        "effects": effects(right),
        "validation": {
            name: result_of_run["validation"] for name, result_of_run in by_name.items()
        },
        "curves": {
            name: [_rounded(epoch) for epoch in result_of_run["history"]]
            for name, result_of_run in by_name.items()
            if ROWS[result_of_run["row"]].group == "long"
        },
    }


def _about(name: str, results: Sequence[dict[str, Any]], iterations: int | None) -> dict[str, Any]:
    """The settings with which the networks of a row were trained."""
    row = ROWS[name]
    motions = {
        result["trained_on"]: result["motions"]
        for result in results
        if result["row"] == name and result["motions"]
    }
    return {
        "config": row.config.to_dict(),
        "augmentation": asdict(row.augmentation),
        "iterations": iterations or row.iterations,
        "span_events": row.span,
        "motions": motions,
    }


def _rounded(epoch: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 6) for name, value in epoch.items()}
