"""A picture of a confusion matrix and of the accuracy against time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from async_tnt.views.figure_style import (
    GREY,
    OFF,
    PALE,
    SMALL,
    TEXT,
    axes_at,
    new_figure,
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
COURSE_WIDTH, COURSE_MARGIN = 3.0, 0.75

Course = Sequence[tuple[float, float, float]]
"""(microseconds since a window's start, share of windows right, share of windows decided at all) at each moment."""


def draw_confusion(
    confusion: np.ndarray, classes: Sequence[str], title: str = "", course: Course | None = None
) -> Figure:
    """Draw a confusion matrix and, next to it, accuracy against time.

    A cell's colour is its share of its row, so that rare classes are as visible as common ones; its number is the
    count.

    Parameters
    ----------
    confusion : integers, shape (K, K), by true class (row) and decided class (column).
    classes : K names.
    title : one line above.
    course : accuracy against time; None leaves it out.

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
    if course is not None:
        width += COURSE_MARGIN + COURSE_WIDTH
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
    if course is not None:
        _draw_course(axes_at(figure, matrix_width + COURSE_MARGIN - 0.25, top, COURSE_WIDTH, side), course)
    return figure


def _draw_course(axes: Axes, course: Course) -> None:
    us, right, decided = np.array(course).T
    axes.plot(us / 1e3, right, color=OFF, marker="o", markersize=3.5, label="right")
    axes.plot(us / 1e3, decided, color=GREY, linestyle=(0, (3, 2)), label="with events")
    axes.set(xlim=(0, None), ylim=(0, 1.03), xlabel="ms into the window", ylabel="windows")
    axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    axes.grid(color=PALE, linewidth=0.5)
    axes.legend(loc="lower right")


def write_confusion(
    confusion: np.ndarray,
    classes: Sequence[str],
    path: Path,
    title: str = "",
    course: Course | None = None,
    *,
    dpi: int = 150,
) -> Path:
    """`draw_confusion` into a file, .png, .svg or .pdf; replaced atomically if it exists. Returns its path."""
    with styled():
        save(draw_confusion(confusion, classes, title, course), path, dpi)
    return path
