"""Everything about a recording on one page: events of a window, its volumes, and the decisions in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.checks import printable
from async_tnt.decision import Decision
from async_tnt.processor import Processor
from async_tnt.progress import progress
from async_tnt.views.figure_style import (
    GREY,
    HIGHLIGHTS,
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
    shortened,
    write_at,
)
from async_tnt.views.figure_subject import Subject
from async_tnt.views.figure_window import caption, draw_both, draw_layers, layers_height, shown_bins, transform_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVENTS_HEIGHT, CLASSES_HEIGHT, RATE_HEIGHT = 4.0, 1.6, 0.75  # inches
EVERY_US = 2_500
MOST_DECISIONS = 2_000  # unless the user sets the interval
PACKET = 20_000


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


def default_every_us(subject: Subject) -> int:
    """2.5 ms; more in a long recording, so that decisions stay drawable."""
    t = subject.events["t"]
    return max(EVERY_US, int(t.max() - t.min()) // MOST_DECISIONS // 500 * 500)


def decisions_of(subject: Subject, every_us: int | None = None) -> list[Decision]:
    """All decisions of the streamed recording, the last one of each window included.

    Raises
    ------
    ValueError : the subject has no model; or no event lies in any window.
    """
    if subject.model is None:
        raise ValueError(f"{subject.name}: no model to make decisions")
    every_us = default_every_us(subject) if every_us is None else every_us
    processor = Processor(subject.model, start_us=subject.start_us, every_us=every_us)
    decisions = []
    with progress(subject.events.size, "deciding") as bar:
        for first in range(0, subject.events.size, PACKET):
            packet = subject.events[first : first + PACKET]
            decisions += processor.push(packet)
            bar.update(packet.size)
    decisions += processor.finish()
    if not decisions:
        raise ValueError(f"{subject.name}: no event in any window")
    return decisions


def verdict(subject: Subject, decisions: list[Decision]) -> str:
    """The class of the whole recording, as in `async-tnt run`: by the mean over its windows' last decisions."""
    last = [d.probabilities for d in decisions if d.trigger in ("window", "end")]
    mean = np.mean(last, axis=0)
    best = int(mean.argmax())
    windows = "1 window" if len(last) == 1 else f"{len(last)} windows"
    assert subject.model is not None
    return f"“{subject.model.classes[best]}”, mean probability {mean[best]:.3f} of {windows}"


def who_decides(subject: Subject, every_us: int | None) -> str:
    """The model, its transform, and the time between its decisions, for an axis."""
    assert subject.model is not None
    config = subject.model.config
    sees = transform_words(config) if config.transform == "tnt" else "raw volumes"
    every_us = default_every_us(subject) if every_us is None else every_us
    when = f"every {every_us / 1e3:g} ms" if every_us < config.window_us else "at each window's end"
    return f"decisions of {printable(subject.model_name)} ({sees}) {when}"


def draw_classes(axes: Any, subject: Subject, decisions: list[Decision]) -> None:
    """A line for each class: those that are likeliest for a while in strong colours, the others grey."""
    model = subject.model
    assert model is not None
    probabilities = np.array([d.probabilities for d in decisions])  # (decisions, classes)
    times = subject.since_start(np.array([d.time_us for d in decisions]))
    starts_us = np.array([d.window_start_us for d in decisions])
    style = _styles(probabilities)
    starts = np.unique(starts_us)
    # a line for each window, unless it would be little more than a point
    ends = np.flatnonzero(np.diff(starts_us)) + 1 if times.size >= 3 * starts.size else np.empty(0, int)
    x, y = np.insert(times, ends, np.nan), np.insert(probabilities, ends, np.nan, axis=0)
    for k in sorted(range(len(model.classes)), key=lambda k: style[k]["zorder"]):
        (line,) = axes.plot(x, y[:, k], marker="." if times.size < 40 else None, **style[k])
        line.set_gid(f"class {k}")
    for number, start_us in enumerate(starts):
        if starts.size <= 100:
            axes.axvline(subject.since_start(start_us), color=PALE, lw=0.8, ls=(0, (4, 3)), zorder=0)
        if number % -(-starts.size // 10) == 0:  # ten of them are legible
            k = round((start_us - subject.first_us) / model.config.window_us) + 1
            words = f"window {k}" if starts.size <= 6 else f"{k}"
            note(axes, words, (subject.since_start(start_us), 1.0), (3, 2), va="bottom")
    _name_lines(axes, model.classes, probabilities[-1], style, float(times[-1]))
    shortest = 0.2 * model.config.window_us / subject.time_unit[0]
    first = float(subject.since_start(starts[0]))
    axes.set(xlim=(first, max(times[-1], first + shortest)), ylim=(0, 1))
    axes.set_yticks([0, 0.5, 1])
    axes.set_ylabel("class probability")


def _styles(probabilities: np.ndarray) -> list[dict[str, Any]]:
    """The look of each class's line. In strong colours: the likeliest on average, and those that exceed 1/2 at some
    moment, the longest first."""
    certain = (probabilities > 0.5).sum(axis=0)
    best = int(probabilities.mean(axis=0).argmax())
    others = [int(k) for k in np.argsort(-certain, kind="stable") if certain[k] and k != best]
    style: list[dict[str, Any]] = [dict(color=GREY, lw=0.8, zorder=1) for _ in certain]
    for rank, k in enumerate([best, *others][: len(HIGHLIGHTS)]):
        colour, dashes = HIGHLIGHTS[rank]
        style[k] = dict(color=colour, ls=dashes, lw=2.2 if rank == 0 else 1.8, zorder=10 - rank)
    return style


def _name_lines(axes: Any, classes: tuple[str, ...], last: np.ndarray, style: list[dict[str, Any]], end: float) -> None:
    """Names at the right ends of the lines, moved apart where they would overlap."""
    named = sorted((k for k in range(len(classes)) if style[k]["zorder"] > 1), key=lambda k: last[k])
    labels = [(float(last[k]), f"“{shortened(classes[k], 10)}”", style[k]["color"], k) for k in named]
    grey = [k for k in range(len(classes)) if style[k]["zorder"] == 1]
    if grey:
        words = "others" if len(grey) > 1 else f"“{shortened(classes[grey[0]], 10)}”"
        labels.append((float(last[grey].max()), words, TEXT, -1))
    labels.sort()
    place = -1.0
    for value, words, colour, k in labels:
        place = max(value, place + 0.11)
        look: dict[str, Any] = {"color": colour, "fontweight": "bold" if k >= 0 else "normal", "va": "center"}
        if k >= 0 and style[k]["zorder"] == 10:
            look["fontsize"] = NORMAL + 3
        note(axes, words, (end, place), (6, 0), annotation_clip=False, **look)


def draw_rate(axes: Any, subject: Subject, highlight_us: tuple[int, int] | None = None) -> None:
    """ON events per millisecond upwards, OFF events downwards; `highlight_us`, (start, end), is shaded."""
    t, on = subject.events["t"], subject.events["p"] == 1
    first_us = int(t.min())
    last_us = max(int(t.max()) + 1, first_us + 1_000)
    edges = np.linspace(first_us, last_us, 1 + int(np.clip((last_us - first_us) / 1000, 20, 300)))
    per_ms = 1e3 / (edges[1] - edges[0])
    for which, sign, colour in ((on, 1, ON), (~on, -1, OFF)):
        counts = np.histogram(t[which], edges)[0] * per_ms * sign
        axes.stairs(counts, subject.since_start(edges), color=colour, fill=True, lw=0)
    axes.axhline(0, color="white", lw=0.6)
    axes.set_xlim(subject.since_start(first_us), subject.since_start(last_us))
    if highlight_us is not None:
        axes.axvspan(*map(subject.since_start, highlight_us), color="#f0e442", alpha=0.35, lw=0, zorder=0)
    axes.yaxis.set_major_locator(few_ticks())
    axes.yaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    axes.set_xlabel(time_label(subject))
    axes.set_ylabel("events / ms")


def time_label(subject: Subject) -> str:
    return f"time in the recording ({subject.time_unit[1]})"
