"""The whole pipeline for one window: recording, events, landmark, transform, volume, network, class.

python -m experiments.figure_pipeline 3 --picture docs/images/pipeline.png
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.decision import Decision
from async_tnt.networks.graph import CLASSIFIER
from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from async_tnt.views.figure_style import (
    GREY,
    NORMAL,
    OFF,
    ON,
    PALE,
    SMALL,
    TEXT,
    axes_at,
    few_ticks,
    headline,
    new_figure,
    note,
    polarity_legend,
    shortened,
    write_at,
)
from async_tnt.views.figure_subject import Subject, Window, shown_evenly
from async_tnt.views.figure_window import colour_limit, draw_raw, draw_slice, draw_transformed, layers_of
from experiments.figure_script import grid_xy, run
from experiments.script_options import exit_with

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CLASSES = 12
MOST_STACKED = 9
PATH_DOTS = 800
MAX_BOXES = 6
POOLS = {"average_pool": "average of {}", "max_pool": "maximum of {}", "global_average_pool": "mean over all places"}
NETWORK_COLOUR, PATH = "#eef3f7", "#009E73"


def draw_pipeline(window: Window) -> Figure:
    """One window on its way from the recording to the class probabilities.

    Raises
    ------
    ValueError : no model; or one that was trained with another configuration than is drawn.
    """
    subject, model, config = window.subject, window.subject.model, window.subject.config
    if model is None or model.config != config:
        raise ValueError(f"{subject.name}: a pipeline is drawn with a model and its own configuration")
    transformed = config.transform == "tnt"
    decision = decision_of(window, model)
    figure = new_figure(6.9)
    headline(
        figure, f"{subject.name}, window {window.number}: from events to “{shortened(decision.label or 'nothing', 10)}”"
    )
    polarity_legend(figure)

    recording = _stage(figure, "1  recording", 0.62, (0.62, 1.05, 1.7, 1.75))
    draw_rate(recording, subject, (window.start_us, window.start_us + config.window_us))
    _arrow(figure, (2.4, 1.9), (2.7, 1.9))
    raw = _stage(figure, "2  raw events", 2.85, (2.65, 0.8, 2.5, 2.3), projection="3d")
    n = draw_raw(raw, window)
    _small(raw)
    below: dict[str, Any] = {"fontsize": SMALL, "color": TEXT, "ha": "center"}
    write_at(figure, 4.0, 3.2, f"{n:,} in {config.window_us / 1e3:g} ms", **below)
    if transformed:
        _arrow(figure, (5.45, 1.9), (5.75, 1.9))
        _draw_landmark(_stage(figure, f"3  landmark: {config.landmark}", 5.85, (5.85, 1.1, 1.6, 1.6)), window)
        _arrow(figure, (7.5, 1.9), (7.75, 1.9))
        tnt = _stage(figure, "4  transformed events", 7.85, (7.65, 0.8, 2.5, 2.3), projection="3d")
        kept = draw_transformed(tnt, window)
        _small(tnt)
        write_at(figure, 9.0, 3.2, f"{kept:,} kept: u = (x - l) / τ + c", **below)
    right = 9.0 if transformed else 4.0
    for tail, head, style in (
        ((right, 3.34), (right, 3.48), "-"),
        ((right, 3.48), (1.9, 3.48), "-"),
        ((1.9, 3.48), (1.9, 3.66), "-|>"),
    ):
        _arrow(figure, tail, head, style)

    step = 5 if transformed else 3
    _draw_volume(_stage(figure, f"{step}  event volume", 0.3, (0.3, 4.1, 3.9, 2.2)), window)
    _arrow(figure, (4.3, 5.2), (4.65, 5.2))
    _draw_network(_stage(figure, f"{step + 1}  network", 4.75, (4.75, 4.1, 2.55, 2.2)), model)
    _arrow(figure, (7.35, 5.2), (7.65, 5.2))
    _draw_answer(_stage(figure, f"{step + 2}  class probabilities", 7.9, (8.5, 4.1, 1.6, 2.2)), model, decision)
    return figure


def decision_of(window: Window, model: Model) -> Decision:
    """The model's decision on the complete window."""
    processor = Processor(model, start_us=window.start_us)
    processor.push(window.events)
    return processor.fire()


def _stage(
    figure: Figure, title: str, title_left: float, box: tuple[float, float, float, float], **settings: Any
) -> Any:
    """Axes at (left, top, width, height), in inches, under a title."""
    write_at(figure, title_left, 0.75 if box[1] < 3 else 3.8, title)
    return axes_at(figure, *box, **settings)


def _arrow(figure: Figure, tail: tuple[float, float], head: tuple[float, float], style: str = "-|>") -> None:
    from matplotlib.patches import FancyArrowPatch

    width, height = figure.get_size_inches()
    ends = [(x / width, 1 - y / height) for x, y in (tail, head)]
    look: dict[str, Any] = {"mutation_scale": 14, "color": GREY, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    figure.add_artist(FancyArrowPatch(*ends, transform=figure.transFigure, arrowstyle=style, **look))


def draw_rate(axes: Any, subject: Subject, highlight_us: tuple[int, int]) -> None:
    """ON events per millisecond upwards, OFF events downwards; `highlight_us`, (start, end), is shaded."""
    t, on = subject.events["t"], subject.events["p"] == 1
    first_us, last_us = int(t.min()), int(t.max()) + 1
    edges = np.linspace(first_us, last_us, 1 + int(np.clip((last_us - first_us) / 1000, 20, 300)))
    per_ms = 1e3 / (edges[1] - edges[0])
    for which, sign, colour in ((on, 1, ON), (~on, -1, OFF)):
        counts = np.histogram(t[which], edges)[0] * per_ms * sign
        axes.stairs(counts, subject.since_start_ms(edges), color=colour, fill=True, lw=0)
    axes.axhline(0, color="white", lw=0.6)
    axes.axvspan(*map(subject.since_start_ms, highlight_us), color="#f0e442", alpha=0.35, lw=0, zorder=0)
    axes.yaxis.set_major_locator(few_ticks())
    axes.yaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    axes.set_xlabel("time (ms)")
    axes.set_ylabel("events / ms", labelpad=0)


def _small(axes: Any) -> None:
    """Names and ticks of 3-D axes closer to a small box."""
    axes.set_xlabel("time (ms)", labelpad=-6)
    axes.set_ylabel(axes.get_ylabel()[0], labelpad=-9)
    axes.set_zlabel(axes.get_zlabel()[0], labelpad=-12)
    axes.tick_params(pad=-4)


def _draw_landmark(axes: Any, window: Window) -> None:
    """The window's events as dots, and the landmark of each."""
    config = window.subject.config
    width, height = config.grid
    column, row = np.rint(grid_xy(window)).astype(np.int64)
    ink = np.zeros((height, width))
    np.add.at(ink, (row, column), 1.0)
    axes.imshow(ink, cmap="Greys", vmax=1.6 * colour_limit(ink))
    path = window.coordinates().landmark
    moves = bool(np.ptp(path, axis=0).max() > 1e-6)
    if moves:
        shown = shown_evenly(len(path), PATH_DOTS)
        axes.plot(*path[shown].T, color=PATH, lw=1.4)
    axes.plot(*path[-1], marker="+", ms=13, mew=2.4, color=PATH)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=PALE)
    x, y = path[-1]
    how = "path; finally" if moves else "by its network" if config.needs_regressor else "at"
    words = f"{how} ({x:.1f}, {y:.1f})"
    axes.set_xlabel(words, fontsize=SMALL, color=TEXT)


def _draw_volume(axes: Any, window: Window) -> None:
    """The bins as a stack of pictures, the first in front."""
    from matplotlib.patches import Rectangle

    config = window.subject.config
    layers = layers_of(window.volumes()[1] if config.transform == "tnt" else window.volumes()[0], config, "")
    width, height = config.grid
    shown = shown_evenly(config.bins, MOST_STACKED if len(layers) == 1 else 5)
    pictures = [(layer.cells[k], layer.colours, colour_limit(layer.cells)) for layer in layers for k in shown]
    dx, dy = 0.56 * width, 0.2 * height
    n = len(pictures)
    for place, (cells, colours, limit) in enumerate(pictures):
        x, y = place * dx, -place * dy
        extent = (x, x + width, y + height, y)
        draw_slice(axes, cells, colours, limit, extent=extent, zorder=n - place)
        look: dict[str, Any] = {"fill": False, "ec": GREY, "lw": 0.8, "zorder": n - place + 0.5}
        axes.add_patch(Rectangle((x, y), width, height, **look))
    axes.set(xlim=(-1, (n - 1) * dx + width + 1), ylim=(height + 1, -(n - 1) * dy - 1))
    axes.set_aspect("equal", anchor="W")
    axes.spines[:].set_visible(False)
    note(axes, "bin 0", (0, height), (0, -4), va="top")
    last = f"bin {config.bins - 1}" + (" (OFF)" if len(layers) > 1 else "")
    note(axes, last, ((n - 1) * dx + width, -(n - 1) * dy), (0, 4), ha="right")
    axes.set_xlabel(f"{config.channels} x {height} x {width} numbers", fontsize=SMALL, color=TEXT, labelpad=14)


def layer_words(model: Model) -> list[str]:
    """The classifier's convolutions and dense layers, each with what follows it."""
    words: list[list[str]] = [[]]
    for layer in model.layers[CLASSIFIER]:
        op = layer["op"]
        side = "x".join(map(str, layer.get("kernel", [])))
        if op in ("conv", "dense"):
            n, n_in = model.weights[layer["weights"]["weight"]].shape[:2]
            words.append([f"{n} convolutions {side}" if op == "conv" else f"{n_in:,} to {n} fully connected"])
        elif op == "relu" and words[-1]:
            words[-1][0] += ", ReLU"
        elif op in POOLS:
            words[-1].append(POOLS[op].format(side))
    lines = [",\n".join(part) for part in words if part]
    if len(lines) > MAX_BOXES:
        lines[MAX_BOXES - 2 : -1] = [f"{len(lines) - MAX_BOXES + 1} more layers"]
    return lines


def _draw_network(axes: Any, model: Model) -> None:
    """A box for each layer, from top to bottom."""
    from matplotlib.patches import FancyBboxPatch

    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    words, top = layer_words(model), 1.0
    box: dict[str, Any] = {"boxstyle": "round,pad=0,rounding_size=0.03", "fc": NETWORK_COLOUR, "ec": OFF, "lw": 1}
    arrow = {"arrowstyle": "-|>", "color": GREY, "shrinkA": 0, "shrinkB": 0}
    n_lines = [1.6 + text.count("\n") for text in words]
    unit = (1.0 - 0.063 * (len(words) - 1)) / sum(n_lines)
    for text, height in zip(words, [unit * n for n in n_lines], strict=True):
        axes.add_patch(FancyBboxPatch((0.02, top - height), 0.96, height, **box))
        axes.text(0.5, top - height / 2, text, ha="center", va="center", fontsize=SMALL, linespacing=1.25)
        top -= height + 0.063
        if text is not words[-1]:
            axes.annotate("", (0.5, top), (0.5, top + 0.063), arrowprops=arrow)
    n_weights = sum(weight.size for weight in model.weights.values())
    axes.set_xlabel(f"{n_weights:,} weights", fontsize=SMALL, color=TEXT)


def _draw_answer(axes: Any, model: Model, decision: Decision) -> None:
    """A bar for each class, or for the likeliest."""
    p = decision.probabilities
    shown = np.sort(np.argsort(-p, kind="stable")[:MOST_CLASSES])
    colours = ["black" if k == decision.index else PALE for k in shown]
    axes.barh(range(shown.size), p[shown], color=colours, height=0.7)
    axes.set(xlim=(0, 1), ylim=(shown.size - 0.4, -0.6))
    axes.set_xticks([0, 0.5, 1])
    axes.set_yticks(range(shown.size), [shortened(model.classes[k], 10) for k in shown])
    axes.tick_params(axis="y", length=0)
    best = int(np.flatnonzero(shown == decision.index)[0])
    axes.get_yticklabels()[best].set(fontweight="bold", fontsize=NORMAL + 1)
    value = p[decision.index]
    inside = value > 0.35
    place, look = (value - 0.02, ("right", "white")) if inside else (value + 0.02, ("left", "black"))
    axes.text(place, best, f"{value:.3f}", va="center", fontsize=SMALL, ha=look[0], color=look[1])
    axes.set_xlabel("after the window's last event", fontsize=SMALL, color=TEXT)


def main(argv: list[str] | None = None) -> int:
    return run("figure_pipeline", __doc__, draw_pipeline, argv)


if __name__ == "__main__":
    exit_with(main)
