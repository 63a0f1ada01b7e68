"""Everything about a recording on one page: events of a window, its volumes, and the decisions in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from async_tnt.views.figure_events import draw_raw, draw_titles, draw_transformed
from async_tnt.views.figure_probabilities import decisions_of, draw_classes, draw_rate, time_label, verdict, who_decides
from async_tnt.views.figure_slices import caption, draw_layers, layers_height, shown_bins
from async_tnt.views.figure_style import LARGE, SMALL, TEXT, WIDTH, new_figure, polarity_legend
from async_tnt.views.figure_subject import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVENTS_HEIGHT, CLASSES_HEIGHT, RATE_HEIGHT = 4.0, 1.6, 0.75  # inches


def draw_overview(
    subject: Subject, number: int = 1, bins: Sequence[int] | None = None, every_us: int | None = None
) -> Figure:
    """One window's events and volumes, and the whole recording's class probabilities.

    Without a model the probabilities are left out.
    """
    window = subject.window(number)
    shown = shown_bins(subject.config, bins)
    decisions = None if subject.model is None else decisions_of(subject, every_us)
    slices_height = layers_height(subject.config, len(shown))
    slices_top = EVENTS_HEIGHT + 0.2
    rate_top = slices_top + slices_height + 0.35 + (0 if decisions is None else CLASSES_HEIGHT + 0.15)
    page = rate_top + RATE_HEIGHT + 0.5
    figure = new_figure(page)

    def place(left: float, top: float, width: float, height: float) -> tuple[float, float, float, float]:
        return left / WIDTH, 1 - (top + height) / page, width / WIDTH, height / page

    title = subject.name if decisions is None else f"{subject.name}: {verdict(subject, decisions)}"
    figure.text(0.02, 1 - 0.25 / page, title, fontsize=LARGE + 2, fontweight="bold", va="center")
    raw = figure.add_axes(place(0.0, 0.6, 5.0, EVENTS_HEIGHT - 0.6), projection="3d")
    tnt = figure.add_axes(place(5.2, 0.6, 5.0, EVENTS_HEIGHT - 0.6), projection="3d")
    draw_titles(figure, window, draw_raw(raw, window), draw_transformed(tnt, window), top=0.65)
    polarity_legend(
        raw, loc="center right", bbox_to_anchor=(0.985, 1 - 0.25 / page), bbox_transform=figure.transFigure, ncols=2
    )

    figure.text(0.02, 1 - (EVENTS_HEIGHT + 0.12) / page, f"event volume of window {number}", fontsize=LARGE)
    figure.text(
        0.985, 1 - (EVENTS_HEIGHT + 0.12) / page, caption(subject.config), fontsize=SMALL, color=TEXT, ha="right"
    )
    draw_layers(figure, window, shown, top=slices_top)

    rate = figure.add_axes(place(0.75, rate_top, 8.6, RATE_HEIGHT))
    draw_rate(rate, subject, (window.start_us, window.start_us + subject.config.window_us))
    words = f"{time_label(subject)}; shaded: window {number}, shown above"
    if decisions is not None:
        classes = figure.add_axes(place(0.75, rate_top - CLASSES_HEIGHT - 0.15, 8.6, CLASSES_HEIGHT))
        draw_classes(classes, subject, decisions)
        classes.tick_params(labelbottom=False)
        rate.set_xlim(classes.get_xlim())
        words += f"; {who_decides(subject, every_us)}"
    rate.set_xlabel(words, fontsize=SMALL)
    return figure
