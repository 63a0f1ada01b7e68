"""Draw raw outputs of a recording: a row for each output, a column for each of some windows.

A row has one scale, and its legend at the right end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from async_tnt.networks.models.model import Model
from async_tnt.streaming.output import Output
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.streams import pieces_for
from async_tnt.views.figure_style import (
    GREY,
    NORMAL,
    PALE,
    SMALL,
    TEXT,
    WIDTH,
    axes_at,
    few_ticks,
    picture_at,
    shortened,
    write_at,
)
from async_tnt.views.figure_subject import Subject, Window, evenly_spread
from async_tnt.views.output_pictures import (
    KIND_WORDS,
    Kind,
    Limits,
    channel_colours,
    kind_of,
    largest_channel,
    limits_of,
    limits_words,
    picture_of,
    wheel_picture,
)
from async_tnt.volume.config import with_an_end

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_COLUMNS = 5
"""Number of windows whose outputs are drawn, at most. They are evenly spread."""
MOST_ROWS = 12
"""Number of outputs that are drawn, at most. They are the first ones."""
MOST_CHANNELS = 8
"""Number of channels that a legend names, at most. They are the most frequent ones."""
MOST_NUMBERED = 12
"""If an output has more numbers, its bars have neither numbers nor gaps."""

LEFT = 0.75
"""Inches left of the pictures."""
RIGHT = 1.75
"""Inches right of the pictures, for the legends."""
GAP = 0.08
"""Inches between the columns."""
HEAD = 0.72
"""Inches above the first row, for the title and the moments."""
NAME = 0.26
"""Inches above the pictures of a row, for the output's name."""
ROW_GAP = 0.16
"""Inches below a row."""
TALLEST = 1.9
"""Height of a picture in inches, at most."""
LEGEND_HEIGHT = 1.4
"""Height of the legend of directions and of that of channels, in inches."""
BARS_HEIGHT = 1.0
"""Height of a plot of numbers, in inches."""
BAR_NUMBERS = 0.2
"""Inches below a plot of numbers, for the numbers of its bars."""
NARROWEST = 1.1
"""Width of a column in inches, at least, so that its title has room."""
FLATTEST = 4.0
"""A picture is at most this many times as wide as high, or as high as wide."""
LEGEND = {"fontsize": SMALL, "color": TEXT}
"""How the words of a legend look."""
WHEEL_SIDE = 0.8
"""Width of the legend of directions, in inches."""
LINE = 0.155
"""Inches from line to line of a legend."""


def shown_windows(window: Window, model: Model) -> np.ndarray:
    """Numbers of the model's windows whose outputs are drawn: int64, ascending.

    They are spread over the recording. The window in which `window` begins is one of them.
    """
    subject = window.subject
    window_us = model.config.window_us
    filled = subject.filled_windows(window_us)
    shown = filled[evenly_spread(len(filled), MOST_COLUMNS)]
    drawn = (window.start_us - subject.first_us) // window_us + 1
    if drawn in filled:
        shown[np.abs(shown - drawn).argmin()] = drawn
    return shown


def last_outputs(subject: Subject, model: Model, numbers: np.ndarray) -> list[Output]:
    """The outputs at the ends of these windows of a recording.

    A window that slides is read at the ends of stretches of its own length. There it holds what a
    fixed window holds.
    """
    model = replace(model, config=with_an_end(model.config))
    processor: Processor[Output] = Processor(model, start_us=subject.start_us)
    starts_us = set((subject.first_us + (numbers - 1) * model.config.window_us).tolist())
    return [
        output.copy()  # the next output would change its arrays
        for output in _outputs(processor, subject.events)
        if output.window_start_us in starts_us
    ]


def _outputs(processor: Processor[Output], events: np.ndarray) -> Iterator[Output]:
    """The outputs of a recording, each valid until the next one."""
    for piece in pieces_for(processor, events):
        yield from processor.push(piece)
    yield from processor.finish()


class _Row(NamedTuple):
    """A row of pictures, or of plots of numbers."""

    name: str
    """Name of the output."""
    kind: Kind
    width: float
    """Width of a picture, in inches."""
    height: float
    """Height of a picture, in inches."""

    @property
    def total_height(self) -> float:
        """Height with the name, the numbers of bars and the gap below, in inches."""
        height = self.height
        if self.kind == "numbers":
            height += BAR_NUMBERS
        elif self.kind != "grey":
            height = max(height, LEGEND_HEIGHT)
        return NAME + height + ROW_GAP


def _rows_of(model: Model, n_columns: int) -> list[_Row]:
    """The rows of the first outputs, in which the pictures of all columns have room."""
    widest = (WIDTH - LEFT - RIGHT - GAP * (n_columns - 1)) / n_columns
    rows = []
    for name, shape in list(model.output_shapes.items())[:MOST_ROWS]:
        kind = kind_of(shape)
        if kind == "numbers":
            rows.append(_Row(name, kind, min(widest, TALLEST), BARS_HEIGHT))
            continue
        ratio = min(max(shape[1] / shape[2], 1 / FLATTEST), FLATTEST)
        height = min(TALLEST, widest * ratio)
        rows.append(_Row(name, kind, height / ratio, height))
    return rows


def outputs_height(window: Window, model: Model) -> float:
    """Height of what `draw_outputs` draws, in inches."""
    n_columns = len(shown_windows(window, model))
    return HEAD + sum(row.total_height for row in _rows_of(model, n_columns))


def draw_outputs(figure: Figure, window: Window, model: Model, top: float) -> None:
    """Draw the outputs at the ends of some windows, `top` inches below the figure's upper edge.

    Parameters
    ----------
    window : the window whose volumes the figure shows. Its outputs are among those that are drawn.
    """
    subject = window.subject
    numbers = shown_windows(window, model)
    outputs = last_outputs(subject, model, numbers)
    rows = _rows_of(model, len(numbers))
    step = max(NARROWEST, *(row.width for row in rows)) + GAP

    title = f"outputs of {subject.model_name} at the ends of windows"
    if len(rows) < len(model.outputs):
        title += f" (the first {len(rows)} of {len(model.outputs)})"
    write_at(figure, 0.21, top + 0.07, title)
    for column, (number, output) in enumerate(zip(numbers.tolist(), outputs, strict=True)):
        left = LEFT + column * step
        moment = f"{subject.since_start_ms(output.time_us):,.1f} ms"
        write_at(figure, left, top + 0.34, f"window {number}", fontsize=SMALL)
        write_at(figure, left, top + 0.34 + LINE, moment, fontsize=SMALL)

    row_top = top + HEAD
    for row in rows:
        _draw_row(figure, row, [output[row.name] for output in outputs], step, row_top)
        row_top += row.total_height


def _draw_row(
    figure: Figure, row: _Row, arrays: Sequence[np.ndarray], step: float, top: float
) -> None:
    """Draw an output: its name, a picture of each array, and the legend.

    Parameters
    ----------
    arrays : the output at each moment.
    step : inches from column to column.
    top : inches from the figure's upper edge.
    """
    shape = "x".join(map(str, arrays[0].shape))
    words = f"{shortened(row.name, 40)} ({shape}): {KIND_WORDS[row.kind]}"
    if any(np.isnan(array).any() for array in arrays):
        words += "; nan is left out" if row.kind == "numbers" else "; nan is dark red"
    write_at(figure, LEFT, top + 0.1, words, fontsize=NORMAL)

    top += NAME
    limits = limits_of(arrays)
    span = _span(arrays)
    for column, array in enumerate(arrays):
        left = LEFT + column * step
        if row.kind == "numbers":
            axes = axes_at(figure, left, top, row.width, row.height)
            _draw_bars(axes, array.ravel(), span, is_first=column == 0)
        else:
            axes = picture_at(figure, left, top, row.width, row.height)
            axes.imshow(picture_of(array, limits), aspect="auto", interpolation="nearest")

    legend_left = LEFT + len(arrays) * step + 0.06
    if row.kind == "grey":
        _grey_legend(figure, limits, legend_left, top, row.height)
    elif row.kind == "directions":
        _wheel_legend(figure, limits, legend_left, top)
    elif row.kind == "channels":
        _channel_legend(figure, arrays, legend_left, top)


def _span(arrays: Sequence[np.ndarray]) -> tuple[float, float]:
    """The least and the largest finite number of arrays. Zero is between them."""
    values = np.concatenate([array.ravel() for array in arrays]).astype(np.float64)
    values = np.append(values[np.isfinite(values)], 0)
    return float(values.min()), float(values.max())


def _draw_bars(
    axes: Any, numbers: np.ndarray, span: tuple[float, float], *, is_first: bool
) -> None:
    """Draw numbers as bars. inf reaches to the end of the span, and nan has no bar."""
    least, largest = span
    n = len(numbers)
    heights = np.clip(numbers, least, largest)
    places = np.arange(n)
    if n <= MOST_NUMBERED:
        axes.bar(places, heights, color=GREY)
        axes.set_xticks(places)
    else:
        # one outline, because thousands of bars would take seconds
        axes.stairs(heights, np.arange(n + 1) - 0.5, fill=True, color=GREY)
        axes.set_xticks([])
    axes.axhline(0, color=TEXT, lw=0.6)
    margin = 0.05 * (largest - least)
    if margin == 0:
        margin = 1.0
    axes.set(xlim=(-0.6, n - 0.4), ylim=(least - margin, largest + margin))
    axes.yaxis.set_major_locator(few_ticks())
    axes.tick_params(length=2, colors=TEXT, labelleft=is_first)


def _grey_legend(figure: Figure, limits: Limits, left: float, top: float, height: float) -> None:
    """Draw a bar from black to white, with the numbers; or write the only number."""
    lowest, highest = limits
    if lowest == highest:
        write_at(figure, left, top + 0.1, limits_words("grey", limits), **LEGEND)
        return
    axes = axes_at(figure, left, top, 0.1, height)
    shades = np.linspace(1, 0, 256)[:, np.newaxis]
    axes.imshow(shades, cmap="gray", aspect="auto", extent=(0, 1, lowest, highest))
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.yaxis.set_major_locator(few_ticks())
    axes.tick_params(labelsize=SMALL, length=2, colors=TEXT)
    axes.spines[:].set(visible=True, color=PALE)


def _wheel_legend(figure: Figure, limits: Limits, left: float, top: float) -> None:
    """Draw the colours of all directions, and write the length that the rim stands for."""
    axes = picture_at(figure, left, top, WHEEL_SIDE, WHEEL_SIDE)
    axes.imshow(wheel_picture(201, (255, 255, 255)))
    axes.spines[:].set_visible(False)
    rim = f"rim: {limits.highest:.3g} and more" if limits.highest else "rim: above 0"
    for line, words in enumerate(("right: channel 0", "down: channel 1", rim)):
        line_top = top + WHEEL_SIDE + 0.12 + line * LINE
        write_at(figure, left, line_top, words, **LEGEND)


def _channel_legend(figure: Figure, arrays: Sequence[np.ndarray], left: float, top: float) -> None:
    """Write the most frequent channels beside their colours."""
    n_channels = arrays[0].shape[0]
    counts = np.zeros(n_channels + 1, np.int64)
    for array in arrays:
        counts += np.bincount(largest_channel(array).ravel(), minlength=n_channels + 1)
    order = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
    colours = channel_colours(n_channels) / 255
    for line, k in enumerate(sorted(order[:MOST_CHANNELS].tolist())):
        line_top = top + 0.07 + line * LINE
        axes = picture_at(figure, left, line_top - 0.05, 0.1, 0.1)
        axes.set_facecolor(colours[k])
        words = "nan" if k == n_channels else f"channel {k}"
        write_at(figure, left + 0.16, line_top, words, **LEGEND)
    if len(order) > MOST_CHANNELS:
        words = f"{len(order) - MOST_CHANNELS} more"
        line_top = top + 0.07 + MOST_CHANNELS * LINE
        write_at(figure, left + 0.16, line_top, words, **LEGEND)
