"""Draw a recording on one page: a window's events, its volumes, and the answers in time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.messages import printable
from async_tnt.networks.models.model import Model
from async_tnt.streaming.decision import Decision, class_of_recording, in_windows
from async_tnt.streaming.processor import Processor
from async_tnt.views.figure_outputs import draw_outputs, outputs_height
from async_tnt.views.figure_style import (
    GREY,
    HIGHLIGHTS,
    PALE,
    SMALL,
    axes_at,
    headline,
    new_figure,
    note,
    shortened,
    write_at,
)
from async_tnt.views.figure_subject import Subject, Window, evenly_spread
from async_tnt.views.figure_window import draw_both, draw_layers, layers_height

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVENTS_HEIGHT = 4.0
"""Height of the part with the events, from the top of the page, in inches."""
CLASSES_HEIGHT = 1.9
"""Height of the plot of class probabilities, in inches."""
EVERY_US = 2_500
"""Microseconds between decisions, at least. A long recording has fewer decisions in a second."""
MOST_DECISIONS = 2_000
"""Number of decisions that the plot can show side by side."""
MOST_SLICES = 12
"""Number of bins of a volume that are drawn, at most. They are evenly spread."""
MOST_NAMED = 20
"""If a recording has more windows, the windows' decisions are not written in the plot."""


def draw_overview(subject: Subject, number: int = 1) -> Figure:
    """Draw one window's events and volumes, and what the model answers in the whole recording.

    The answers are the class probabilities. A model of raw outputs has its outputs at the ends of
    some windows instead. Without a model, answers are left out.

    Parameters
    ----------
    number : number of the window, counted from 1.
    """
    window = subject.window(number)
    config = subject.config
    model = subject.model
    shown_bins = evenly_spread(config.bins, MOST_SLICES).tolist()
    answers_top = EVENTS_HEIGHT + 0.55 + layers_height(config, len(shown_bins))
    figure = new_figure(answers_top + _answers_height(window))
    draw_both(figure, window, height=EVENTS_HEIGHT - 0.7)
    size = f"{config.grid[0]} x {config.grid[1]} pixels, {config.bins} time bins, {config.polarity}"
    write_at(figure, 0.21, EVENTS_HEIGHT + 0.07, f"event volume of window {number} ({size})")
    draw_layers(figure, window, shown_bins, top=EVENTS_HEIGHT + 0.2)
    if model is not None and not model.outputs:
        _draw_decisions(figure, subject, model, answers_top)
        return figure

    headline(figure, subject.name)
    if model is not None:
        draw_outputs(figure, window, model, answers_top)
    return figure


def _answers_height(window: Window) -> float:
    """Height of the part with the model's answers, in inches."""
    model = window.subject.model
    if model is None:
        return 0.0
    return outputs_height(window, model) if model.outputs else CLASSES_HEIGHT + 0.5


def _draw_decisions(figure: Figure, subject: Subject, model: Model, top: float) -> None:
    """Draw the class probabilities, `top` inches below the upper edge, and the headline."""
    t = subject.events["t"]
    duration_us = int(t.max() - t.min())
    # `MOST_DECISIONS` of these steps span the recording. The step is rounded down to half
    # milliseconds.
    distinct_step_us = duration_us // MOST_DECISIONS // 500 * 500
    every_us = max(EVERY_US, distinct_step_us)
    processor = Processor(model, start_us=subject.start_us, every_us=every_us)
    decisions = processor.push(subject.events) + processor.finish()
    windows = list(in_windows(decisions, model.config))
    last_probabilities = [window[-1].probabilities for _, window in windows]
    label, details = class_of_recording(model.classes, last_probabilities)
    headline(figure, f"{subject.name}: “{label}”, {details}")
    axes = axes_at(figure, 0.75, top, 8.6, CLASSES_HEIGHT)
    draw_classes(axes, subject, model, windows)
    model_name = printable(subject.model_name)
    moments_text = f"every {every_us / 1e3:g} ms"
    if not model.config.slides:
        moments_text += " and at the ends of windows"
    axes.set_xlabel(
        f"time in the recording (ms); decisions of {model_name} {moments_text}", fontsize=SMALL
    )


def draw_classes(
    axes: Any,
    subject: Subject,
    model: Model,
    windows: list[tuple[int, list[Decision]]],
) -> None:
    """Draw the probability of each class as a line, and write each window's decision above.

    The likeliest classes have a colour and a name.

    windows : the start and the decisions of each window, see `in_windows`.
    """
    decisions = [decision for _, window in windows for decision in window]
    probabilities = np.array([d.probabilities for d in decisions])  # (decisions, classes)
    times = subject.since_start_ms(np.array([d.time_us for d in decisions]))
    starts_us = np.array([start_us for start_us, window in windows for _ in window])
    # nan interrupts the lines at the end of each window
    end_rows = np.flatnonzero(np.diff(starts_us)) + 1
    if model.config.slides:
        end_rows = end_rows[:0]
    x = np.insert(times, end_rows, np.nan)
    y = np.insert(probabilities, end_rows, np.nan, axis=0)
    likeliest = np.argsort(-probabilities.mean(axis=0), kind="stable")
    # The likeliest class is drawn last, on top.
    for rank, k in reversed(list(enumerate(likeliest))):
        look = {"color": GREY, "lw": 0.8}
        if rank < len(HIGHLIGHTS):
            colour, dashes = HIGHLIGHTS[rank]
            name = f"“{shortened(model.classes[k], 10)}”"
            look = {"color": colour, "ls": dashes, "lw": 2.0, "label": name}
        (line,) = axes.plot(x, y[:, k], marker=".", ms=2, **look)
        line.set_gid(f"class {k}")

    if len(windows) <= MOST_NAMED:
        for start_us, window in windows:
            decision = window[-1]
            start_ms = subject.since_start_ms(start_us)
            axes.axvline(start_ms, color=PALE, lw=0.8, zorder=0)
            name = shortened(decision.label or "nothing", 10)
            note(axes, f"“{name}” {decision.probability:.2f}", (start_ms, 1.0), (3, 3))

    ends_us = np.array([starts_us[0], starts_us[-1] + model.config.window_us])
    axes.set(xlim=subject.since_start_ms(ends_us), ylim=(0, 1))
    axes.set(yticks=[0, 0.5, 1], ylabel="class probability")
    handles, names = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], names[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5))
