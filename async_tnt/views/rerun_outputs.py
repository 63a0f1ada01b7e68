"""Log raw outputs to Rerun: a panel for each output, and a text about all of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from async_tnt.networks.layers.layer import Shape
from async_tnt.streaming.output import Output
from async_tnt.views.output_pictures import (
    KIND_WORDS,
    MOST_COLOURS,
    WHEEL_WORDS,
    channel_colours,
    kind_of,
    largest_channel,
    limits_of,
    limits_words,
    picture_of,
    span_words,
    wheel_picture,
)
from async_tnt.views.rerun_log import MOST_SHEET_PIXELS, NOTHING_COLOUR, plain

# the names under which data is logged
OUTPUTS = "outputs"
"""The output `flow` is logged as `outputs/flow`."""
ABOUT = "about_outputs"
WHEEL = "directions"

MOST_CURVES = 20
"""An output of more numbers is shown as bars of one moment, not as curves over time."""
MOST_WRITTEN = 4
"""The text names at most this many numbers of an output, or channels that are the largest one at
some place."""
LAST_CLASS_ID = (1 << 16) - 1
"""The viewer numbers channels in 16 bits. Further channels are shown as this one."""
WHEEL_SIDE = 201
"""Width of the legend of directions, in pixels."""


class OutputLog:
    """Logs raw outputs, as `rerun_log.AnswerLog` says.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream`.
    shapes : name of an output -> its shape.
    """

    def __init__(self, rr: Any, stream: Any, shapes: Mapping[str, Shape]) -> None:
        self._rr = rr
        self._stream = stream
        self._shapes = shapes
        for name, shape in shapes.items():
            if kind_of(shape) == "channels":
                annotations = rr.AnnotationContext(_names_and_colours(shape[0]))
                self._log(name, annotations, static=True)
            elif _has_curves(shape):
                n = math.prod(shape)
                names = [str(k) for k in range(n)]
                curves = rr.SeriesLines(names=names, colors=channel_colours(n)[:n])
                self._log(name, curves, static=True)
        if self._has_wheel:
            wheel = wheel_picture(WHEEL_SIDE, NOTHING_COLOUR)
            stream.log(WHEEL, rr.Image(wheel), static=True)

    @property
    def _has_wheel(self) -> bool:
        """Whether the legend of directions is needed."""
        return any(kind_of(shape) == "directions" for shape in self._shapes.values())

    def panels(self, time_ranges: Any) -> tuple[list[Any], list[Any]]:
        """The text and the legend in the upper row, a panel for each output in the lower row."""
        blueprint = self._rr.blueprint
        texts: Any = blueprint.TextDocumentView(origin=ABOUT, name="Outputs now")
        if self._has_wheel:
            legend = blueprint.Spatial2DView(origin=WHEEL, name=WHEEL_WORDS)
            texts = blueprint.Vertical(texts, legend, row_shares=[3, 2])
        panels = [self._panel(name, shape, time_ranges) for name, shape in self._shapes.items()]
        return [texts], [blueprint.Grid(*panels)]

    def _panel(self, name: str, shape: Shape, time_ranges: Any) -> Any:
        """The view of an output."""
        blueprint = self._rr.blueprint
        look = {
            "origin": self._rr.new_entity_path([OUTPUTS, name]),
            "name": f"{name}: {KIND_WORDS[kind_of(shape)]}",
        }
        if _has_curves(shape):
            return blueprint.TimeSeriesView(time_ranges=time_ranges, **look)
        if kind_of(shape) == "numbers":
            return blueprint.BarChartView(**look)
        return blueprint.Spatial2DView(**look)

    def kept(self, output: Output) -> Output:
        """The time, and copies of the outputs that are curves. The others have pictures alone."""
        curves = {
            name: array.copy()
            for name, array in zip(output.names, output.arrays, strict=True)
            if _has_curves(array.shape)
        }
        return replace(output, names=tuple(curves), arrays=tuple(curves.values()), changed=())

    def log_past(self, kept: Output, n_left_out: int) -> None:
        """Log the curves of an answer since the previous picture."""
        for name, array in zip(kept.names, kept.arrays, strict=True):
            self._log(name, self._rr.Scalars(array.ravel().astype(np.float64)))

    def log_now(self, output: Output) -> None:
        """Log the outputs about the open window: pictures, curves or bars, and the text."""
        lines = []
        for name, array in zip(output.names, output.arrays, strict=True):
            data, details = self._shown(array)
            # an empty window is no point of a curve
            if output.events or not _has_curves(array.shape):
                self._log(name, data)
            shape = "x".join(map(str, array.shape))
            lines.append(f"- **{plain(name)}**, {shape}, {span_words(array)}: {details}")
        text = self._rr.TextDocument(
            outputs_text(output, lines), media_type=self._rr.MediaType.MARKDOWN
        )
        self._stream.log(ABOUT, text)

    def _shown(self, array: np.ndarray) -> tuple[Any, str]:
        """What is logged of an output, and what the text says of it.

        Nothing that is logged refers to the array, which the next answer changes.
        """
        rr = self._rr
        kind = kind_of(array.shape)
        if kind == "numbers":
            numbers = array.ravel().astype(np.float64)
            is_curves = _has_curves(array.shape)
            return rr.Scalars(numbers) if is_curves else rr.BarChart(numbers), _listed(numbers)
        smaller = reduced(array)
        if kind == "channels":
            largest = largest_channel(smaller)
            image = np.minimum(largest, LAST_CLASS_ID).astype(np.uint16)
            return rr.SegmentationImage(image), channels_words(largest, array.shape[0])
        limits = limits_of([array])
        return rr.Image(picture_of(smaller, limits)), limits_words(kind, limits)

    def _log(self, name: str, data: Any, **settings: Any) -> None:
        """Log data under the name of an output, which may hold any characters."""
        self._stream.log([OUTPUTS, name], data, **settings)


def _has_curves(shape: Shape) -> bool:
    """Whether an output of this shape is shown as curves over time."""
    return kind_of(shape) == "numbers" and math.prod(shape) <= MOST_CURVES


def _names_and_colours(n_channels: int) -> list[tuple[int, str, list[int]]]:
    """Number, name and colour of the channels and of nan, for the viewer."""
    colours = channel_colours(n_channels).tolist()
    named = [(k, f"channel {k}", colours[k]) for k in range(min(n_channels, MOST_COLOURS))]
    return [*named, (min(n_channels, LAST_CLASS_ID), "nan", colours[-1])]


def reduced(array: np.ndarray, most_pixels: int = MOST_SHEET_PIXELS) -> np.ndarray:
    """Every f-th row and column of a map (C, H, W), so that at most `most_pixels` are left.

    Numbers are left out, not mixed, because the mean of two directions or classes means nothing.
    """
    _, height, width = array.shape
    step = max(1, math.ceil(math.sqrt(height * width / most_pixels)))
    return array[:, ::step, ::step]


def outputs_text(output: Output, lines: Sequence[str]) -> str:
    """A text in Markdown about the open window, with a line for each output."""
    length_ms = (output.time_us - output.window_start_us) / 1e3
    heading = f"# {output.events:,} events in {length_ms:,.1f} ms"
    if output.events == 0:
        heading = "# no event\n\nThe window has no event yet."
    return "\n".join([heading, "", *lines]) + "\n"


def channels_words(largest: np.ndarray, n_channels: int) -> str:
    """How often each channel is the largest, for people; the most frequent channels first.

    largest : the largest channel at each place, see `largest_channel`.
    """
    counts = np.bincount(largest.ravel(), minlength=n_channels + 1)
    order = np.argsort(-counts, kind="stable")
    order = order[: np.count_nonzero(counts)]
    parts = []
    for k in order[:MOST_WRITTEN].tolist():
        name = "nan" if k == n_channels else f"channel {k}"
        parts.append(f"{100 * counts[k] / largest.size:.0f} % {name}")
    if len(order) > MOST_WRITTEN:
        parts.append(f"{len(order) - MOST_WRITTEN} more")
    return ", ".join(parts)


def _listed(numbers: np.ndarray) -> str:
    """The first numbers, for people."""
    parts = [f"{number:.3g}" for number in numbers[:MOST_WRITTEN]]
    if len(numbers) > MOST_WRITTEN:
        parts.append(f"{len(numbers) - MOST_WRITTEN} more")
    return ", ".join(parts)
