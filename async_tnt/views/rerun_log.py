"""Log a stream to Rerun, and lay out the viewer.

A picture is the state of the stream at a moment. With each picture, the answers since the previous
picture are logged: decisions by `rerun_decisions`, raw outputs by `rerun_outputs`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from async_tnt.streaming.processor import Processor
from async_tnt.volume.config import TNTConfig

TIMELINE = "time"
"""Name of the timeline. It shows the recording's own time, as a duration."""

# the names under which data is logged
EVENTS = "events/image"
LANDMARK = "events/landmark"
RAW = "volumes/raw"
TNT = "volumes/tnt"

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
"""Number of answers that are logged between two pictures, at most. They are the newest ones."""
MOST_SHEET_PIXELS = 1 << 17
"""Number of pixels of the picture of a volume or of an output, at most."""
LIVE_SECONDS = 10
"""Number of last seconds that the plots show of a live stream."""


class AnswerLog(Protocol):
    """Logs the answers of a processor, which are decisions or raw outputs."""

    def panels(self, time_ranges: Any) -> tuple[list[Any], list[Any]]:
        """The views of the answers for the upper and for the lower row of the viewer.

        time_ranges : what the plots show of the time, as the blueprint's views take it.
        """

    def kept(self, answer: Any) -> Any:
        """The part of an answer that is logged with the next picture. It has the `time_us`."""

    def log_past(self, kept: Any, n_left_out: int) -> None:
        """Log an answer since the previous picture.

        n_left_out : number of answers before it that are not logged.
        """

    def log_now(self, answer: Any) -> None:
        """Log the answer about the open window, which the processor has just given."""


class StreamLog:
    """Logs a stream to one Rerun recording.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream`.
    config : the processor's configuration.
    answers : logs the processor's answers.
    live : whether the stream may go on for hours.
    """

    def __init__(
        self, rr: Any, stream: Any, config: TNTConfig, answers: AnswerLog, live: bool = False
    ) -> None:
        self.n_pictures = 0
        self._rr = rr
        self._stream = stream
        self._config = config
        self._answers = answers
        self._pending: deque[Any] = deque(maxlen=MOST_LINES)
        self._n_pending = 0
        stream.send_blueprint(_blueprint(rr, config.transform == "tnt", answers, live))
        colours = [
            (NOTHING, "no event", NOTHING_COLOUR),
            (OFF, "OFF (darker)", OFF_COLOUR),
            (ON, "ON", ON_COLOUR),
        ]
        self._stream.log(EVENTS, rr.AnnotationContext(colours), static=True)

    def add(self, answers: Sequence[Any]) -> None:
        """Keep the answers to a packet, to be logged with the next picture."""
        self._pending.extend(self._answers.kept(answer) for answer in answers)
        self._n_pending += len(answers)

    def write(
        self,
        at_us: int,
        answer: Any,
        recent: np.ndarray,
        raw: np.ndarray,
        processor: Processor[Any],
    ) -> None:
        """Log a picture, and the answers since the previous picture.

        Parameters
        ----------
        at_us : the picture's moment, in microseconds of the recording.
        answer : the answer about the open window, from the processor's `fire`.
        recent : the events that the event image shows.
        raw : the volume without the transform, float32, shape (C, H, W).
        processor : gives the transformed volume and the landmark.
        """
        rr = self._rr
        self.n_pictures += 1
        self.write_pending()
        self._set_time(at_us)
        self._stream.log(EVENTS, rr.SegmentationImage(event_image(recent, self._config.sensor)))
        self._stream.log(RAW, rr.Image(bin_sheet(raw)))
        if self._config.transform == "tnt":
            self._stream.log(TNT, rr.Image(bin_sheet(processor.volume())))
            landmarks = [self._config.to_sensor(*processor.landmark)] if answer.events else []
            self._stream.log(LANDMARK, points_at(rr, landmarks, 5.0))
        self._answers.log_now(answer)

    def write_pending(self) -> None:
        """Log the answers since the previous picture, each at its own time."""
        n_left_out = self._n_pending - len(self._pending)
        for i, kept in enumerate(self._pending):
            self._set_time(kept.time_us)
            # the answers that are left out came before the first one that is kept
            self._answers.log_past(kept, n_left_out if i == 0 else 0)
        self._pending.clear()
        self._n_pending = 0

    def _set_time(self, t_us: int) -> None:
        self._stream.set_time(TIMELINE, duration=np.timedelta64(t_us, "us"))


def _blueprint(rr: Any, has_transform: bool, answers: AnswerLog, live: bool) -> Any:
    """The initial layout: pictures of events and volumes at the top, answers beside and below.

    Parameters
    ----------
    has_transform : whether there are a TNT volume and a landmark.
    answers : has the views of the answers.
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
    upper, lower = answers.panels([last_seconds] if live else None)
    rows = blueprint.Vertical(
        blueprint.Horizontal(*pictures, *upper), blueprint.Horizontal(*lower), row_shares=[5, 4]
    )
    return blueprint.Blueprint(rows, collapse_panels=True)


def points_at(
    rr: Any, places: Sequence[tuple[float, float]], size: float, labels: Sequence[str] | None = None
) -> Any:
    """White points at places (x, y), in sensor pixels."""
    # the viewer's pixel 0 reaches from 0 to 1, but our pixel 0 has its centre at 0
    centres = np.array(places).reshape(-1, 2) + 0.5
    radius = rr.components.Radius.ui_points(size)
    return rr.Points2D(centres, radii=radius, labels=labels, colors=[WHITE], draw_order=100.0)


def boxes_at(
    rr: Any, boxes: Sequence[tuple[float, float, float, float]], labels: Sequence[str]
) -> Any:
    """White boxes (x0, y0, x1, y1), in sensor pixels."""
    sides = np.array(boxes).reshape(-1, 4) + 0.5  # see `points_at`
    sizes = sides[:, 2:] - sides[:, :2]
    return rr.Boxes2D(
        mins=sides[:, :2], sizes=sizes, labels=labels, colors=[WHITE], draw_order=100.0
    )


def plain(text: str) -> str:
    """Markdown that shows the text as it is, on one line."""
    on_one_line = " ".join(text.split())
    special = r"\`*_{}[]<>()#+-.!|~&$"
    return "".join(f"\\{c}" if c in special else c for c in on_one_line)


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
