"""What is logged to Rerun for a picture and for the decisions since the previous one, and the
viewer's layout."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.streaming.decision import Decision
from async_tnt.streaming.processor import Processor
from async_tnt.volume.config import TNTConfig

TIMELINE = "time"
"""The recording's own microseconds, as a duration."""
EVENTS, LANDMARK, OBJECTS = "events/image", "events/landmark", "events/objects"
RAW, TNT = "volumes/raw", "volumes/tnt"
PROBABILITIES = "probabilities"
CLASS, DECISIONS = "class", "decisions"

# Okabe and Ito's colours, which colour-blind people can distinguish; bright ones, as the viewer is
# dark
ON_COLOUR, OFF_COLOUR = (230, 159, 0), (86, 180, 233)
NOTHING_COLOUR, GAP_COLOUR, WHITE = (18, 20, 24), (70, 74, 80), (255, 255, 255)
NOTHING, OFF, ON = 0, 1, 2
"""Cells of an event image."""
MOST_LINES = 20  # decisions written between two pictures, the newest
MOST_NAMED = 12  # classes in the text, the likeliest
MOST_SHEET_PIXELS = 1 << 17
LIVE_SECONDS = 10  # of the plots, where a stream has no end


class StreamLog:
    """Writes to one Rerun recording.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream`.
    config : of the processor.
    live : whether the stream may go on for hours.
    """

    def __init__(self, rr: Any, stream: Any, config: TNTConfig, live: bool = False) -> None:
        self.n_pictures = 0
        self._rr, self._stream, self._config = rr, stream, config
        self._classes: tuple[str, ...] = ()
        self._pending: deque[Decision] = deque(maxlen=MOST_LINES)
        self._n_pending = 0
        stream.send_blueprint(_blueprint(rr, config.transform == "tnt", live))
        colours = [
            (NOTHING, "no event", NOTHING_COLOUR),
            (OFF, "OFF (darker)", OFF_COLOUR),
            (ON, "ON", ON_COLOUR),
        ]
        self._stream.log(EVENTS, rr.AnnotationContext(colours), static=True)

    def add(self, decisions: Sequence[Decision]) -> None:
        """Add the decisions of a packet."""
        self._pending.extend(decisions)
        self._n_pending += len(decisions)

    def write(
        self, at_us: int, now: Decision, recent: np.ndarray, raw: np.ndarray, processor: Processor
    ) -> None:
        """A picture.

        Parameters
        ----------
        at_us : the moment.
        now : the result of the processor's `fire`.
        recent : events for the event image.
        raw : the volume without the transform, float32, shape (C, H, W).
        """
        rr = self._rr
        self.n_pictures += 1
        if processor.classes is not None and processor.classes != self._classes:
            self._classes = processor.classes
            self._stream.log(PROBABILITIES, rr.SeriesLines(names=list(self._classes)), static=True)
        self.write_decisions()
        self._set_time(at_us)
        self._stream.log(EVENTS, rr.SegmentationImage(event_image(recent, self._config.sensor)))
        self._stream.log(RAW, rr.Image(bin_sheet(raw)))
        if self._config.transform == "tnt":
            self._stream.log(TNT, rr.Image(bin_sheet(processor.volume())))
            # the viewer's pixel (0, 0) reaches from 0 to 1, ours has its centre at 0
            places = (
                [np.add(self._config.to_sensor(*processor.landmark), 0.5)]
                if now.events
                else np.empty((0, 2))
            )
            radius = rr.components.Radius.ui_points(5.0)
            self._stream.log(
                LANDMARK, rr.Points2D(places, radii=radius, colors=[WHITE], draw_order=100.0)
            )
        if now.objects is not None:
            # as above
            centres = np.array([(found.x, found.y) for found in now.objects]).reshape(-1, 2) + 0.5
            labels = [f"{found.label} {found.probability:.2f}" for found in now.objects]
            size = rr.components.Radius.ui_points(6.0)
            self._stream.log(
                OBJECTS,
                rr.Points2D(centres, radii=size, labels=labels, colors=[WHITE], draw_order=100.0),
            )
        self._stream.log(
            CLASS, rr.TextDocument(class_text(now, self._classes), media_type=rr.MediaType.MARKDOWN)
        )
        if now.events:
            self._log_probabilities(now)

    def write_decisions(self) -> None:
        """Those since the last picture, each at its own time."""
        n_left_out = self._n_pending - len(self._pending)
        for d in self._pending:
            span = f"{d.window_start_us / 1e3:,.3f} to {d.time_us / 1e3:,.3f} ms"
            label = "nothing" if d.label is None else d.label
            text = f"{label}  {d.probability:.3f}  {d.trigger}: {d.events:,} events, {span}"
            if n_left_out:
                text += f" ({n_left_out:,} decisions before it are not shown)"
                n_left_out = 0
            self._set_time(d.time_us)
            self._stream.log(
                DECISIONS,
                self._rr.TextLog(
                    text, level="INFO" if d.complete or d.trigger == "end" else "TRACE"
                ),
            )
            self._log_probabilities(d)
        self._pending.clear()
        self._n_pending = 0

    def _log_probabilities(self, decision: Decision) -> None:
        shown: Any = decision.probabilities
        if decision.objects is not None:  # of each class the likeliest object
            shown = [
                max((o.probability for o in decision.objects if o.label == c), default=0.0)
                for c in self._classes
            ]
        self._stream.log(PROBABILITIES, self._rr.Scalars(shown))

    def _set_time(self, t_us: int) -> None:
        self._stream.set_time(TIMELINE, duration=np.timedelta64(t_us, "us"))


def _blueprint(rr: Any, transformed: bool, live: bool) -> Any:
    """The initial layout: pictures and class at the top, plots and the log of decisions below.

    transformed : whether there are a TNT volume and a landmark.
    live : the plots show the last seconds only.
    """
    b = rr.blueprint
    pictures = [
        b.Spatial2DView(origin="events", name="Events and landmark" if transformed else "Events"),
        b.Spatial2DView(origin=RAW, name="Raw volume, all bins"),
    ]
    if transformed:
        pictures.append(b.Spatial2DView(origin=TNT, name="TNT volume, all bins"))
    at = rr.TimeRangeBoundary.cursor_relative
    last = rr.VisibleTimeRange(TIMELINE, start=at(seconds=-LIVE_SECONDS), end=at())
    plots = b.TimeSeriesView(
        origin=PROBABILITIES, name="Probabilities", time_ranges=[last] if live else None
    )
    top = b.Horizontal(*pictures, b.TextDocumentView(origin=CLASS, name="Class now"))
    below = b.Horizontal(plots, b.TextLogView(origin=DECISIONS, name="Decisions"))
    return b.Blueprint(b.Vertical(top, below, row_shares=[5, 4]), collapse_panels=True)


def event_image(events: np.ndarray, sensor: tuple[int, int]) -> np.ndarray:
    """Which polarity each pixel's newest event had.

    Parameters
    ----------
    events : structured array with x, y, p; checked, in order of arrival.
    sensor : (width, height) in pixels.

    Returns
    -------
    uint8, shape (height, width), indexed [y, x]: NOTHING, OFF or ON.
    """
    image = np.zeros((sensor[1], sensor[0]), np.uint8)
    # of several at one pixel NumPy keeps the last
    image[events["y"], events["x"]] = OFF + events["p"]
    return image


def bin_sheet(volume: np.ndarray, most_pixels: int = MOST_SHEET_PIXELS) -> np.ndarray:
    """All bins of a volume side by side: row by row, the first one at the top left.

    The colour shows the sign (ON positive, OFF negative), its brightness the square root of the
    value relative to the largest one in the volume: single events stay visible next to many.

    Parameters
    ----------
    volume : float32, shape (C, H, W).
    most_pixels : of the sheet, gaps not counted. A larger volume is reduced by a whole number, each
        of its blocks of cells shown by the largest value in it.

    Returns
    -------
    uint8, shape (height, width, 3): RGB.
    """
    bins = _reduced(volume, math.ceil(math.sqrt(volume.size / most_pixels)))
    channels, height, width = bins.shape
    columns = math.ceil(math.sqrt(channels))
    rows = -(-channels // columns)
    level = np.sqrt(np.abs(bins) / max(float(np.abs(bins).max()), 1e-9))[..., None]
    colours = np.where(bins[..., None] > 0, ON_COLOUR, OFF_COLOUR)
    coloured = np.rint(NOTHING_COLOUR + level * (colours - np.array(NOTHING_COLOUR)))
    sheet = np.full((rows * (height + 1) - 1, columns * (width + 1) - 1, 3), GAP_COLOUR, np.uint8)
    for k in range(channels):
        top, left = k // columns * (height + 1), k % columns * (width + 1)
        sheet[top : top + height, left : left + width] = coloured[k]
    return sheet


def _reduced(volume: np.ndarray, factor: int) -> np.ndarray:
    """Each block of factor x factor cells as the one of the largest magnitude, with its sign."""
    rows, columns = (np.arange(0, side, factor) for side in volume.shape[1:])
    high, low = (
        f.reduceat(f.reduceat(volume, rows, axis=1), columns, axis=2)
        for f in (np.maximum, np.minimum)
    )
    return np.where(high >= -low, high, low)


def class_text(now: Decision, classes: Sequence[str]) -> str:
    """Markdown: the class of the open window at this moment, and the likeliest classes."""
    if now.events == 0:
        return "# no event\n\nThe window has no event yet."
    if now.objects is not None:
        rows = "\n".join(
            f"| {o.id} | {_plain(o.label)} | {o.probability:.3f} | {o.x:.0f}, {o.y:.0f} |"
            for o in now.objects
        )
        return f"# {len(now.objects)} objects\n\n| number | class | probability | place |\n|---|---|---|---|\n{rows}\n"
    length_ms = (now.time_us - now.window_start_us) / 1e3
    likeliest = np.argsort(-now.probabilities, kind="stable")[:MOST_NAMED]
    rows = "\n".join(f"| {_plain(classes[k])} | {now.probabilities[k]:.3f} |" for k in likeliest)
    about = (
        f"with probability {now.probability:.3f}, from {now.events:,} events in {length_ms:,.1f} ms"
    )
    return f"# {_plain(now.label or 'nothing')}\n\n{about}\n\n| class | probability |\n|---|---|\n{rows}\n"


def _plain(text: str) -> str:
    """Markdown that shows the text itself, on one line."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-.!|~&$" else c for c in " ".join(text.split()))
