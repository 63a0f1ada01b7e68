"""Names of what is logged, and the initial layout of the viewer."""

from __future__ import annotations

from typing import Any

from async_tnt.views.rerun_pictures import NOTHING, NOTHING_COLOUR, OFF, OFF_COLOUR, ON, ON_COLOUR

APPLICATION = "async_tnt"
TIMELINE = "time"
"""The recording's own microseconds, as a duration."""

EVENTS = "events/image"
LANDMARK, LANDMARK_CROSS = "events/landmark", "events/landmark_cross"
CLASS = "events/class"
RAW_SHEET, RAW_VOLUME = "volumes/raw/bins", "volumes/raw/volume"
TNT_SHEET, TNT_VOLUME = "volumes/tnt/bins", "volumes/tnt/volume"
PROBABILITIES = "probabilities"
NEWEST = "newest"
DECISIONS = "decisions"
RATES, LATENCY = "rates", "latency"

RATE_NAMES = ("events received / s", "events dropped / s")
LATENCY_NAMES = ("us of a packet, mean", "us of a packet, longest")

LIVE_SECONDS = 10  # of the plots, where a stream has no end
MARGIN = 0.02  # around the event image, as a share of it
LABEL_MARGIN = 0.14  # below it, for the class: on the image the text would hide the events


def event_classes(rr: Any) -> Any:
    """The meaning of the cells of an event image; one without a colour would get an arbitrary one."""
    return rr.AnnotationContext(
        [
            (NOTHING, "no event", NOTHING_COLOUR),
            (OFF, "OFF (darker)", OFF_COLOUR),
            (ON, "ON (brighter)", ON_COLOUR),
        ]
    )


def blueprint(rr: Any, sensor: tuple[int, int], transformed: bool, live: bool = False) -> Any:
    """The initial layout; the user may change it.

    At the top events, volumes and class; below them the plots and the log of decisions. The side panels are closed; the
    buttons at the top right of the window open them.

    Parameters
    ----------
    rr : the module `rerun`.
    sensor : (width, height) in pixels.
    transformed : whether there is a TNT volume next to the raw one, and a landmark.
    live : whether the stream may go on for hours: then the plots show its last seconds, else all of it.
    """
    b = rr.blueprint
    pictures = [_events(b, sensor, transformed), _volume(b, "Raw", RAW_SHEET, RAW_VOLUME)]
    if transformed:
        pictures.append(_volume(b, "TNT", TNT_SHEET, TNT_VOLUME))
    newest = b.TextDocumentView(origin=NEWEST, name="Class now")
    plotted: dict[str, Any] = {"plot_legend": b.PlotLegend(corner=b.Corner2D.LeftTop)}  # the newest is at the right
    if live:
        begins = rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_SECONDS)
        ends = rr.TimeRangeBoundary.cursor_relative()
        plotted["time_ranges"] = [rr.VisibleTimeRange(TIMELINE, start=begins, end=ends)]
    numbers = b.Tabs(
        b.TimeSeriesView(
            origin=PROBABILITIES,
            name="Probabilities",
            axis_y=b.ScalarAxis(range=(-0.05, 1.05)),  # at 0 and 1 the line and its label would be cut in half
            **plotted,
        ),
        b.TimeSeriesView(origin=RATES, name="Rates", **plotted),
        b.TimeSeriesView(origin=LATENCY, name="Latency", **plotted),
        active_tab=0,
    )
    return b.Blueprint(
        b.Vertical(
            b.Horizontal(*pictures, newest, column_shares=[3] * len(pictures) + [2]),
            b.Horizontal(numbers, _decisions(b), column_shares=[6, 5]),
            row_shares=[5, 4],
        ),
        collapse_panels=True,
    )


def _events(b: Any, sensor: tuple[int, int], transformed: bool) -> Any:
    width, height = sensor
    bounds = b.VisualBounds2D(
        x_range=(-MARGIN * width, (1 + MARGIN) * width), y_range=(-MARGIN * height, (1 + LABEL_MARGIN) * height)
    )
    name = "Events and landmark (cross)" if transformed else "Events"
    return b.Spatial2DView(origin="events", name=name, visual_bounds=bounds)


def _volume(b: Any, what: str, sheet: str, volume: str) -> Any:
    return b.Tabs(
        b.Spatial2DView(origin=sheet, name=f"{what} volume, all bins"),
        b.TensorView(
            origin=volume,
            name="one bin",  # of the three dimensions' names the viewer takes x to the right and y downwards
            scalar_mapping=b.TensorScalarMapping(colormap="cyantoyellow"),  # zero is grey; as ON and OFF, nearly
        ),
        active_tab=0,
    )


def _decisions(b: Any) -> Any:
    shown = {}
    if hasattr(b, "TextLogColumns"):  # rerun 0.29 and newer; before it, columns are the viewer's own choice
        shown["columns"] = b.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["Body"])
    return b.TextLogView(origin=DECISIONS, name="Decisions", **shown)
