"""What was simulated: a window or a picture a row, and the events that were made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.views.figure_style import (
    OFF_TO_ON,
    axes_at,
    colour_map,
    headline,
    new_figure,
    picture_at,
    polarity_legend,
    shortened,
    write_at,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT = 0.9
"""Inches left of the pictures, for the names of classes."""
TOP = 0.95
"""Inches above the pictures."""
SIDE = 1.42
"""Width of a picture, in inches."""
GAP = 0.12
"""Inches between pictures."""
STRONGEST = 4.0
"""Events of a pixel that have the full colour."""


@dataclass(frozen=True)
class ResynthesizedWindow:
    """One window, and what was simulated of it, in sensor pixels.

    Parameters
    ----------
    name : name of its class.
    recorded : its events, with fields x, y, p.
    image : (H, W), log luminance halfway through the window.
    same_motion : events of that image under the motion that was found.
    motions : displacement since the window's start, (n, 2): of the motion that was found, and of
        each new one.
    others : events under each new motion.
    """

    name: str
    recorded: np.ndarray
    image: np.ndarray
    same_motion: np.ndarray
    motions: Sequence[np.ndarray]
    others: Sequence[np.ndarray]


@dataclass(frozen=True)
class RefusedWindow:
    """A window without a path that may be relied on.

    Parameters
    ----------
    name : name of its class.
    recorded : its events, with fields x, y, p.
    reason : why its path may not be relied on.
    """

    name: str
    recorded: np.ndarray
    reason: str


def draw_resynthesis(
    windows: Sequence[ResynthesizedWindow], refused: Sequence[RefusedWindow] = ()
) -> Figure:
    """Draw a row for each window.

    It has the recorded events, the image and the path found in them, and events of that image
    under this path and under others.

    Parameters
    ----------
    windows : at least one, all with as many other paths.
    refused : windows in which no path was found.
    """
    n_others = len(windows[0].others)
    height, width = windows[0].image.shape
    high = SIDE * height / width
    rows: list[ResynthesizedWindow | RefusedWindow] = [*windows, *refused]
    figure = _figure_of(len(rows), 3 + n_others, high)
    headline(figure, "motion re-synthesis")
    titles = ["as recorded", "image, path found", "the same path"]
    titles += [f"other path {i + 1}" for i in range(n_others)]
    for column, title in enumerate(titles):
        left = LEFT + column * (SIDE + GAP) + SIDE / 2
        write_at(figure, left, TOP - 0.2, title, ha="center")

    for row, window in enumerate(rows):
        top = TOP + row * (high + GAP)
        write_at(figure, LEFT - 0.1, top + high / 2, shortened(window.name, 14), ha="right")
        _draw_picture(figure, 0, top, _counts(window.recorded, (height, width)), is_image=False)
        if isinstance(window, RefusedWindow):
            write_at(figure, LEFT + SIDE + 2 * GAP, top + high / 2, f"no path: {window.reason}")
            continue
        pictures = [window.image]
        for events in (window.same_motion, *window.others):
            pictures.append(_counts(events, (height, width)))
        paths = [window.motions[0], *window.motions]
        for column, (picture, path) in enumerate(zip(pictures, paths, strict=True), 1):
            axes = _draw_picture(figure, column, top, picture, is_image=column == 1)
            _draw_path(axes, path, (width, height))
    polarity_legend(figure)
    return figure


def draw_recorded_pictures(
    pictures: Sequence[tuple[str, np.ndarray, Sequence[np.ndarray]]], sensor: tuple[int, int]
) -> Figure:
    """Draw a row for each picture: the picture, and its recordings.

    Parameters
    ----------
    pictures : for each its class, its luminance (h, w), and the events, with fields x, y, p, of
        each of its recordings. All have as many recordings.
    sensor : (width, height), in pixels.
    """
    high = SIDE * sensor[1] / sensor[0]
    n_recordings = len(pictures[0][2])
    figure = _figure_of(len(pictures), 1 + n_recordings, high)
    headline(figure, "pictures, as simulated cameras record them")
    for row, (name, light, recordings) in enumerate(pictures):
        top = TOP + row * (high + GAP)
        write_at(figure, LEFT - 0.1, top + high / 2, shortened(name, 14), ha="right")
        fits = min(SIDE / light.shape[1], high / light.shape[0])
        axes = axes_at(figure, LEFT, top, fits * light.shape[1], fits * light.shape[0])
        axes.imshow(np.sqrt(light), cmap="gray", vmin=0, vmax=1)
        axes.axis("off")
        for column, events in enumerate(recordings, 1):
            _draw_picture(figure, column, top, _counts(events, sensor[::-1]), is_image=False)
    polarity_legend(figure)
    return figure


def _figure_of(n_rows: int, n_columns: int, high: float) -> Figure:
    """A figure with room for rows of pictures, each `high` inches."""
    return new_figure(TOP + n_rows * (high + GAP) + 0.1, LEFT + n_columns * (SIDE + GAP) + 0.1)


def _draw_picture(
    figure: Figure, column: int, top: float, picture: np.ndarray, *, is_image: bool
) -> Any:
    """Axes with a picture in a column, from `top` inches on: an image, or ON minus OFF events."""
    high = SIDE * picture.shape[0] / picture.shape[1]
    axes = picture_at(figure, LEFT + column * (SIDE + GAP), top, SIDE, high)
    if is_image:
        axes.imshow(picture, cmap="gray")
    else:
        axes.imshow(picture, cmap=colour_map(*OFF_TO_ON), vmin=-STRONGEST, vmax=STRONGEST)
    return axes


def _counts(events: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """ON minus OFF events of each pixel."""
    counts = np.zeros(shape)
    np.add.at(counts, (events["y"], events["x"]), np.where(events["p"] == 1, 1.0, -1.0))
    return counts


def _draw_path(axes: Any, path: np.ndarray, sensor: tuple[int, int]) -> None:
    """Draw a path about the middle of the picture, with an arrow at its end."""
    x, y = (path - (path.min(0) + path.max(0)) / 2 + (np.array(sensor) - 1) / 2).T
    axes.plot(x, y, color="black", lw=1.4)
    far = np.flatnonzero(np.hypot(x - x[-1], y - y[-1]) > 0.02 * max(sensor))
    if len(far):
        before = x[far[-1]], y[far[-1]]
        axes.annotate(
            "",
            (x[-1], y[-1]),
            before,
            arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.4},
        )
