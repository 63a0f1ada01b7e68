"""Draw one digit under two motions, raw and transformed: two motions, one shape.

    python -m experiments.figure_motions 3 --picture docs/images/motions.png

The picture shows the first two windows of a recording. In these, the digit moves in different
directions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt import TNTVolume, load_model
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.views.figure_style import (
    OFF,
    ON,
    SMALL,
    TEXT,
    axes_at,
    headline,
    new_figure,
    polarity_legend,
    write_at,
)
from async_tnt.views.figure_subject import Subject, Window, evenly_spread
from async_tnt.views.figure_window import (
    GAP,
    MOST_DOTS,
    ROW_GAP,
    bin_time,
    draw_rows,
    layers_of_window,
    transform_words,
)
from experiments.scripts.options import draw_into, exit_with, picture_parser

if TYPE_CHECKING:
    from matplotlib.figure import Figure

N_SLICES = 4
"""Largest number of bins of a volume that are drawn."""

MEAN_PARTS = 12
"""Number of equal parts of the window. The mean path joins the mean positions in these parts."""

AT_REST_PX = 0.5
"""Flow, in pixels in a window, below which the words say that nothing moves."""

MEAN_SHARE = 0.03
"""Least share of the events that a part must have. The mean path leaves out emptier parts."""


def draw_motions(first: Window, second: Window) -> Figure:
    """Draw two windows of a recording, a row each.

    A row has the events along the axis in which the two motions differ most, and slices of the
    volumes, raw and transformed.
    """
    from matplotlib.lines import Line2D

    config = first.subject.config
    windows = (first, second)
    flows = [np.array(flow_of(window)) for window in windows]
    axis = int(np.abs(flows[0] - flows[1]).argmax())
    layers = [layers_of_window(window) for window in windows]
    shown = busiest_bins(np.abs(np.stack([window.volumes()[1] for window in windows])), config.bins)
    figure = new_figure(7.2)
    headline(figure, f"{first.subject.name}: one shape under two motions")
    for left, above, below in (
        (2.13, "raw events", ""),
        (4.42, "after TNT", transform_words(config)),
        (8.06, "slices of the event volume", ""),
    ):
        write_at(figure, left, 0.61, above, ha="center", va="baseline")
        write_at(figure, left, 0.81, below, ha="center", va="baseline", fontsize=SMALL, color=TEXT)
    for window, flow, rows, top in zip(windows, flows, layers, (0.97, 4.03), strict=True):
        raw = axes_at(figure, 1.09, top, 2.08, 2.52)
        tnt = axes_at(figure, 3.38, top, 2.08, 2.52, sharex=raw, sharey=raw)
        _draw_along(raw, tnt, window, axis)
        words = f"window {window.number}: {direction(flow, axis)}"
        look = {"rotation": 90, "ha": "center", "fontweight": "bold"}
        write_at(figure, 0.21, top + 1.26, words, **look)
        if window is second:
            raw.set_xlabel("time in the window (ms)")
            tnt.set_xlabel("time in the window (ms)")
        titles = [bin_time(config, k) for k in shown]
        draw_rows(figure, rows, shown, titles, (5.88, top), _picture(window, len(shown), len(rows)))
    polarity_legend(figure, [Line2D([], [], color="black", lw=2, label="mean position")])
    return figure


def _picture(window: Window, n_columns: int, n_rows: int) -> tuple[float, float]:
    """Width and height of one slice, in inches."""
    grid = window.subject.config.grid
    width = (4.37 - GAP * (n_columns - 1)) / n_columns
    height = min(width * grid[1] / grid[0], (2.52 - ROW_GAP * (n_rows - 1)) / n_rows)
    return height * grid[0] / grid[1], height


def busiest_bins(volumes: np.ndarray, n_bins: int) -> list[int]:
    """Indices of evenly spaced bins, at most `N_SLICES`, that have the most events together.

    The first and last bins of a saccade have few events, because it is slow there.

    volumes : (N, C, H, W), not negative; C is B, or 2 B.
    """
    channel_sums = volumes.sum(axis=(0, -2, -1))  # (C,)
    bin_sums = channel_sums.reshape(-1, n_bins).sum(axis=0)  # (B,)
    step = max(1, (n_bins - 1) // (2 * N_SLICES))
    n_shown = min(N_SLICES, n_bins)
    length = step * (n_shown - 1)
    runs = [list(range(k, k + length + 1, step)) for k in range(n_bins - length)]
    return max(runs, key=lambda run: bin_sums[run].sum())


def direction(flow: np.ndarray, axis: int) -> str:
    """Words for the direction of a flow (x, y) along the drawn axis; y grows downwards."""
    if abs(flow[axis]) < AT_REST_PX:
        return f"at rest along {'xy'[axis]}"
    back, forth = ("left", "right") if axis == 0 else ("up", "down")
    return f"moving {forth if flow[axis] > 0 else back}"


def _draw_along(raw: Any, tnt: Any, window: Window, axis: int) -> None:
    """Draw the events along one axis against time, in grid pixels."""
    config = window.subject.config
    u, v, kept, _ = window.coordinates()
    gain = config.to_grid(1.0, 1.0)[axis]
    # Pixels are whole numbers. Dots that are spread out over their pixel do not hide one another.
    spread = np.random.default_rng(0).uniform(-0.4, 0.4, kept.size) * gain
    _draw_dots(raw, window, window.events["xy"[axis]] * gain + spread, np.ones(kept.size, bool))
    _draw_dots(tnt, window, (u, v)[axis], kept)
    raw.set(xlim=(0, config.window_us / 1e3), ylim=(config.grid[axis] - 0.5, -0.5))
    raw.set_ylabel(("x, after TNT u (px)", "y, after TNT v (px)")[axis])
    tnt.tick_params(labelleft=False)


def _draw_dots(axes: Any, window: Window, places: np.ndarray, kept: np.ndarray) -> None:
    """Draw dots, and the path of their mean position in each part of the window.

    The path leaves out parts in which many dots fell off the grid.
    """
    shown = np.flatnonzero(kept)[evenly_spread(int(kept.sum()), MOST_DOTS)]
    colours = np.where(window.events["p"][shown] == 1, ON, OFF)
    axes.scatter(window.time_ms[shown], places[shown], s=3.2, c=colours, lw=0, rasterized=True)
    part = (MEAN_PARTS * window.time_ms / (window.subject.config.window_us / 1e3)).astype(int)
    part_masks = [part == k for k in range(MEAN_PARTS)]
    least_events = max(10, MEAN_SHARE * kept.size)
    means_ms = []
    means = []
    for in_part in part_masks:
        if in_part.sum() >= least_events and kept[in_part].mean() > 0.9:
            means_ms.append(window.time_ms[in_part & kept].mean())
            means.append(places[in_part & kept].mean())
    if len(means) > 1:
        axes.plot(means_ms, means, color="white", lw=4.5, solid_capstyle="round")
        axes.plot(means_ms, means, color="black", lw=2, solid_capstyle="round")


def flow_of(window: Window) -> tuple[float, float]:
    """The slope (x, y) of the line that is fitted to a window's events, in grid pixels per window.

    The events move in this direction.
    """
    volume = TNTVolume(window.subject.config.replace(landmark="line", remove_flow=False))
    volume.open(window.start_us)
    volume.update(window.events)
    return volume.flow


def main(argv: list[str] | None = None) -> int:
    """Draw the picture."""
    parser = picture_parser("figure_motions", __doc__)
    parser.add_argument(
        "digit", nargs="?", type=int, choices=range(10), default=3, help="default: %(default)s"
    )
    parser.add_argument(
        "--model", default="digits", help="a bundled model or a file (default: %(default)s)"
    )
    args = parser.parse_args(argv)
    path = sample_recordings()[args.digit]
    model = load_model(args.model)
    subject = Subject(path.name, open_recording(path).read(), model.config, model, args.model)
    draw_into(args.picture, draw_motions, subject.window(1), subject.window(2), dpi=150)
    return 0


if __name__ == "__main__":
    exit_with(main)
