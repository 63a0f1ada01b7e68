"""The settings of plane fits: tried on sequences for validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from examples.optical_flow.plane_fit import PlaneSettings
from examples.optical_flow.sequences import KnownSequence, Way
from experiments.optical_flow.comparison import mean_error

PLANE_CHOICES: dict[str, Sequence[float]] = {
    "radius": (1, 2, 3, 4),
    "oldest_us": (20_000, 50_000, 100_000),
    "burst_us": (0, 5_000, 10_000, 20_000, 40_000, 80_000),
    "off_us": (1_000, 2_000, 5_000, 10_000, 20_000),
    "share": (0.15, 0.2, 0.3, 0.4, 0.5, 0.6),
    "fastest_px": (100.0, 150.0, 200.0, 300.0, 500.0, 1_000.0),
}
"""Setting of a plane fit -> values that are tried."""

POOL_CHOICES: dict[str, Sequence[float]] = {
    **PLANE_CHOICES,
    "pool_radius": (4, 8, 12, 16, 24),
    "pool_us": (10_000, 20_000, 40_000, 80_000),
    "prior": (1.0, 3.0, 10.0, 30.0, 100.0),
}
"""Setting of pooled plane fits -> values that are tried."""


def best_settings(
    way_of: Callable[[PlaneSettings], Way],
    choices: dict[str, Sequence[float]],
    validation: list[KnownSequence],
    n_drawn: int,
    seed: int,
) -> dict[str, Any]:
    """Search the settings with the least mean error.

    First, settings are drawn. Then each value of the best ones is replaced by each other choice, as
    long as this helps.

    Parameters
    ----------
    way_of : makes the way to flow of its settings.
    choices : setting -> values that are tried.
    validation : sequences.
    n_drawn : number of settings that are drawn.
    seed : of the draws.

    Returns
    -------
    dict : `settings`, their mean `error`, and how many were `tried`.
    """
    rng = np.random.default_rng(seed)
    errors: dict[PlaneSettings, float] = {}

    def error(settings: PlaneSettings) -> float:
        if settings not in errors:
            errors[settings] = mean_error(way_of(settings), validation)
            bar.update()
        return errors[settings]

    with progress(0, "settings of planes tried") as bar:
        for _ in range(n_drawn):
            drawn: dict[str, Any] = {
                name: values[int(rng.integers(len(values)))] for name, values in choices.items()
            }
            error(PlaneSettings(**drawn))
        best = min(errors, key=lambda settings: errors[settings])
        last = None
        while best != last:
            last = best
            for name, values in choices.items():
                changes: list[dict[str, Any]] = [{name: value} for value in values]
                near = [replace(best, **change) for change in changes]
                best = min(near, key=error)
    return {"settings": best, "error": errors[best], "tried": len(errors)}
