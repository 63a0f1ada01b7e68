"""A picture of a confusion matrix, and beside it panels about early decisions: accuracy against time and against the
number of events, and what a level of confidence costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.views.figure_style import (
    GREY,
    OFF,
    PALE,
    SMALL,
    TEXT,
    axes_at,
    new_figure,
    note,
    one_colour_map,
    save,
    shortened,
    styled,
    write_at,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_NUMBERED = 25  # with more classes, numbers in the cells would be too small to read
LONGEST_NAME = 24
CELL, LEAST = 0.42, 2.2  # inches
PANEL_WIDTH, PANEL_MARGIN = 3.0, 0.75
DASHED = (0, (3, 2))

Panel = Callable[["Axes"], None]
"""Draws on its axes."""


def draw_confusion(
    confusion: np.ndarray, classes: Sequence[str], title: str = "", panels: Sequence[Panel] = ()
) -> Figure:
    """Draw a confusion matrix and, next to it, panels.

    A cell's colour is its share of its row, so that rare classes are as visible as common ones; its number is the
    count.

    Parameters
    ----------
    confusion : integers, shape (K, K), by true class (row) and decided class (column).
    classes : K names.
    title : one line above.
    panels : from left to right, as high as the matrix.

    Raises
    ------
    ValueError : the shape does not fit the names.
    """
    n = len(classes)
    confusion = np.asarray(confusion)
    if confusion.shape != (n, n):
        raise ValueError(f"`confusion` must have shape ({n}, {n}), one row and column a class, got {confusion.shape}")
    totals = confusion.sum(axis=1, keepdims=True)
    shares = confusion / np.maximum(totals, 1)
    side = min(max(CELL * n, LEAST), 9.0)
    names = [shortened(name, LONGEST_NAME) for name in classes]
    longest = max(map(len, names))
    margin = 0.6 + 0.075 * longest
    width, height = side + margin + 1.1, side + margin + 0.5
    matrix_width = width
    width += len(panels) * (PANEL_MARGIN + PANEL_WIDTH)
    width = max(width, 0.085 * len(title) + 0.4)
    figure = new_figure(height, width)
    write_at(figure, width / 2, 0.25, title, ha="center")
    top = height - margin - side
    axes = axes_at(figure, margin, top, side, side)
    image = axes.imshow(shares, cmap=one_colour_map(OFF), vmin=0, vmax=1, aspect="equal", interpolation="nearest")
    axes.set_xticks(range(n), names, rotation=90 if longest > 3 else 0, fontsize=SMALL if n <= 40 else 5)
    axes.set_yticks(range(n), names, fontsize=SMALL if n <= 40 else 5)
    axes.set(xlabel="decided", ylabel="true")
    for row, column in np.argwhere(confusion) if n <= MOST_NUMBERED else ():
        colour = "white" if shares[row, column] > 0.55 else TEXT
        look = {"ha": "center", "va": "center", "color": colour, "fontsize": SMALL}
        axes.text(column, row, str(confusion[row, column]), **look)
    bar = axes_at(figure, margin + side + 0.15, top, 0.12, side)
    figure.colorbar(image, cax=bar, ticks=[0, 0.5, 1], format=lambda share, _: f"{share:.0%}")
    bar.tick_params(labelsize=SMALL)
    for k, panel in enumerate(panels):
        left = matrix_width + PANEL_MARGIN - 0.25 + k * (PANEL_MARGIN + PANEL_WIDTH)
        panel(axes_at(figure, left, top, PANEL_WIDTH, side))
    return figure


def write_confusion(
    confusion: np.ndarray,
    classes: Sequence[str],
    path: Path,
    title: str = "",
    panels: Sequence[Panel] = (),
    *,
    dpi: int = 150,
) -> Path:
    """`draw_confusion` into a file, .png, .svg or .pdf; replaced atomically if it exists. Returns its path."""
    with styled():
        save(draw_confusion(confusion, classes, title, panels), path, dpi)
    return path


def early_panels(report: Mapping[str, Any]) -> Sequence[Panel]:
    """Panels for `draw_confusion`, from a report of `evaluation.early.early_report`; none for windows of events."""
    if not report["accuracy_against_time"]:
        return ()
    time = [(row["time_us"] / 1e3, row["accuracy"], row["decided"]) for row in report["accuracy_against_time"]]
    events = [(row["events"], row["accuracy"], row["reached"]) for row in report["accuracy_against_events"]]
    return (
        partial(_draw_course, course=time, other="decided", xlabel="ms into the window"),
        partial(_draw_course, course=events, other="with as many", xlabel="first events of the window", xscale="log"),
        partial(_draw_levels, levels=report["confidence"]),
    )


def _draw_course(axes: Axes, course: Sequence[tuple[float, float, float]], other: str, **settings: Any) -> None:
    """course : (place, share of windows right, another share of windows, named by `other`)."""
    at, right, share = zip(*course, strict=True)
    axes.plot(at, right, color=OFF, marker="o", markersize=3.5, label="right")
    axes.plot(at, share, color=GREY, linestyle=DASHED, label=other)
    _look(axes, ylabel="windows", **settings)


def _draw_levels(axes: Axes, levels: Sequence[Mapping[str, Any]]) -> None:
    reached = [row for row in levels if row["accuracy"] is not None]
    ms = [row["median_ms"] for row in reached]
    axes.plot(ms, [row["accuracy"] for row in reached], color=OFF, marker="o", markersize=3.5, label="right of these")
    axes.plot(ms, [row["decided"] for row in reached], color=GREY, linestyle=DASHED, label="windows that reach it")
    for row, x in zip(reached, ms, strict=True):
        note(axes, f"{row['level']:g}", (x, row["accuracy"]), (2, -11))
    axes.margins(x=0.12)
    _look(axes, xlabel="median ms until a confidence is reached")


def _look(axes: Axes, **settings: Any) -> None:
    axes.set(ylim=(0, 1.05), **settings)
    if axes.get_xscale() == "linear":
        axes.set_xlim(0, None)
    else:
        axes.xaxis.set_major_formatter(lambda count, _: f"{count:,.0f}")
    axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    axes.grid(color=PALE, linewidth=0.5)
    axes.legend(loc="lower right")
