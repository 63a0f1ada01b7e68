"""One window: its events in space-time, raw (x, y, t) and transformed (u, v, t), and the bins of both volumes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.views.figure_style import (
    GREY,
    LARGE,
    OFF,
    ON,
    PALE,
    SMALL,
    TEXT,
    WIDTH,
    axes_at,
    few_ticks,
    one_colour_map,
    polarity_legend,
    polarity_map,
    write_at,
)
from async_tnt.views.figure_subject import Window, shown_evenly

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

MOST_DOTS = 12_000  # in a window; more would hide one another
MOST_SLICES = 12  # in a row by default
INK = {"unsigned": "#222222", "ON": ON, "OFF": OFF}
LEFT, RIGHT, GAP, ROW_GAP, HEAD, TALLEST = 0.75, 0.85, 0.06, 0.12, 0.36, 1.9  # inches


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


class Layer(NamedTuple):
    """What one row of pictures shows."""

    cells: np.ndarray
    """float32, shape (B, H, W)."""
    name: str
    colours: str
    """signed, unsigned, ON or OFF."""


def shown_bins(config: TNTConfig, bins: Sequence[int] | None = None) -> list[int]:
    """The requested bins; else all, or as many as fit, evenly spread.

    Raises
    ------
    ValueError : there is no such bin.
    """
    if bins is None:
        return shown_evenly(config.bins, MOST_SLICES).tolist()
    for k in bins:
        if not 0 <= k < config.bins:
            raise ValueError(f"no bin {k}; the volume has bins 0 to {config.bins - 1}")
    return list(bins)


def layers_of(volume: np.ndarray, config: TNTConfig, name: str) -> list[Layer]:
    """A volume as pictures: one row, or with split polarity two."""
    if config.polarity == "split":
        return [Layer(volume[: config.bins], f"{name}, ON", "ON"), Layer(volume[config.bins :], f"{name}, OFF", "OFF")]
    return [Layer(volume, name, config.polarity)]


def layers_of_window(window: Window) -> list[Layer]:
    """Its raw and its transformed volume as pictures."""
    raw, tnt = window.volumes()
    return layers_of(raw, window.subject.config, "raw") + layers_of(tnt, window.subject.config, "TNT")


def layers_height(config: TNTConfig, n_shown: int) -> float:
    """Inches that `draw_layers` takes."""
    n_layers = 4 if config.polarity == "split" else 2
    return HEAD + n_layers * (_picture(config, n_shown)[1] + ROW_GAP)


def draw_layers(figure: Figure, window: Window, shown: Sequence[int], top: float) -> None:
    """Rows of pictures over the figure's width, from `top` inches below its upper edge on, and their colour bars."""
    config, layers = window.subject.config, layers_of_window(window)
    width, height = _picture(config, len(shown))
    titles = [f"bin {k}\n{bin_ms(config, k)}" for k in shown]
    images = draw_rows(figure, layers, shown, titles, (LEFT, top + HEAD), (width, height), LARGE)
    for row, (layer, image) in enumerate(zip(layers, images, strict=True)):
        right = LEFT + len(shown) * (width + GAP) + 0.04
        axes = axes_at(figure, right, top + HEAD + row * (height + ROW_GAP), 0.1, height)
        bar = figure.colorbar(image, cax=axes, extend="both" if layer.colours == "signed" else "max")
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=SMALL, length=2, colors=TEXT)
        bar.locator = few_ticks()
        if height > 0.85:  # else it would reach into the next row; the caption has it, too
            bar.set_label("events / cell", fontsize=SMALL, color=TEXT, labelpad=2)


def draw_rows(
    figure: Figure,
    layers: Sequence[Layer],
    shown: Sequence[int],
    titles: Sequence[str],
    corner: tuple[float, float],
    picture: tuple[float, float],
    fontsize: float,
) -> list[AxesImage]:
    """A row of pictures for each layer: its bins `shown`, in common colours. Returns an image of each row.

    corner, picture : (left, top) of the first picture and (width, height) of each, in inches.
    """
    (left, top), (width, height), images = corner, picture, []
    for row, layer in enumerate(layers):
        limit = colour_limit(layer.cells[shown])
        for column, (k, title) in enumerate(zip(shown, titles, strict=True)):
            place = left + column * (width + GAP), top + row * (height + ROW_GAP)
            axes = axes_at(figure, *place, width, height)
            image = draw_slice(axes, layer.cells[k], layer.colours, limit)
            if row == 0:
                axes.set_title(title, fontsize=SMALL, pad=3)
            if column == 0:
                axes.set_ylabel(layer.name, fontsize=fontsize)
        images.append(image)
    return images


def _picture(config: TNTConfig, n_shown: int) -> tuple[float, float]:
    """Width and height of one picture, in inches."""
    ratio = config.grid[1] / config.grid[0]
    height = min(TALLEST, (WIDTH - LEFT - RIGHT - GAP * (n_shown - 1)) / n_shown * ratio)
    return height / ratio, height


def colour_limit(cells: np.ndarray) -> float:
    """The value of full colour: exceeded by the largest cells only, which would leave the others pale."""
    used = np.abs(cells[cells != 0])
    return float(np.quantile(used, 0.98)) if used.size else 1.0


def draw_slice(axes: Any, cells: np.ndarray, colours: str, limit: float, **settings: Any) -> AxesImage:
    """One bin, shape (H, W), in the colours of the polarity."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=PALE)
    signed = colours == "signed"
    sharp = "nearest" if cells.shape[1] <= 100 else None  # a cell smaller than a dot must not vanish between dots
    return axes.imshow(
        cells,
        cmap=polarity_map() if signed else one_colour_map(INK[colours]),
        vmin=-limit if signed else 0.0,
        vmax=limit,
        interpolation=sharp,
        aspect="auto",
        **settings,
    )


def bin_ms(config: TNTConfig, k: int) -> str:
    """The time of a bin."""
    centre_ms = k * config.window_us / 1e3 / max(1, config.bins - 1)
    return f"{centre_ms:.0f} ms" if config.window_us >= 20_000 else f"{centre_ms:.3g} ms"


def caption(config: TNTConfig) -> str:
    """A caption: the kind of pictures, and their colours."""
    colours = {
        "signed": "colour: ON minus OFF events of a cell",
        "unsigned": "ink: ON and OFF events of a cell alike",
        "split": "ON and OFF events in volumes of their own",
    }[config.polarity]
    return f"{config.grid[0]} x {config.grid[1]} pixels, {config.bins} time bins; {colours}"
