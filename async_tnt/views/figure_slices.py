"""Slices of a window's event volumes: a picture of each bin, raw above transformed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.views.figure_events import transform_words
from async_tnt.views.figure_style import (
    LARGE,
    OFF,
    ON,
    PALE,
    SMALL,
    TEXT,
    WIDTH,
    few_ticks,
    new_figure,
    one_colour_map,
    polarity_map,
)
from async_tnt.views.figure_subject import Subject, Window, shown_evenly

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

MOST_SLICES = 12  # in a row by default
INK = {"unsigned": "#222222", "ON": ON, "OFF": OFF}
LEFT, RIGHT, GAP, ROW_GAP, HEAD, TALLEST = 0.75, 0.85, 0.06, 0.12, 0.36, 1.9  # inches


class Layer(NamedTuple):
    """What one row of pictures shows."""

    cells: np.ndarray
    """float32, shape (B, H, W)."""
    name: str
    colours: str
    """signed, unsigned, ON or OFF."""


def draw_slices(subject: Subject, number: int = 1, bins: Sequence[int] | None = None) -> Figure:
    """All bins, or chosen ones, of one window's raw and transformed volume."""
    window = subject.window(number)
    shown = shown_bins(subject.config, bins)
    figure = new_figure(1.0 + layers_height(subject.config, len(shown)))
    draw_layers(figure, window, shown, top=0.5)
    height = figure.get_figheight()
    figure.text(
        0.02,
        1 - 0.28 / height,
        f"{subject.name}, window {number}: event volume, raw and after TNT ({transform_words(subject.config)})",
        fontsize=LARGE,
        va="center",
    )
    figure.text(LEFT / WIDTH, 0.15 / height, caption(subject.config), fontsize=SMALL, color=TEXT)
    return figure


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
            raise ValueError(f"--slices must be in [0, {config.bins}), the volume's bins, got {k}")
    return list(bins)


def layers_of(volume: np.ndarray, config: TNTConfig, name: str) -> list[Layer]:
    """A volume as pictures: one row, or with split polarity two."""
    if config.polarity == "split":
        return [Layer(volume[: config.bins], f"{name}, ON", "ON"), Layer(volume[config.bins :], f"{name}, OFF", "OFF")]
    return [Layer(volume, name, config.polarity)]


def layers_height(config: TNTConfig, n_shown: int) -> float:
    """Inches that `draw_layers` takes."""
    n_layers = 4 if config.polarity == "split" else 2
    return HEAD + n_layers * (_picture(config, n_shown)[1] + ROW_GAP)


def draw_layers(figure: Figure, window: Window, shown: Sequence[int], top: float) -> None:
    """Rows of pictures over the figure's width, from `top` inches below its upper edge on."""
    config, page = window.subject.config, figure.get_figheight()
    layers = [
        layer
        for volume, name in zip(window.volumes(), ("raw", "TNT"), strict=True)
        for layer in layers_of(volume, config, name)
    ]
    width, height = _picture(config, len(shown))

    def axes_at(left: float, row: int, wide: float) -> Any:
        bottom = page - top - HEAD - height - row * (height + ROW_GAP)
        return figure.add_axes((left / WIDTH, bottom / page, wide / WIDTH, height / page))

    for row, layer in enumerate(layers):
        limit = colour_limit(layer.cells[shown])
        for column, k in enumerate(shown):
            axes = axes_at(LEFT + column * (width + GAP), row, width)
            image = draw_slice(axes, layer.cells[k], layer.colours, limit)
            if row == 0:
                axes.set_title(bin_title(config, k), fontsize=SMALL, pad=3)
            if column == 0:
                axes.set_ylabel(layer.name, fontsize=LARGE)
        bar_axes = axes_at(LEFT + len(shown) * (width + GAP) + 0.04, row, 0.1)
        bar = figure.colorbar(image, cax=bar_axes, extend="both" if layer.colours == "signed" else "max")
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=SMALL, length=2, colors=TEXT)
        bar.locator = few_ticks()
        if height > 0.85:  # else it would reach into the next row; the caption has it, too
            bar.set_label("events / cell", fontsize=SMALL, color=TEXT, labelpad=2)


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


def bin_title(config: TNTConfig, k: int) -> str:
    """A bin's number and its time."""
    return f"bin {k}\n{bin_ms(config, k)}"


def bin_ms(config: TNTConfig, k: int) -> str:
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
