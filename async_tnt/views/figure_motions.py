"""The point of the transform: one digit under two motions, raw against transformed. Two motions, one shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.views.figure_events import MOST_DOTS, transform_words
from async_tnt.views.figure_slices import bin_ms, colour_limit, draw_slice, layers_of, shown_bins
from async_tnt.views.figure_style import LARGE, OFF, ON, SMALL, TEXT, WIDTH, new_figure
from async_tnt.views.figure_subject import Window, shown_evenly

if TYPE_CHECKING:
    from matplotlib.figure import Figure

N_SLICES = 4
MEAN_PARTS, MEAN_SHARE = 12, 0.03  # the mean path: parts of the window, and the least share of events in one


def draw_motions(first: Window, second: Window, bins: Sequence[int] | None = None) -> Figure:
    """Two windows, a row each: events along the axis in which their motions differ most, and slices of the
    volumes, raw and transformed.

    Raises
    ------
    ValueError : the two are drawn with different configurations.
    """
    config = first.subject.config
    if second.subject.config != config:
        raise ValueError(
            "two motions are drawn with one configuration, got sensors of "
            + " and ".join(f"{w}x{h} pixels" for w, h in (config.sensor, second.subject.config.sensor))
        )
    windows = (first, second)
    flows = [np.array(window.flow()) for window in windows]
    axis = int(np.abs(flows[0] - flows[1]).argmax())
    volumes = [window.volumes() for window in windows]
    shown = (
        busiest_bins(np.abs(np.stack([tnt for _, tnt in volumes])), config.bins)
        if bins is None
        else shown_bins(config, bins)
    )

    page = 7.2
    figure = new_figure(page)
    figure.text(0.02, 0.965, title(windows), fontsize=LARGE + 2, fontweight="bold", va="center")
    words = transform_words(config)
    for x, above, below in (
        (0.205, "events as they came", ""),
        (0.425, "after TNT", words),
        (0.775, "slices of the event volume", ""),
    ):
        figure.text(x, 0.915, above, ha="center", fontsize=LARGE)
        figure.text(x, 0.888, below, ha="center", fontsize=SMALL, color=TEXT)

    several_files = first.subject is not second.subject
    for row, (window, flow) in enumerate(zip(windows, flows, strict=True)):
        bottom = 0.515 - 0.425 * row
        raw = figure.add_axes((0.105, bottom, 0.2, 0.35))
        tnt = figure.add_axes((0.325, bottom, 0.2, 0.35), sharex=raw, sharey=raw)
        _draw_along(raw, tnt, window, axis)
        name = f"{window.subject.name}: " if several_files else f"window {window.number}: "
        figure.text(
            0.02,
            bottom + 0.175,
            name + direction(flow, axis),
            rotation=90,
            ha="center",
            va="center",
            fontsize=LARGE,
            fontweight="bold",
        )
        if row == 1:
            raw.set_xlabel("time in the window (ms)")
            tnt.set_xlabel("time in the window (ms)")
        _draw_slices(figure, window, volumes[row], shown, (0.565, bottom, 0.42, 0.35))
    _legend(figure)
    return figure


def title(windows: tuple[Window, Window]) -> str:
    first, second = windows
    if first.subject is second.subject:
        return f"{first.subject.name}: one shape under two motions"
    return f"{first.subject.name} and {second.subject.name}: two motions"


def busiest_bins(volumes: np.ndarray, n_bins: int, n_shown: int = N_SLICES) -> list[int]:
    """The evenly spaced bins with most events: a saccade's bell-shaped speed leaves few in the others.

    volumes : (..., C, H, W), not negative; C is B, or 2 B.
    """
    weight = volumes.sum(axis=(0, -2, -1)).reshape(-1, n_bins).sum(axis=0)  # (B,)
    step = max(1, (n_bins - 1) // (2 * N_SLICES))
    n_shown = min(n_shown, n_bins)
    runs = [list(range(k, k + step * (n_shown - 1) + 1, step)) for k in range(n_bins - step * (n_shown - 1))]
    return max(runs, key=lambda run: weight[run].sum())


def direction(flow: np.ndarray, axis: int) -> str:
    """The direction of a flow (x, y) along the drawn axis; y grows downwards."""
    if abs(flow[axis]) < 0.5:  # pixels in a window
        return f"at rest along {'xy'[axis]}"
    return "moving " + (("left", "right"), ("up", "down"))[axis][int(flow[axis] > 0)]


def _draw_along(raw: Any, tnt: Any, window: Window, axis: int) -> None:
    """Events along one axis against time, in grid pixels."""
    config = window.subject.config
    u, v, kept, _ = window.coordinates()
    # pixels are whole numbers: dots are spread over their pixel so that they do not hide one another
    spread = np.random.default_rng(0).uniform(-0.4, 0.4, kept.size) * config.to_grid(1.0, 1.0)[axis]
    _draw_dots(raw, window, window.grid_xy[axis] + spread, np.ones(kept.size, bool))
    _draw_dots(tnt, window, (u, v)[axis], kept)
    raw.set(xlim=(0, config.window_us / 1e3), ylim=(config.grid[axis] - 0.5, -0.5))
    raw.set_ylabel(("x, after TNT u (px)", "y, after TNT v (px)")[axis])
    tnt.tick_params(labelleft=False)


def _draw_dots(axes: Any, window: Window, place: np.ndarray, kept: np.ndarray) -> None:
    """Dots, and the mean place of those in each twelfth of the window, but not where many fell off the grid."""
    shown = np.flatnonzero(kept)[shown_evenly(int(kept.sum()), MOST_DOTS)]
    colours = np.where(window.events["p"][shown] == 1, ON, OFF)
    axes.scatter(window.time_ms[shown], place[shown], s=3.2, c=colours, lw=0, rasterized=True)
    part = (MEAN_PARTS * window.time_ms / (window.subject.config.window_us / 1e3)).astype(int)
    parts = [part == k for k in range(MEAN_PARTS)]
    enough = max(10, MEAN_SHARE * kept.size)
    means = [
        (window.time_ms[p & kept].mean(), place[p & kept].mean())
        for p in parts
        if p.sum() >= enough and kept[p].mean() > 0.9
    ]
    if len(means) > 1:
        axes.plot(*zip(*means, strict=True), color="white", lw=4.5, solid_capstyle="round")
        axes.plot(*zip(*means, strict=True), color="black", lw=2, solid_capstyle="round")


def _draw_slices(
    figure: Figure,
    window: Window,
    volumes: tuple[np.ndarray, np.ndarray],
    shown: Sequence[int],
    box: tuple[float, float, float, float],
) -> None:
    """Chosen bins of the raw and of the transformed volume, into a part (left, bottom, width, height) of a figure."""
    config, page = window.subject.config, figure.get_figheight()
    layers = [
        layer for volume, name in zip(volumes, ("raw", "TNT"), strict=True) for layer in layers_of(volume, config, name)
    ]
    left, bottom, width, height = box
    ratio = config.grid[1] / config.grid[0] * WIDTH / page  # of a picture's sides, as parts of the figure's
    wide = min(
        (width - 0.006 * (len(shown) - 1)) / len(shown), (height - 0.01 * (len(layers) - 1)) / len(layers) / ratio
    )
    for row, layer in enumerate(layers):
        limit = colour_limit(layer.cells[shown])
        top = bottom + height - row * (wide * ratio + 0.01)
        for column, k in enumerate(shown):
            axes = figure.add_axes((left + column * (wide + 0.006), top - wide * ratio, wide, wide * ratio))
            draw_slice(axes, layer.cells[k], layer.colours, limit)
            if row == 0:
                axes.set_title(bin_ms(config, k), fontsize=SMALL, pad=3)
            if column == 0:
                axes.set_ylabel(layer.name, fontsize=SMALL)


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    dots = [
        Line2D([], [], marker="o", ls="", ms=5, color=colour, mec="none", label=name)
        for colour, name in ((ON, "ON"), (OFF, "OFF"))
    ]
    mean = Line2D([], [], color="black", lw=2, label="mean place")
    figure.legend(
        handles=[*dots, mean],
        loc="center right",
        bbox_to_anchor=(0.985, 0.965),
        ncols=3,
        labelcolor=TEXT,
        handletextpad=0.4,
        columnspacing=1.2,
        borderpad=0,
    )
