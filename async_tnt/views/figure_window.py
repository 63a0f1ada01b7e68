"""Draw one window: its events in space-time, and the bins of its volumes.

Both are drawn twice: raw, with events at (x, y, t), and transformed, with events at (u, v, t).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from async_tnt.views.figure_style import (
    OFF,
    OFF_TO_ON,
    ON,
    SMALL,
    TEXT,
    WIDTH,
    axes_at,
    colour_map,
    few_ticks,
    picture_at,
    polarity_legend,
    write_at,
)
from async_tnt.views.figure_subject import Window, evenly_spread
from async_tnt.volume.config import TNTConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

MOST_DOTS = 12_000
"""Number of events of a window that are drawn, at most. More would hide one another."""
INK = {"unsigned": "#222222", "ON": ON, "OFF": OFF}
"""Colours of volumes without a sign."""

LEFT = 0.75
"""Inches left of the pictures."""
RIGHT = 0.85
"""Inches right of the pictures, for the colour bars."""
GAP = 0.06
"""Inches between the pictures of a row."""
ROW_GAP = 0.12
"""Inches between rows."""
HEAD = 0.36
"""Inches above the pictures, for the titles."""
TALLEST = 1.9
"""Height of a picture in inches, at most."""


def draw_both(figure: Figure, window: Window, height: float) -> None:
    """Draw raw and transformed events side by side at the top of a figure.

    Titles and a legend are added.

    Parameters
    ----------
    height : height of the plots, in inches.
    """
    config = window.subject.config
    events = window.events
    u, v, kept, _ = window.coordinates()
    raw_axes = axes_at(figure, 0.0, 0.7, 5.0, height, projection="3d")
    tnt_axes = axes_at(figure, 5.2, 0.7, 5.0, height, projection="3d")

    _draw_events(raw_axes, window, events["x"], events["y"], np.ones(events.size, bool))
    _frame(raw_axes, window, config.sensor, "x", "y")
    raw_title = f"raw: {events.size:,} events in window {window.number}"
    write_at(figure, 2.6, 0.7, raw_title, ha="center")

    _draw_events(tnt_axes, window, u, v, kept)
    _frame(tnt_axes, window, config.grid, "u", "v")
    tnt_title = f"after TNT ({transform_words(config)}): {int(kept.sum()):,} events kept"
    write_at(figure, 7.8, 0.7, tnt_title, ha="center")

    polarity_legend(figure)


def transform_words(config: TNTConfig) -> str:
    """The transform's settings as text, for titles."""
    flow = ", flow removed" if config.remove_flow else ""
    return f"{config.landmark}{flow}, t_max {config.t_max:g}"


def _draw_events(axes: Any, window: Window, x: np.ndarray, y: np.ndarray, kept: np.ndarray) -> None:
    """Draw the `kept` events as dots, at (time, x, y).

    Time goes to the right, x into the depth, and y downwards, as if the sensor's images of
    successive moments stood in a row.
    """
    indices = np.flatnonzero(kept)[evenly_spread(int(kept.sum()), MOST_DOTS)]
    colours = np.where(window.events["p"][indices] == 1, ON, OFF)
    # Up to 3,000 dots have the full size. More dots are smaller, and cover the same area together.
    size = 3.0 * min(1.0, (3_000 / max(1, indices.size)) ** 0.5)
    axes.scatter(
        window.time_ms[indices],
        x[indices],
        y[indices],
        s=size,
        c=colours,
        lw=0,
        depthshade=False,
        rasterized=True,
    )


def _frame(axes: Any, window: Window, sides: tuple[int, int], x_name: str, y_name: str) -> None:
    """Set the limits, the labels and the view of axes for a grid of `sides` (width, height)."""
    axes.set(
        xlim=(0, window.subject.config.window_us / 1e3),
        ylim=(0, sides[0] - 1),
        zlim=(sides[1] - 1, 0),  # y goes downwards
    )
    axes.set_xlabel("time in the window (ms)", labelpad=-1)
    axes.set_ylabel(f"{x_name} (px)", labelpad=-4)
    axes.set_zlabel(f"{y_name} (px)", labelpad=-6)
    axes.tick_params(labelsize=SMALL, pad=-2, colors=TEXT)
    # Parallel lines stay parallel, so that a shape in constant motion looks like a slanted tube.
    axes.set_proj_type("ortho")
    axes.set_box_aspect((1.9, sides[0] / max(sides), sides[1] / max(sides)), zoom=1.2)
    axes.view_init(elev=16, azim=-38)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        # labels at the corners of the box would overlap
        axis.set_major_locator(few_ticks(prune="both"))
        axis.set_pane_color((1, 1, 1, 0))


class Layer(NamedTuple):
    """The bins of a volume that one row of pictures shows."""

    cells: np.ndarray
    """float32, shape (B, H, W)."""
    name: str
    """Label of the row."""
    colours: str
    """Which colours the cells have: signed, unsigned, ON or OFF."""


def layers_of(volume: np.ndarray, config: TNTConfig, name: str) -> list[Layer]:
    """The rows of pictures that show a volume: one row, or two for split polarity."""
    if config.polarity == "split":
        return [
            Layer(volume[: config.bins], f"{name}, ON", "ON"),
            Layer(volume[config.bins :], f"{name}, OFF", "OFF"),
        ]
    return [Layer(volume, name, config.polarity)]


def layers_of_window(window: Window) -> list[Layer]:
    """The rows of pictures that show a window's raw and transformed volume."""
    config = window.subject.config
    raw, tnt = window.volumes()
    return layers_of(raw, config, "raw") + layers_of(tnt, config, "TNT")


def layers_height(config: TNTConfig, n_shown: int) -> float:
    """Height of the rows and titles that `draw_layers` draws, in inches."""
    # the raw and the transformed volume, with two rows each if the polarity is split
    n_layers = 4 if config.polarity == "split" else 2
    _, height = _picture_size(config, n_shown)
    return HEAD + n_layers * (height + ROW_GAP)


def draw_layers(figure: Figure, window: Window, shown_bins: Sequence[int], top: float) -> None:
    """Draw the rows of pictures of a window, and a colour bar for each row.

    The rows take the figure's width, and begin `top` inches below its upper edge.

    Parameters
    ----------
    shown_bins : the bins that are drawn.
    """
    config = window.subject.config
    layers = layers_of_window(window)
    width, height = _picture_size(config, len(shown_bins))
    titles = [f"bin {k}\n{bin_time(config, k)}" for k in shown_bins]
    images = draw_rows(figure, layers, shown_bins, titles, (LEFT, top + HEAD), (width, height))
    bars_left = LEFT + len(shown_bins) * (width + GAP) + 0.04
    for row, image in enumerate(images):
        bar = axes_at(figure, bars_left, top + HEAD + row * (height + ROW_GAP), 0.1, height)
        figure.colorbar(image, cax=bar, ticks=few_ticks())
        bar.tick_params(labelsize=SMALL, length=2, colors=TEXT)


def draw_rows(
    figure: Figure,
    layers: Sequence[Layer],
    shown_bins: Sequence[int],
    titles: Sequence[str],
    corner: tuple[float, float],
    picture_size: tuple[float, float],
) -> list[AxesImage]:
    """Draw a row of pictures for each layer. Returns one image of each row, for its colour bar.

    The pictures of a row have the same scale of colours.

    Parameters
    ----------
    layers : what the rows show.
    shown_bins, titles : the bins of the columns, and the titles of the columns.
    corner : (left, top) of the first picture, in inches.
    picture_size : (width, height) of each picture, in inches.
    """
    left, top = corner
    width, height = picture_size
    images = []
    for row, layer in enumerate(layers):
        magnitudes = np.abs(layer.cells[shown_bins])
        # The full colour begins below the largest cells, because these would leave all others pale.
        limit = float(np.quantile(magnitudes[magnitudes > 0], 0.98)) if magnitudes.any() else 1.0
        if layer.colours == "signed":
            shades = colour_map(*OFF_TO_ON)
            lowest = -limit
        else:
            shades = colour_map("#ffffff", INK[layer.colours])
            lowest = 0.0
        for column, (k, title) in enumerate(zip(shown_bins, titles, strict=True)):
            axes = picture_at(
                figure, left + column * (width + GAP), top + row * (height + ROW_GAP), width, height
            )
            image = axes.imshow(
                layer.cells[k],
                cmap=shades,
                vmin=lowest,
                vmax=limit,
                aspect="auto",
            )
            if row == 0:
                axes.set_title(title, fontsize=SMALL, pad=3)
            if column == 0:
                axes.set_ylabel(layer.name)
        images.append(image)
    return images


def _picture_size(config: TNTConfig, n_shown: int) -> tuple[float, float]:
    """Width and height of one picture, in inches."""
    ratio = config.grid[1] / config.grid[0]
    most_width = (WIDTH - LEFT - RIGHT - GAP * (n_shown - 1)) / n_shown
    height = min(TALLEST, most_width * ratio)
    return height / ratio, height


def bin_time(config: TNTConfig, k: int) -> str:
    """The time of bin k in the window, as text."""
    return f"{k * config.window_us / 1e3 / max(1, config.bins - 1):.3g} ms"
