"""The whole pipeline for one window: recording, events, landmark, transform, volume, network, class."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.decision import Decision
from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from async_tnt.views.figure_events import draw_raw, draw_transformed
from async_tnt.views.figure_probabilities import draw_rate, short
from async_tnt.views.figure_slices import colour_limit, draw_slice, layers_of
from async_tnt.views.figure_style import GREY, LARGE, NORMAL, OFF, PALE, SMALL, TEXT, WIDTH, new_figure, polarity_legend
from async_tnt.views.figure_subject import Subject, Window, shown_evenly

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = 6.9  # inches
MOST_CLASSES = 12
MOST_STACKED = 9
PATH_DOTS = 800
NETWORK_COLOUR, PATH = "#eef3f7", "#009E73"


def draw_pipeline(subject: Subject, number: int = 1) -> Figure:
    """One window on its way from the recording to the class probabilities.

    Raises
    ------
    ValueError : no model; or one that was trained with another configuration than is drawn.
    """
    model = subject.model
    if model is None:
        raise ValueError(f"{subject.name}: figure pipeline needs a model; --model names one")
    if model.config != subject.config:
        raise ValueError(
            f"figure pipeline is drawn with the configuration of model {subject.model_name}: "
            f"{model.config}; got {subject.config}"
        )
    window = subject.window(number)
    decision = decision_of(window, model)
    figure = new_figure(PAGE)
    figure.text(
        0.02,
        0.965,
        f"{subject.name}, window {number}: from events to “{short(decision.label)}”",
        fontsize=LARGE + 2,
        fontweight="bold",
        va="center",
    )

    recording = _stage(figure, 1, "recording", (0.62, 1.05, 1.7, 1.75))
    draw_rate(recording, subject, (window.start_us, window.start_us + subject.config.window_us))
    recording.set_xlabel(f"time ({subject.time_unit[1]})")
    recording.set_ylabel("events / ms", labelpad=0)
    raw = _stage(figure, 2, "raw events", (2.65, 0.8, 2.5, 2.3), projection="3d", title_left=2.85)
    n = draw_raw(raw, window, small=True)
    _below(figure, f"{n:,} in {subject.config.window_us / 1e3:g} ms", 4.0)
    polarity_legend(raw, loc="center right", bbox_to_anchor=(0.985, 0.965), bbox_transform=figure.transFigure, ncols=2)
    _arrow(figure, (2.4, 1.9), (2.7, 1.9))
    if subject.config.transform == "tnt":
        _draw_landmark(_stage(figure, 3, f"landmark: {subject.config.landmark}", (5.85, 1.1, 1.6, 1.6)), window)
        _arrow(figure, (5.45, 1.9), (5.75, 1.9))
        tnt = _stage(figure, 4, "transformed events", (7.65, 0.8, 2.5, 2.3), projection="3d", title_left=7.85)
        kept = draw_transformed(tnt, window, small=True)
        _below(figure, f"{kept:,} kept: u = (x - l) / τ + c", 9.0)
        _arrow(figure, (7.5, 1.9), (7.75, 1.9))
    _bend(figure, 9.0 if subject.config.transform == "tnt" else 4.0, 1.9)

    step = 5 if subject.config.transform == "tnt" else 3
    _draw_volume(_stage(figure, step, "event volume", (0.3, 4.1, 3.9, 2.2), title_left=0.3), window)
    _arrow(figure, (4.3, 5.2), (4.65, 5.2))
    _draw_network(_stage(figure, step + 1, "network", (4.75, 4.1, 2.55, 2.2)), model)
    _arrow(figure, (7.35, 5.2), (7.65, 5.2))
    _draw_answer(_stage(figure, step + 2, "class probabilities", (8.5, 4.1, 1.6, 2.2), title_left=7.9), model, decision)
    return figure


def decision_of(window: Window, model: Model) -> Decision:
    """The model's decision on the complete window."""
    processor = Processor(model, start_us=window.start_us)
    processor.push(window.events)
    return processor.fire()


def _stage(
    figure: Figure,
    number: int,
    title: str,
    box: tuple[float, float, float, float],
    title_left: float | None = None,
    **settings: Any,
) -> Any:
    """Axes at (left, top, width, height) in inches from the upper left corner, under a numbered title."""
    left, top, width, height = box
    row_top = 0.75 if top < 3 else 3.8
    figure.text(
        (left if title_left is None else title_left) / WIDTH,
        1 - row_top / PAGE,
        f"{number}  {title}",
        fontsize=LARGE,
        va="center",
    )
    return figure.add_axes((left / WIDTH, 1 - (top + height) / PAGE, width / WIDTH, height / PAGE), **settings)


def _below(figure: Figure, words: str, centre: float) -> None:
    figure.text(centre / WIDTH, 1 - 3.2 / PAGE, words, fontsize=SMALL, color=TEXT, ha="center", va="center")


def _arrow(figure: Figure, tail: tuple[float, float], head: tuple[float, float], style: str = "-|>") -> None:
    from matplotlib.patches import FancyArrowPatch

    ends = [(x / WIDTH, 1 - y / PAGE) for x, y in (tail, head)]
    figure.add_artist(
        FancyArrowPatch(
            *ends,
            transform=figure.transFigure,
            arrowstyle=style,
            mutation_scale=14,
            color=GREY,
            lw=1.6,
            shrinkA=0,
            shrinkB=0,
        )
    )


def _bend(figure: Figure, right: float, left: float) -> None:
    """From the upper row's last stage to the lower row's first."""
    _arrow(figure, (right, 3.34), (right, 3.48), "-")
    _arrow(figure, (right, 3.48), (left, 3.48), "-")
    _arrow(figure, (left, 3.48), (left, 3.66))


def _draw_landmark(axes: Any, window: Window) -> None:
    """The window's events as dots, and the landmark of each."""
    config = window.subject.config
    width, height = config.grid
    column, row = np.rint(window.grid_xy).astype(np.int64)
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
    how = "path; at last" if moves else "its network says" if config.needs_regressor else "at"
    words = f"{how} ({x:.1f}, {y:.1f})"
    axes.set_xlabel(words, fontsize=SMALL, color=TEXT)


def _draw_volume(axes: Any, window: Window) -> None:
    """The bins as pictures behind each other, the first in front."""
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
        axes.add_patch(_outline(extent, n - place))
    axes.set(xlim=(-1, (n - 1) * dx + width + 1), ylim=(height + 1, -(n - 1) * dy - 1))
    axes.set_aspect("equal", anchor="W")
    axes.spines[:].set_visible(False)
    axes.annotate(
        "bin 0", (0, height), xytext=(0, -4), textcoords="offset points", fontsize=SMALL, color=TEXT, va="top"
    )
    last = f"bin {config.bins - 1}" if len(layers) == 1 else f"bin {config.bins - 1} (OFF)"
    axes.annotate(
        last,
        ((n - 1) * dx + width, -(n - 1) * dy),
        xytext=(0, 4),
        textcoords="offset points",
        fontsize=SMALL,
        color=TEXT,
        ha="right",
    )
    axes.set_xlabel(f"{config.channels} x {height} x {width} numbers", fontsize=SMALL, color=TEXT, labelpad=14)


def _outline(extent: tuple[float, float, float, float], zorder: float) -> Any:
    from matplotlib.patches import Rectangle

    left, right, bottom, top = extent
    return Rectangle((left, top), right - left, bottom - top, fill=False, ec=GREY, lw=0.8, zorder=zorder + 0.5)


def layer_words(model: Model) -> list[str]:
    """The classifier's layers with their sizes, read from its weights."""
    w = model.weights
    words = [f"{w[f'{layer}.weight'].shape[0]} convolutions 3x3, ReLU,\naverage of 2x2" for layer in ("conv1", "conv2")]
    n, n_in = w["fc1.weight"].shape
    words.append(f"{n_in:,} to {n} fully connected, ReLU")
    words.append(f"{n} to {len(model.classes)} fully connected")
    return words


def _draw_network(axes: Any, model: Model) -> None:
    """A box for each layer, from above."""
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    words = layer_words(model)
    heights = [0.25, 0.25, 0.155, 0.155]
    top = 1.0
    for text, height in zip(words, heights, strict=True):
        axes.add_patch(_box(0.02, top - height, 0.96, height))
        axes.text(0.5, top - height / 2, text, ha="center", va="center", fontsize=SMALL, linespacing=1.25)
        top -= height + 0.063
        if text is not words[-1]:
            axes.annotate(
                "", (0.5, top), (0.5, top + 0.063), arrowprops=dict(arrowstyle="-|>", color=GREY, shrinkA=0, shrinkB=0)
            )
    n_weights = sum(weight.size for weight in model.weights.values())
    axes.set_xlabel(f"{n_weights:,} weights", fontsize=SMALL, color=TEXT)


def _box(left: float, bottom: float, width: float, height: float) -> Any:
    from matplotlib.patches import FancyBboxPatch

    return FancyBboxPatch(
        (left, bottom), width, height, boxstyle="round,pad=0,rounding_size=0.03", fc=NETWORK_COLOUR, ec=OFF, lw=1
    )


def _draw_answer(axes: Any, model: Model, decision: Decision) -> None:
    """A bar for each class, or for the likeliest."""
    p = decision.probabilities
    shown = np.sort(np.argsort(-p, kind="stable")[:MOST_CLASSES])
    colours = ["black" if k == decision.index else PALE for k in shown]
    axes.barh(range(shown.size), p[shown], color=colours, height=0.7)
    axes.set(xlim=(0, 1), ylim=(shown.size - 0.4, -0.6))
    axes.set_xticks([0, 0.5, 1])
    axes.set_yticks(range(shown.size), [short(model.classes[k]) for k in shown])
    axes.tick_params(axis="y", length=0)
    best = int(np.flatnonzero(shown == decision.index)[0])
    axes.get_yticklabels()[best].set(fontweight="bold", fontsize=NORMAL + 1)
    value = p[decision.index]
    inside = value > 0.35
    axes.text(
        value - 0.02 if inside else value + 0.02,
        best,
        f"{value:.3f}",
        va="center",
        fontsize=SMALL,
        ha="right" if inside else "left",
        color="white" if inside else "black",
    )
    axes.set_xlabel("after the window's last event", fontsize=SMALL, color=TEXT)
