"""A picture of a confusion matrix."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from async_tnt.views.figure_style import (
    OFF,
    SMALL,
    TEXT,
    axes_at,
    new_figure,
    one_colour_map,
    shortened,
    write_at,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_NUMBERED = 25  # with more classes, numbers in the cells would be too small to read
LONGEST_NAME = 24
CELL, LEAST = 0.42, 2.2  # inches


def draw_confusion(confusion: np.ndarray, classes: Sequence[str], title: str = "") -> Figure:
    """Draw a confusion matrix.

    A cell's colour is its share of its row, so that rare classes are as visible as common ones; its number is the
    count.

    Parameters
    ----------
    confusion : integers, shape (K, K), by true class (row) and decided class (column).
    classes : K names.
    title : one line above.

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
    return figure
