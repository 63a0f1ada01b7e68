"""Draw simulated events: in each row a window or a picture, and the events simulated from it."""

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
"""Number of events at which a pixel has the full colour."""


@dataclass(frozen=True)
class ResynthesizedWindow:
    """One window, and the events that were simulated from it, in sensor pixels.

    Parameters
    ----------
    name : name of its class.
    recorded : the recorded events of the window, with fields x, y, p.
    image : (H, W), log luminance halfway through the window.
    same_motion : simulated events of the image, under the motion that was found in the window.
    motions : the path of the motion that was found, then the path of each new motion. A path is the
        displacement since the window's start, (n, 2).
    others : simulated events of the image, under each new motion.
    """

    name: str
    recorded: np.ndarray
    image: np.ndarray
    same_motion: np.ndarray
    motions: Sequence[np.ndarray]
    others: Sequence[np.ndarray]


@dataclass(frozen=True)
class RefusedWindow:
    """A window in which no reliable path was found.

    Parameters
    ----------
    name : name of its class.
    recorded : the recorded events of the window, with fields x, y, p.
    reason : why there is no reliable path.
    """

    name: str
    recorded: np.ndarray
    reason: str


def draw_resynthesis(
    windows: Sequence[ResynthesizedWindow], refused: Sequence[RefusedWindow] = ()
) -> Figure:
    """Draw a row for each window.

    A row has the recorded events, then the image and the path that were found in these events. Then
    it has simulated events of this image, along the same path and along each other path.

    Parameters
    ----------
    windows : at least one window. All have the same number of other paths.
    refused : windows in which no path was found. Their rows have only the recorded events.
    """
    n_others = len(windows[0].others)
    height, width = windows[0].image.shape
    picture_height = SIDE * height / width
    rows: list[ResynthesizedWindow | RefusedWindow] = [*windows, *refused]
    titles = ["as recorded", "image, path found", "the same path"]
    titles += [f"other path {i + 1}" for i in range(n_others)]
    figure = _figure_of(len(rows), len(titles), picture_height)
    headline(figure, "motion re-synthesis")
    for column, title in enumerate(titles):
        left = LEFT + column * (SIDE + GAP) + SIDE / 2
        write_at(figure, left, TOP - 0.2, title, ha="center")

    for row, window in enumerate(rows):
        top = TOP + row * (picture_height + GAP)
        write_at(
            figure, LEFT - 0.1, top + picture_height / 2, shortened(window.name, 14), ha="right"
        )
        _draw_picture(figure, 0, top, _counts(window.recorded, (height, width)), is_image=False)
        if isinstance(window, RefusedWindow):
            write_at(
                figure, LEFT + SIDE + 2 * GAP, top + picture_height / 2, f"no path: {window.reason}"
            )
            continue
        pictures = [window.image]
        for events in (window.same_motion, *window.others):
            pictures.append(_counts(events, (height, width)))
        # the path that was found is drawn twice: in the image, and in its simulated events
        paths = [window.motions[0], *window.motions]
        for column, (picture, path) in enumerate(zip(pictures, paths, strict=True), 1):
            axes = _draw_picture(figure, column, top, picture, is_image=column == 1)
            _draw_path(axes, path, (width, height))
    polarity_legend(figure)
    return figure


def draw_recorded_pictures(
    pictures: Sequence[tuple[str, np.ndarray, Sequence[np.ndarray]]], sensor: tuple[int, int]
) -> Figure:
    """Draw a row for each picture: the picture, and its simulated recordings.

    Parameters
    ----------
    pictures : for each picture (class, luminance, recordings). The luminance has shape (h, w). A
        recording is an array of events with fields x, y, p. All pictures have the same number of
        recordings.
    sensor : (width, height), in pixels.
    """
    picture_height = SIDE * sensor[1] / sensor[0]
    n_recordings = len(pictures[0][2])
    figure = _figure_of(len(pictures), 1 + n_recordings, picture_height)
    headline(figure, "pictures, as simulated cameras record them")
    for row, (name, luminance, recordings) in enumerate(pictures):
        top = TOP + row * (picture_height + GAP)
        write_at(figure, LEFT - 0.1, top + picture_height / 2, shortened(name, 14), ha="right")
        inches_a_pixel = min(SIDE / luminance.shape[1], picture_height / luminance.shape[0])
        axes = axes_at(
            figure,
            LEFT,
            top,
            inches_a_pixel * luminance.shape[1],
            inches_a_pixel * luminance.shape[0],
        )
        # the luminance of a screen is about the square of the grey value
        axes.imshow(np.sqrt(luminance), cmap="gray", vmin=0, vmax=1)
        axes.axis("off")
        for column, events in enumerate(recordings, 1):
            _draw_picture(figure, column, top, _counts(events, sensor[::-1]), is_image=False)
    polarity_legend(figure)
    return figure


def _figure_of(n_rows: int, n_columns: int, picture_height: float) -> Figure:
    """A figure with room for rows and columns of pictures; `picture_height` is in inches."""
    return new_figure(
        TOP + n_rows * (picture_height + GAP) + 0.1, LEFT + n_columns * (SIDE + GAP) + 0.1
    )


def _draw_picture(
    figure: Figure, column: int, top: float, picture: np.ndarray, *, is_image: bool
) -> Any:
    """Draw a picture in a column, `top` inches below the figure's upper edge. Returns its axes.

    Parameters
    ----------
    picture : (H, W): an image, or the number of ON minus OFF events.
    is_image : whether the picture is an image.
    """
    height = SIDE * picture.shape[0] / picture.shape[1]
    axes = picture_at(figure, LEFT + column * (SIDE + GAP), top, SIDE, height)
    if is_image:
        axes.imshow(picture, cmap="gray")
    else:
        axes.imshow(picture, cmap=colour_map(*OFF_TO_ON), vmin=-STRONGEST, vmax=STRONGEST)
    return axes


def _counts(events: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The number of ON minus OFF events of each pixel."""
    counts = np.zeros(shape)
    np.add.at(counts, (events["y"], events["x"]), np.where(events["p"] == 1, 1.0, -1.0))
    return counts


def _draw_path(axes: Any, path: np.ndarray, sensor: tuple[int, int]) -> None:
    """Draw a path around the middle of the picture, with an arrow at the path's end."""
    middle_of_path = (path.min(0) + path.max(0)) / 2
    middle_of_sensor = (np.array(sensor) - 1) / 2
    x, y = (path - middle_of_path + middle_of_sensor).T
    axes.plot(x, y, color="black", lw=1.4)
    # the arrow comes from the last point that is not too near to the end
    far_points = np.flatnonzero(np.hypot(x - x[-1], y - y[-1]) > 0.02 * max(sensor))
    if len(far_points):
        arrow_start = x[far_points[-1]], y[far_points[-1]]
        axes.annotate(
            "",
            (x[-1], y[-1]),
            arrow_start,
            arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.4},
        )
