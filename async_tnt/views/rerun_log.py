"""StreamLog: what is logged for a picture and for the decisions since the previous one."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.decision import Counts, Decision
from async_tnt.processor import Processor
from async_tnt.views import rerun_layout as layout
from async_tnt.views.rerun_pictures import bin_sheet, class_colours, event_image, newest_text

MOST_LINES = 20  # decisions written between two pictures, the newest
MOST_SERIES = 64  # with more classes, only the probability of the likeliest is drawn
MOST_TENSOR_BYTES = 1 << 20  # of a volume; a larger one is only written at the ends of windows
LANDMARK_COLOUR = (255, 255, 255)  # distinct from both polarities and the background
LANDMARK_RADIUS, CROSS_RADIUS = 4.0, 1.0  # points of the screen
CROSS_ARM = 0.06  # of the sensor's longer side
BEGIN_COLOUR = (150, 150, 150)  # the viewer would show lines without a colour in the colours of others
RATE_COLOURS = ((200, 200, 200), (213, 94, 0))


class StreamLog:
    """Writes to one Rerun recording.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream` whose sink is open.
    config : of the processor.
    live : whether the stream may go on for hours.
    """

    def __init__(self, rr: Any, stream: Any, config: TNTConfig, live: bool = False) -> None:
        self.name = ""
        """Of the source."""
        self.offset_us = 0
        """From the source's times to those of the timeline."""
        self.has_begun = False
        """Whether there was any event."""
        self.n_pictures = 0
        self._rr, self._stream, self._config = rr, stream, config
        self._transformed = config.transform == "tnt"
        self._channels = ["polarity and bin" if config.polarity == "split" else "bin", "y", "x"]
        self._classes: tuple[str, ...] | None = None
        self._pending: deque[Decision] = deque(maxlen=MOST_LINES)
        self._n_pending = 0
        self._latencies: list[float] = []
        self._counts = Counts()
        stream.send_blueprint(layout.blueprint(rr, config.sensor, self._transformed, live))
        self._write(layout.EVENTS, layout.event_classes(rr), static=True)
        for where, names in ((layout.RATES, layout.RATE_NAMES), (layout.LATENCY, layout.LATENCY_NAMES)):
            self._write(where, rr.SeriesLines(names=list(names), colors=list(RATE_COLOURS)), static=True)

    def begin(self, first_us: int) -> None:
        """A source's first event."""
        self.has_begun = True
        self._counts = Counts()
        if self.name:
            shift = f", its times moved by {self.offset_us:+,} us" if self.offset_us else ""
            self._set_time(first_us)
            line = self._rr.TextLog(f"{self.name} begins{shift}", level="DEBUG", color=BEGIN_COLOUR)
            self._write(layout.DECISIONS, line)

    def add(self, decisions: Sequence[Decision], latency_us: float, n_events: int) -> None:
        """Add the decisions of a packet and their latency."""
        self._pending.extend(decisions)
        self._n_pending += len(decisions)
        if n_events:
            self._latencies.append(latency_us)

    def write(
        self,
        at_us: int,
        span_us: int,
        now: Decision,
        recent: Sequence[np.ndarray],
        raw: np.ndarray,
        processor: Processor,
        whole: bool,
    ) -> None:
        """A picture.

        Parameters
        ----------
        at_us, span_us : the moment, and the recorded time since the last picture.
        now : the result of the processor's `fire`.
        recent : packets for the event image.
        raw : the raw volume, float32, shape (C, H, W).
        whole : whether the window is at its end.
        """
        rr = self._rr
        self.n_pictures += 1
        self._set_classes(processor.classes)
        self.write_decisions()
        self._set_time(at_us)
        packets = np.concatenate(recent) if recent else np.empty(0, [("x", "u2"), ("y", "u2"), ("p", "u1")])
        self._write(layout.EVENTS, rr.SegmentationImage(event_image(packets, self._config.sensor)))
        self._write_class(now)
        if self._transformed:
            self._write_landmark(processor, now)
            self._write_volume(layout.TNT_SHEET, layout.TNT_VOLUME, processor.volume(), whole)
        self._write_volume(layout.RAW_SHEET, layout.RAW_VOLUME, raw, whole)
        if now.events:
            self._write_probabilities(now)
        self._write_numbers(processor.counts, span_us)

    def no_events(self, at_us: int) -> None:
        """Log that no event arrived between the last picture and this moment."""
        self._set_time(at_us)
        self._write(layout.EVENTS, self._rr.SegmentationImage(np.zeros(self._config.sensor[::-1], np.uint8)))
        self._write(layout.RATES, self._rr.Scalars([0.0, 0.0]))

    def write_decisions(self) -> None:
        """Those since the last picture, each at its own time."""
        n_left_out = self._n_pending - len(self._pending)
        for decision in self._pending:
            self._set_time(decision.time_us)
            left_out = f" ({n_left_out:,} decisions before it are not shown)" if n_left_out else ""
            n_left_out = 0
            self._write(layout.DECISIONS, self._line(decision, left_out))
            self._write_probabilities(decision)
        self._pending.clear()
        self._n_pending = 0

    def _line(self, decision: Decision, left_out: str) -> Any:
        text = (
            f"{decision.label}  {decision.probability:.3f}  {decision.trigger}: {decision.events:,} events, "
            f"{decision.window_start_us / 1e3:,.3f} to {decision.time_us / 1e3:,.3f} ms{left_out}"
        )
        closed = decision.complete or decision.trigger == "end"
        return self._rr.TextLog(text, level="INFO" if closed else "TRACE", color=self._colours[decision.index])

    def _write_class(self, now: Decision) -> None:
        """The class at this moment: below the event image, and next to it with all probabilities."""
        rr = self._rr
        text = newest_text(now, self._classes or ())
        self._write(layout.NEWEST, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        points = rr.Points2D(np.empty((0, 2)))
        if now.events:
            width, height = self._config.sensor
            place = [[width / 2, height]]  # the viewer writes a label below its point
            label, colour = f"{now.label} {now.probability:.2f}", self._colours[now.index]
            points = rr.Points2D(place, radii=0.0, colors=[colour], labels=[label], show_labels=True)
        self._write(layout.CLASS, points)

    def _write_landmark(self, processor: Processor, now: Decision) -> None:
        """The landmark on the event image, in the sensor's pixels."""
        rr = self._rr
        if now.events == 0:
            self._write(layout.LANDMARK, rr.Points2D(np.empty((0, 2))))
            self._write(layout.LANDMARK_CROSS, rr.LineStrips2D([]))
            return
        x, y = self._config.to_sensor(*processor.landmark)
        x, y = x + 0.5, y + 0.5  # the viewer's pixel (0, 0) reaches from 0 to 1, ours has its centre at 0
        arm = CROSS_ARM * max(self._config.sensor)
        points, look = rr.components.Radius.ui_points, {"colors": [LANDMARK_COLOUR], "draw_order": 100.0}
        arms = [[[x - arm, y], [x + arm, y]], [[x, y - arm], [x, y + arm]]]
        self._write(layout.LANDMARK, rr.Points2D([[x, y]], radii=points(LANDMARK_RADIUS), **look))
        self._write(layout.LANDMARK_CROSS, rr.LineStrips2D(arms, radii=points(CROSS_RADIUS), **look))

    def _write_volume(self, sheet: str, place: str, volume: np.ndarray, whole: bool) -> None:
        self._write(sheet, self._rr.Image(bin_sheet(volume)))
        if whole or volume.nbytes <= MOST_TENSOR_BYTES:
            largest = max(float(np.abs(volume).max()), 1e-6)
            shown = self._rr.Tensor(volume, dim_names=self._channels, value_range=(-largest, largest))  # 0 is grey
            self._write(place, shown)

    def _write_probabilities(self, decision: Decision) -> None:
        shown = decision.probabilities if len(self._series) > 1 else [decision.probability]
        self._write(layout.PROBABILITIES, self._rr.Scalars(shown))

    def _write_numbers(self, counts: Counts, span_us: int) -> None:
        received = counts.received - self._counts.received
        dropped = received - (counts.kept - self._counts.kept)
        self._counts = counts
        per_s = 1e6 / max(span_us, 1)
        self._write(layout.RATES, self._rr.Scalars([received * per_s, dropped * per_s]))
        if self._latencies:
            self._write(layout.LATENCY, self._rr.Scalars([np.mean(self._latencies), max(self._latencies)]))
        self._latencies = []

    def _set_classes(self, classes: tuple[str, ...] | None) -> None:
        """Names and colours of the series, once they are known."""
        if classes is None or classes == self._classes:
            return
        self._classes = classes
        self._colours = class_colours(len(classes))
        self._series = list(classes) if 1 < len(classes) <= MOST_SERIES else ["likeliest class"]
        style = self._rr.SeriesLines(names=self._series, colors=self._colours[: len(self._series)])
        self._write(layout.PROBABILITIES, style, static=True)

    def _set_time(self, t_us: int) -> None:
        self._stream.set_time(layout.TIMELINE, duration=np.timedelta64(t_us + self.offset_us, "us"))

    def _write(self, entity: str, what: Any, static: bool = False) -> None:
        self._stream.log(entity, what, static=static)
