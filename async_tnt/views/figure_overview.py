"""Everything about a recording on one page: events of a window, its volumes, and the decisions in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from async_tnt.views.figure_events import draw_both
from async_tnt.views.figure_probabilities import decisions_of, draw_classes, draw_rate, time_label, verdict, who_decides
from async_tnt.views.figure_slices import caption, draw_layers, layers_height, shown_bins
from async_tnt.views.figure_style import SMALL, TEXT, axes_at, headline, new_figure, write_at
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
    rate_top = EVENTS_HEIGHT + 0.55 + layers_height(subject.config, len(shown))
    if decisions is not None:
        rate_top += CLASSES_HEIGHT + 0.15
    figure = new_figure(rate_top + RATE_HEIGHT + 0.5)
    headline(figure, subject.name if decisions is None else f"{subject.name}: {verdict(subject, decisions)}")
    draw_both(figure, window, height=EVENTS_HEIGHT - 0.7)
    write_at(figure, 0.21, EVENTS_HEIGHT + 0.07, f"event volume of window {number}")
    write_at(figure, 10.24, EVENTS_HEIGHT + 0.08, caption(subject.config), fontsize=SMALL, color=TEXT, ha="right")
    draw_layers(figure, window, shown, top=EVENTS_HEIGHT + 0.2)

    rate = axes_at(figure, 0.75, rate_top, 8.6, RATE_HEIGHT)
    draw_rate(rate, subject, (window.start_us, window.start_us + subject.config.window_us))
    words = f"{time_label(subject)}; shaded: window {number}, shown above"
    if decisions is not None:
        classes = axes_at(figure, 0.75, rate_top - CLASSES_HEIGHT - 0.15, 8.6, CLASSES_HEIGHT)
        draw_classes(classes, subject, decisions)
        classes.tick_params(labelbottom=False)
        rate.set_xlim(classes.get_xlim())
        words += f"; {who_decides(subject, every_us)}"
    rate.set_xlabel(words, fontsize=SMALL)
    return figure
