"""The table and the picture of networks that were trained on windows that slide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.views.figure_style import (
    GREY,
    OFF,
    ON,
    PALE,
    axes_at,
    headline,
    new_figure,
)
from experiments.tables.parts import of_report, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = {
    "trained fixed, streamed fixed": OFF,
    "trained fixed, streamed sliding": GREY,
    "trained sliding, streamed sliding": ON,
}
"""Row of the report -> its colour."""

WIDTH = 4.2
"""Width of the axes, in inches."""

STEP = 5.0
"""Distance from the left of the first axes to the left of the second axes, in inches."""


def _curve(entry: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray]:
    """The moments in milliseconds, and the accuracy at them as a mean over seeds."""
    rows = [curves[name] for curves in entry["networks"]]
    ms = np.array([float(moment) for moment in rows[0]["right"]])
    shares = [np.array(list(row["right"].values())) / row["recordings"] for row in rows]
    return ms, np.mean(shares, axis=0)


@of_report("sliding_training")
def sliding_training(report: dict[str, Any]) -> str:
    """A table of accuracies of both kinds of training, by set."""
    rows = []
    for entry in report.values():
        for name in LOOKS:
            ms, shares = _curve(entry, name)
            whole = entry["window_ms"]
            moments = [0.2 * whole, 0.5 * whole, whole, 1.2 * whole, 1.5 * whole, ms[-1]]
            cells = [entry["title"], name]
            for moment in moments:
                is_measured = moment <= ms[-1]
                share = shares[np.searchsorted(ms, moment - 1e-6)] if is_measured else None
                cells.append("-" if share is None else f"{share:.3f}")
            means = [curves[name]["mean"] for curves in entry["networks"]]
            cells.append(f"{np.mean(means):.3f}")
            cells.append(" ".join(f"{mean:.3f}" for mean in means))
            rows.append(cells)
    moments_named = ["0.2", "0.5", "1", "1.2", "1.5"]
    head = ["", "windows", *(f"after {name} windows" for name in moments_named), "at the end"]
    return table([*head, "mean over time", "of each seed"], rows)


def draw_curves(report: dict[str, Any]) -> Figure:
    """Draw the accuracy against the time since a recording's first event."""
    figure = new_figure(3.6)
    for k, entry in enumerate(report.values()):
        axes = axes_at(figure, 0.75 + k * STEP, 0.8, WIDTH, 2.1)
        for name, colour in LOOKS.items():
            ms, shares = _curve(entry, name)
            axes.plot(ms, shares, color=colour, label=name)
        axes.set_xlabel("ms since a recording's first event")
        axes.set_title(entry["title"], loc="left")
        axes.grid(axis="y", color=PALE, lw=0.5)
        axes.set_ylim(top=1.0)
        if k == 0:
            axes.set_ylabel("recordings right")
            axes.legend(loc="lower right")
    headline(figure, "Windows that slide, and windows one after the other")
    return figure
