"""Log a stream to Rerun, and lay out the viewer.

A picture is the state of the stream at a moment. With each picture, the decisions since the
previous picture are logged.
"""

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
"""Name of the timeline. It shows the recording's own time, as a duration."""

# the names under which data is logged
EVENTS = "events/image"
LANDMARK = "events/landmark"
OBJECTS = "events/objects"
RAW = "volumes/raw"
TNT = "volumes/tnt"
PROBABILITIES = "probabilities"
CLASS = "class"
DECISIONS = "decisions"

# Okabe and Ito's colours, which colour-blind people can distinguish. They are bright, because the
# viewer is dark.
ON_COLOUR = (230, 159, 0)
OFF_COLOUR = (86, 180, 233)
NOTHING_COLOUR = (18, 20, 24)
GAP_COLOUR = (70, 74, 80)
WHITE = (255, 255, 255)

# values of the pixels of an event image
NOTHING = 0
OFF = 1
ON = 2

MOST_LINES = 20
"""Number of decisions that are logged between two pictures, at most. They are the newest ones."""
MOST_NAMED = 12
"""Number of classes in the text about the open window, at most. They are the likeliest ones."""
MOST_SHEET_PIXELS = 1 << 17
"""Number of pixels of the picture of a volume, at most."""
LIVE_SECONDS = 10
"""Number of last seconds that the plots show of a live stream."""


class StreamLog:
    """Logs a stream to one Rerun recording.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream`.
    config : the processor's configuration.
    live : whether the stream may go on for hours.
    """

    def __init__(self, rr: Any, stream: Any, config: TNTConfig, live: bool = False) -> None:
        self.n_pictures = 0
        self._rr = rr
        self._stream = stream
        self._config = config
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
        """Keep the decisions of a packet, to be logged with the next picture."""
        self._pending.extend(decisions)
        self._n_pending += len(decisions)

    def write(
        self,
        at_us: int,
        decision: Decision,
        recent: np.ndarray,
        raw: np.ndarray,
        processor: Processor,
    ) -> None:
        """Log a picture, and the decisions since the previous picture.

        Parameters
        ----------
        at_us : the picture's moment, in microseconds of the recording.
        decision : the decision about the open window, from the processor's `fire`.
        recent : the events that the event image shows.
        raw : the volume without the transform, float32, shape (C, H, W).
        processor : gives the transformed volume and the landmark.
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
            landmarks = [self._config.to_sensor(*processor.landmark)] if decision.events else []
            self._log_points(LANDMARK, landmarks, 5.0)
        if decision.objects is not None:
            object_places = [(item.x, item.y) for item in decision.objects]
            object_labels = [f"{item.label} {item.probability:.2f}" for item in decision.objects]
            self._log_points(OBJECTS, object_places, 6.0, object_labels)
        description = class_text(decision, self._classes)
        self._stream.log(CLASS, rr.TextDocument(description, media_type=rr.MediaType.MARKDOWN))
        if decision.events:
            self._log_probabilities(decision)

    def _log_points(
        self,
        name: str,
        places: Sequence[tuple[float, float]],
        size: float,
        labels: Sequence[str] | None = None,
    ) -> None:
        """Log white points at places (x, y), in sensor pixels."""
        rr = self._rr
        # the viewer's pixel 0 reaches from 0 to 1, but our pixel 0 has its centre at 0
        centres = np.array(places).reshape(-1, 2) + 0.5
        radius = rr.components.Radius.ui_points(size)
        points = rr.Points2D(centres, radii=radius, labels=labels, colors=[WHITE], draw_order=100.0)
        self._stream.log(name, points)

    def write_decisions(self) -> None:
        """Log the decisions since the previous picture, each at its own time."""
        n_left_out = self._n_pending - len(self._pending)
        for decision in self._pending:
            span = f"{decision.window_start_us / 1e3:,.3f} to {decision.time_us / 1e3:,.3f} ms"
            label = "nothing" if decision.label is None else decision.label
            outcome = f"{label}  {decision.probability:.3f}"
            text = f"{outcome}  {decision.trigger}: {decision.events:,} events, {span}"
            if n_left_out:
                text += f" ({n_left_out:,} decisions before it are not shown)"
                n_left_out = 0
            self._set_time(decision.time_us)
            # The viewer can filter lines by level: it can hide the many early decisions, and still
            # show the last decision of each window.
            is_last = decision.complete or decision.trigger == "end"
            level = "INFO" if is_last else "TRACE"
            self._stream.log(DECISIONS, self._rr.TextLog(text, level=level))
            self._log_probabilities(decision)
        self._pending.clear()
        self._n_pending = 0

    def _log_probabilities(self, decision: Decision) -> None:
        """Log the probability of each class.

        A class of a map model has the probability of its likeliest object.
        """
        probabilities: Any = decision.probabilities
        if decision.objects is not None:
            likeliest = dict.fromkeys(self._classes, 0.0)
            for item in decision.objects:
                likeliest[item.label] = max(likeliest[item.label], item.probability)
            probabilities = list(likeliest.values())
        self._stream.log(PROBABILITIES, self._rr.Scalars(probabilities))

    def _set_time(self, t_us: int) -> None:
        self._stream.set_time(TIMELINE, duration=np.timedelta64(t_us, "us"))


def _blueprint(rr: Any, has_transform: bool, live: bool) -> Any:
    """The initial layout: pictures and class at the top, plots and the log of decisions below.

    Parameters
    ----------
    has_transform : whether there are a TNT volume and a landmark.
    live : whether the plots show only the last seconds.
    """
    blueprint = rr.blueprint
    pictures = [
        blueprint.Spatial2DView(
            origin="events", name="Events and landmark" if has_transform else "Events"
        ),
        blueprint.Spatial2DView(origin=RAW, name="Raw volume, all bins"),
    ]
    if has_transform:
        pictures.append(blueprint.Spatial2DView(origin=TNT, name="TNT volume, all bins"))
    from_cursor = rr.TimeRangeBoundary.cursor_relative
    last_seconds = rr.VisibleTimeRange(
        TIMELINE, start=from_cursor(seconds=-LIVE_SECONDS), end=from_cursor()
    )
    plots = blueprint.TimeSeriesView(
        origin=PROBABILITIES, name="Probabilities", time_ranges=[last_seconds] if live else None
    )
    upper_row = blueprint.Horizontal(
        *pictures, blueprint.TextDocumentView(origin=CLASS, name="Class now")
    )
    lower_row = blueprint.Horizontal(
        plots, blueprint.TextLogView(origin=DECISIONS, name="Decisions")
    )
    return blueprint.Blueprint(
        blueprint.Vertical(upper_row, lower_row, row_shares=[5, 4]), collapse_panels=True
    )


def event_image(events: np.ndarray, sensor: tuple[int, int]) -> np.ndarray:
    """The polarity of each pixel's newest event.

    Parameters
    ----------
    events : structured array with x, y, p; checked, in order of arrival.
    sensor : (width, height) in pixels.

    Returns
    -------
    uint8, shape (height, width), indexed [y, x]: NOTHING, OFF or ON.
    """
    image = np.zeros((sensor[1], sensor[0]), np.uint8)
    # Where several events have the same pixel, NumPy keeps the last one.
    # `ON` is `OFF` + 1, and the polarity of an ON event is 1.
    image[events["y"], events["x"]] = OFF + events["p"]
    return image


def bin_sheet(volume: np.ndarray, most_pixels: int = MOST_SHEET_PIXELS) -> np.ndarray:
    """A picture of all bins of a volume, row by row from the top left.

    A positive cell has the colour of ON events, a negative cell that of OFF events. The brightness
    is the square root of the cell's magnitude, relative to the largest magnitude in the volume. So
    single events stay visible next to many.

    Parameters
    ----------
    volume : float32, shape (C, H, W).
    most_pixels : number of pixels of the picture without its gaps, at most. A larger volume is
        reduced by a whole factor, see `_reduced`.

    Returns
    -------
    uint8, shape (height, width, 3): RGB.
    """
    factor = math.ceil(math.sqrt(volume.size / most_pixels))
    bins = _reduced(volume, factor)
    channels, height, width = bins.shape
    columns = math.ceil(math.sqrt(channels))
    rows = math.ceil(channels / columns)

    magnitude = np.abs(bins)
    largest = max(float(magnitude.max()), 1e-9)  # nothing is divided by 0 in an empty volume
    brightness = np.sqrt(magnitude / largest)[..., None]
    full_colour = np.where(bins[..., None] > 0, ON_COLOUR, OFF_COLOUR)
    background = np.array(NOTHING_COLOUR)
    coloured = np.rint(background + brightness * (full_colour - background))

    # the bins have gaps of one pixel between them
    sheet = np.full((rows * (height + 1) - 1, columns * (width + 1) - 1, 3), GAP_COLOUR, np.uint8)
    for k in range(channels):
        row, column = divmod(k, columns)
        top = row * (height + 1)
        left = column * (width + 1)
        sheet[top : top + height, left : left + width] = coloured[k]
    return sheet


def _reduced(volume: np.ndarray, factor: int) -> np.ndarray:
    """A smaller volume, in which each block of factor x factor cells has become one cell.

    The new cell has the value of largest magnitude in the block, with its sign.
    """
    _, height, width = volume.shape
    rows = np.arange(0, height, factor)
    columns = np.arange(0, width, factor)
    high = np.maximum.reduceat(np.maximum.reduceat(volume, rows, axis=1), columns, axis=2)
    low = np.minimum.reduceat(np.minimum.reduceat(volume, rows, axis=1), columns, axis=2)
    return np.where(high >= -low, high, low)


def class_text(decision: Decision, classes: Sequence[str]) -> str:
    """A text in Markdown about the open window: its class, and the likeliest classes.

    For a map model, the text lists the objects instead.
    """
    if decision.events == 0:
        return "# no event\n\nThe window has no event yet."
    if decision.objects is not None:
        lines = [f"# {len(decision.objects)} objects", ""]
        lines += ["| number | class | probability | place |", "|---|---|---|---|"]
        for item in decision.objects:
            place = f"{item.x:.0f}, {item.y:.0f}"
            lines.append(f"| {item.id} | {_plain(item.label)} | {item.probability:.3f} | {place} |")
        return "\n".join(lines) + "\n"

    length_ms = (decision.time_us - decision.window_start_us) / 1e3
    evidence = f"from {decision.events:,} events in {length_ms:,.1f} ms"
    lines = [f"# {_plain(decision.label or 'nothing')}", ""]
    lines += [f"with probability {decision.probability:.3f}, {evidence}", ""]
    lines += ["| class | probability |", "|---|---|"]
    for k in np.argsort(-decision.probabilities, kind="stable")[:MOST_NAMED]:
        lines.append(f"| {_plain(classes[k])} | {decision.probabilities[k]:.3f} |")
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Markdown that shows the text as it is, on one line."""
    on_one_line = " ".join(text.split())
    special = r"\`*_{}[]<>()#+-.!|~&$"
    return "".join(f"\\{c}" if c in special else c for c in on_one_line)
