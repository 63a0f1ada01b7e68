"""What a landmark network looks at: its heatmap over a window's events so far, at moments of the window.

    python -m experiments.figure_heatmap 3 --model MODEL --picture docs/images/heatmap.png --dpi 110

MODEL has a landmark network: async-tnt train DATASET --volume transform=tnt,landmark=regressor makes one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.networks.model import Model
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
    colour_map,
    headline,
    new_figure,
    write_at,
)
from async_tnt.views.figure_subject import Window
from async_tnt.views.figure_window import colour_limit, draw_slice
from async_tnt.volume import TNTVolume
from experiments.figure_script import run
from experiments.script_options import exit_with

if TYPE_CHECKING:
    from matplotlib.figure import Figure

N_MOMENTS = 5
LEFT, GAP, HEAD, TALLEST = 0.75, 0.12, 0.85, 3.0  # inches


def heatmap_of(model: Model, raw: np.ndarray) -> np.ndarray:
    """How much each pixel counts in the landmark of a raw volume: (H, W), sum 1."""
    import torch
    from tnt_reference import LayerNetwork

    *layers, _ = model.network["regressor"]  # the last one is the centroid
    with torch.inference_mode():
        exponent = LayerNetwork(layers, model.weights)(torch.tensor(raw)[None])[0, 0].double()
    return exponent.flatten().softmax(0).reshape(exponent.shape).numpy()


def draw_heatmap(window: Window) -> Figure:
    """One window's raw events, and below them the heatmap of the model's landmark network, at fifths of the window.

    Raises
    ------
    ValueError : the model has no landmark network.
    """
    subject = window.subject
    model, config = subject.model, subject.config
    if model is None or not config.needs_regressor:
        raise ValueError(
            f'a heatmap needs a model with landmark="regressor", but model {subject.model_name} has '
            f"landmark={config.landmark!r}"
        )
    width = (WIDTH - LEFT - 0.2 - GAP * (N_MOMENTS - 1)) / N_MOMENTS
    height = min(TALLEST, width * config.grid[1] / config.grid[0])
    figure = new_figure(HEAD + 2 * height + GAP + 0.6)
    headline(figure, f"{subject.name}, window {window.number}: the landmark network's heatmap")
    for k in range(1, N_MOMENTS + 1):
        until_us = window.start_us + config.window_us * k // N_MOMENTS
        raw = _volume_of(window, subject.raw_config, until_us)
        mean = _volume_of(window, config.replace(landmark="running"), until_us).landmark
        seen, heat = raw.array.sum(0), heatmap_of(model, raw.array)
        left = LEFT + (k - 1) * (width + GAP)
        above = axes_at(figure, left, HEAD, width, height)
        colours = "signed" if config.polarity == "signed" else "unsigned"
        draw_slice(above, seen, colours, colour_limit(seen))
        above.set_title(f"{(until_us - window.start_us) / 1e3:.3g} ms", fontsize=LARGE)
        below = axes_at(figure, left, HEAD + height + GAP, width, height)
        _draw_heat(below, heat, mean)
        if k == 1:
            above.set_ylabel("events so far", fontsize=LARGE)
            below.set_ylabel("heatmap", fontsize=LARGE)
    marks = [
        _mark(below, [], [], "x", ON, "landmark, the heatmap's centroid"),
        _mark(below, [], [], "o", OFF, "running centroid of the events"),
        _mark(below, [], [], "+", GREY, "image centre"),
    ]
    figure.legend(handles=marks, loc="lower center", ncols=3, labelcolor=TEXT)
    words = "ink: the share of a cell in the landmark, full where it is largest"
    write_at(figure, LEFT, 0.52, words, fontsize=SMALL, color=TEXT)
    return figure


def _volume_of(window: Window, config: TNTConfig, until_us: int) -> TNTVolume:
    """The window's events before a time, in a volume of this configuration."""
    volume = TNTVolume(config)
    volume.open(window.start_us)
    volume.update(window.events[window.events["t"] < until_us])
    return volume


def _draw_heat(axes: Any, heat: np.ndarray, mean: tuple[float, float]) -> None:
    """A heatmap, with its centroid, the events' and the centre."""
    rows, columns = np.indices(heat.shape)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=PALE)
    axes.imshow(heat, cmap=colour_map("#ffffff", "#222222"), vmin=0.0, aspect="auto", interpolation="nearest")
    _mark(axes, [columns.max() / 2], [rows.max() / 2], "+", GREY)
    _mark(axes, [mean[0]], [mean[1]], "o", OFF)
    _mark(axes, [(heat * columns).sum()], [(heat * rows).sum()], "x", ON)


def _mark(axes: Any, x: list[float], y: list[float], marker: str, colour: str, label: str | None = None) -> Any:
    look: dict[str, Any] = {"color": colour, "ls": "", "ms": 8, "mew": 2}
    if marker == "o":
        look["mfc"] = "none"
    return axes.plot(x, y, marker=marker, label=label, **look)[0]


def main(argv: list[str] | None = None) -> int:
    return run("figure_heatmap", __doc__, draw_heatmap, argv)


if __name__ == "__main__":
    exit_with(main)
