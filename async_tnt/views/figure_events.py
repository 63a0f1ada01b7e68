"""Events in space-time, three-dimensional: raw (x, y, t) and transformed (u, v, t)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.views.figure_style import (
    GREY,
    OFF,
    ON,
    SMALL,
    TEXT,
    axes_at,
    polarity_legend,
    write_at,
)
from async_tnt.views.figure_subject import Window, shown_evenly

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_DOTS = 12_000  # in a window; more would hide one another


def draw_both(figure: Figure, window: Window, height: float) -> None:
    """Raw and transformed events side by side under their titles, and the legend, at the top of a figure."""
    raw, tnt = (axes_at(figure, left, 0.7, 5.0, height, projection="3d") for left in (0.0, 5.2))
    for centre, words, n, of in (
        (2.6, "raw events", draw_raw(raw, window), f"events in window {window.number}"),
        (7.8, f"after TNT ({transform_words(window.subject.config)})", draw_transformed(tnt, window), "events kept"),
    ):
        thinned = f", {MOST_DOTS:,} of them drawn" if n > MOST_DOTS else ""
        write_at(figure, centre, 0.65, words, ha="center")
        write_at(figure, centre, 0.85, f"{n:,} {of}{thinned}", ha="center", fontsize=SMALL, color=TEXT)
    polarity_legend(figure)


def transform_words(config: TNTConfig) -> str:
    """The transform's settings, for titles."""
    flow = ", flow removed" if config.remove_flow else ""
    return f"{config.landmark}{flow}, t_max {config.t_max:g}"


def draw_raw(axes: Any, window: Window, small: bool = False) -> int:
    """Draw a window's events (x, y, t) into 3-D axes, in sensor pixels; returns how many there are."""
    events = window.events
    _scatter(axes, window, events["x"], events["y"], np.ones(events.size, bool), small)
    _frame(axes, window, window.subject.config.sensor, "x", "y", small)
    return events.size


def draw_transformed(axes: Any, window: Window, small: bool = False) -> int:
    """Draw a window's kept events (u, v, t) into 3-D axes, in grid pixels; returns how many there are."""
    u, v, kept, _ = window.coordinates()
    _scatter(axes, window, u, v, kept, small)
    _frame(axes, window, window.subject.config.grid, "u", "v", small)
    return int(kept.sum())


def _scatter(axes: Any, window: Window, x: np.ndarray, y: np.ndarray, kept: np.ndarray, small: bool) -> None:
    """Time goes to the right, x into the depth, y downwards: what the sensor sees, in a row of moments."""
    shown = np.flatnonzero(kept)[shown_evenly(int(kept.sum()), MOST_DOTS)]
    colours = np.where(window.events["p"][shown] == 1, ON, OFF)
    size = (1.2 if small else 3.0) * min(1.0, (3_000 / max(1, shown.size)) ** 0.5)
    axes.scatter(window.time_ms[shown], x[shown], y[shown], s=size, c=colours, lw=0, depthshade=False, rasterized=True)


def _frame(axes: Any, window: Window, sides: tuple[int, int], x_name: str, y_name: str, small: bool) -> None:
    end_ms = window.subject.config.window_us / 1e3
    axes.set(xlim=(0, end_ms), ylim=(0, sides[0] - 1), zlim=(sides[1] - 1, 0))
    most = 2 if small else 4
    axes.set(xticks=_inner_ticks(end_ms, most), yticks=_inner_ticks(sides[0] - 1, most))
    axes.set_zticks(_inner_ticks(sides[1] - 1, most))
    axes.set_xlabel("time (ms)" if small else "time in the window (ms)", labelpad=-6 if small else -1)
    axes.set_ylabel(x_name if small else f"{x_name} (px)", labelpad=-9 if small else -4)
    axes.set_zlabel(y_name if small else f"{y_name} (px)", labelpad=-12 if small else -6)
    axes.tick_params(labelsize=SMALL, pad=-4 if small else -2, colors=TEXT)
    axes.set_proj_type("ortho")  # parallels stay parallel: a shape in constant motion is a slanted tube
    axes.set_box_aspect((1.9, sides[0] / max(sides), sides[1] / max(sides)), zoom=1.2)
    axes.view_init(elev=16, azim=-38)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1, 1, 1, 0))
        axis.pane.set_edgecolor("#d8d8d8")
        axis.line.set_color(GREY)
        axis._axinfo["grid"].update(color="#e6e6e6", linewidth=0.6)


def _inner_ticks(end: float, most: int) -> list[float]:
    """A few round numbers between 0 and `end`: labels at the corners of a box would overlap."""
    from matplotlib.ticker import MaxNLocator

    return [tick for tick in MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(0, end) if 0 < tick < end]
