"""The picture of `experiments/spiking.py`: accuracy against the width of a simulator's bins."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from async_tnt.views.figure_style import (
    OFF,
    ON,
    PALE,
    SMALL,
    TEXT,
    axes_at,
    headline,
    new_figure,
    write_at,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = {"no floor": (OFF, "o"), "floor": (ON, "s")}
"""Row of bins -> colour and marker."""

WORDS = {
    "no floor": "sinabs, membranes without a floor",
    "floor": "sinabs, membranes of at least -1",
}
"""Row of bins -> its words."""


def draw_bins(report: dict[str, Any]) -> Figure:
    """Draw the share of recordings that are right against the width of the bins.

    A line shows our engine, event by event. Marks at the left show one event in each time step, if
    that was measured.
    """
    figure = new_figure(3.9)
    axes = axes_at(figure, 0.8, 0.85, 9.2, 2.4)
    bins = report["bins"]["accuracy"]
    if not bins:
        raise ValueError("no bins were measured, as sinabs is not installed")
    widths = sorted({float(ms) for rows in bins.values() for ms in rows if ms != "event"})
    left = widths[0] / 3
    for name, rows in bins.items():
        colour, marker = LOOKS[name]
        places = [(left if ms == "event" else float(ms), row) for ms, row in rows.items()]
        for is_line in (True, False):
            chosen = [(x, row["accuracy"]) for x, row in places if (x != left) is is_line]
            axes.plot(
                [x for x, _ in chosen],
                [share for _, share in chosen],
                color=colour,
                marker=marker,
                ls="-" if is_line else "",
                label=WORDS[name] if is_line else None,
            )
    ours = report["accuracy"]["accuracy"]
    axes.axhline(ours, color=TEXT, lw=1, ls="--", label="async_tnt, event by event")
    axes.set_xscale("log")
    names = {ms: f"{ms:g}" for ms in widths}
    if any("event" in rows for rows in bins.values()):
        names = {left: "an event", **names}
    axes.set_xticks(list(names), list(names.values()))
    axes.minorticks_off()
    axes.set_xlabel("width of a time step (ms)")
    axes.set_ylabel("recordings right")
    axes.grid(axis="y", color=PALE, lw=0.5)
    axes.legend(loc="lower center")
    headline(figure, "The same spiking network, in time steps of several widths")
    n = report["accuracy"]["recordings"]
    words = f"{n:,} of N-MNIST's official test recordings"
    write_at(figure, 0.8, 0.6, words, fontsize=SMALL, color=TEXT)
    return figure
