"""Draw what a map model finds at some moments.

Each picture has the events of the open window, and for each object its box, or a circle, with its
class, its id and its probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.networks.models.model import Model
from async_tnt.streaming.decision import Decision, Object
from async_tnt.streaming.processor import Processor
from async_tnt.views.figure_style import OFF, ON, TEXT, WIDTH, axes_at, headline, new_figure
from async_tnt.views.figure_subject import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHARES = 1 / 3, 2 / 3, 1.0
"""Shares of a window. After each of them a panel is drawn."""
EDGE = 0.15
"""Inches left, right and below the panels."""
GAP = 0.28
"""Inches between panels."""
TOP = 0.7
"""Inches above the panels."""
RIGHTMOST = 0.85
"""Share of a panel's width. The words of an object beyond this share stand on its left, so that
they stay inside the panel."""


def draw_window_objects(window: Window, model: Model) -> Figure:
    """Draw the objects that a map model finds in a window: a panel for each of `SHARES`.

    If the model's window slides, it still holds events from before `window`. They are drawn, too.
    """
    config = model.config
    processor = Processor(model, start_us=None if config.slides else window.start_us)
    events = window.events
    if config.last_us is not None:
        earlier = window.subject.events
        is_held = (earlier["t"] < window.start_us) & (
            earlier["t"] >= window.start_us - config.last_us
        )
        events = np.concatenate([earlier[is_held], events])
    events = events[np.argsort(events["t"], kind="stable")]
    decisions = []
    ends_us = [window.start_us + round(share * config.window_us) for share in SHARES]
    stops = np.searchsorted(events["t"], ends_us)
    # the last part is empty, because no event is after the window
    parts = np.split(events, stops)[:-1]
    for part, end_us in zip(parts, ends_us, strict=True):
        processor.push(part[:-1])
        # Objects shall keep their ids from panel to panel, but `fire` has no effect on later ids.
        # So the last event before a panel triggers a decision, which has.
        processor.every_events = 1
        processor.push(part[-1:])
        processor.every_events = None
        decisions.append(processor.fire(at_us=end_us - 1))
    titles = [f"{(end_us - window.start_us) / 1e3:g} ms" for end_us in ends_us]
    subject = window.subject
    title = f"{subject.name}, window {window.number}: objects that {subject.model_name} finds"
    return draw_objects(decisions, titles, events, model.config.sensor, title)


def draw_objects(
    decisions: Sequence[Decision],
    titles: Sequence[str],
    events: np.ndarray,
    sensor: tuple[int, int],
    heading: str,
) -> Figure:
    """Draw a panel for each decision.

    Parameters
    ----------
    decisions, titles : one for each panel.
    events : events of the recording, in order of time. A panel shows the events of the decision's
        window up to the decision.
    sensor : (width, height), in pixels.
    heading : the figure's title.
    """
    width, height = sensor
    side = (WIDTH - 2 * EDGE - (len(titles) - 1) * GAP) / len(titles)
    figure = new_figure(TOP + side * height / width + EDGE)
    for column, (decision, title) in enumerate(zip(decisions, titles, strict=True)):
        left = EDGE + column * (side + GAP)
        axes = axes_at(figure, left, TOP, side, side * height / width)
        in_window = (events["t"] >= decision.window_start_us) & (events["t"] <= decision.time_us)
        for p, colour in ((1, ON), (0, OFF)):
            shown_events = events[in_window & (events["p"] == p)]
            axes.plot(shown_events["x"], shown_events["y"], ",", color=colour, alpha=0.6)
        for item in decision.objects or ():
            _draw_object(axes, item, words_left=item.x > RIGHTMOST * width)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
        axes.spines[:].set_visible(True)
        axes.set_title(title, loc="left", fontsize=9, color=TEXT)
    headline(figure, heading)
    return figure


def _draw_object(axes: Any, item: Object, *, words_left: bool) -> None:
    """Draw an object's box, or a circle without one, with class, id and probability beside it."""
    if item.box is None:
        axes.plot(item.x, item.y, "o", ms=26, mfc="none", mec=TEXT, mew=0.7)
    else:
        x0, y0, x1, y1 = item.box
        axes.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], "-", color=TEXT, lw=0.9)
    second_line = f"id {item.id}, {item.probability:.2f}"
    for text, points_up, size in ((item.label, 7, 13), (second_line, -4, 7)):
        axes.annotate(
            text,
            (item.x, item.y),
            (-14 if words_left else 14, points_up),
            fontsize=size,
            color=TEXT,
            ha="right" if words_left else "left",
            textcoords="offset points",
        )
