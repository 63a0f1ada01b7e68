"""Names of what is logged, and where the viewer shows it at first."""

from __future__ import annotations

from typing import Any

from .pictures import OFF, OFF_COLOUR, ON, ON_COLOUR

APPLICATION = "async_tnt"
TIMELINE = "time"
"""The recording's own microseconds, as a duration."""

EVENTS = "events/image"
LANDMARK = "events/landmark"
RAW_SHEET, RAW_VOLUME = "volumes/raw/bins", "volumes/raw/volume"
TNT_SHEET, TNT_VOLUME = "volumes/tnt/bins", "volumes/tnt/volume"
PROBABILITIES = "probabilities"
NEWEST = "newest"
DECISIONS = "decisions"
RATES, LATENCY = "rates", "latency"

RATE_NAMES = ("events received / s", "events dropped / s")
LATENCY_NAMES = ("us of a packet, mean", "us of a packet, longest")


def event_classes(rr: Any) -> Any:
    """What the cells of an event image mean."""
    return rr.AnnotationContext([(OFF, "OFF (darker)", OFF_COLOUR), (ON, "ON (brighter)", ON_COLOUR)])


def blueprint(rr: Any, transformed: bool) -> Any:
    """The layout at first opening; who watches may change it.

    Parameters
    ----------
    rr : the module `rerun`.
    transformed : whether there is a TNT volume beside the raw one.
    """
    b = rr.blueprint
    sheets = [b.Spatial2DView(origin=RAW_SHEET, name="Raw volume, all bins")]
    volumes = [b.TensorView(origin=RAW_VOLUME, name="Raw volume, bin by bin")]
    if transformed:
        sheets.append(b.Spatial2DView(origin=TNT_SHEET, name="TNT volume, all bins"))
        volumes.append(b.TensorView(origin=TNT_VOLUME, name="TNT volume, bin by bin"))
    said = b.Tabs(
        b.TextLogView(origin=DECISIONS, name="Decisions"),
        b.BarChartView(origin=NEWEST, name="Newest probabilities"),
        active_tab=0,
    )
    numbers = b.Tabs(
        b.TimeSeriesView(origin=PROBABILITIES, name="Probabilities", axis_y=b.ScalarAxis(range=(0.0, 1.0))),
        b.TimeSeriesView(origin=RATES, name="Rates"),
        b.TimeSeriesView(origin=LATENCY, name="Latency"),
        active_tab=0,
    )
    return b.Blueprint(
        b.Vertical(
            b.Horizontal(b.Spatial2DView(origin="events", name="Events and landmark"), said, column_shares=[3, 2]),
            b.Tabs(b.Horizontal(*sheets, name="All bins"), b.Horizontal(*volumes, name="Bin by bin"), active_tab=0),
            numbers,
            row_shares=[5, 4, 3],
        ),
        b.SelectionPanel(state="collapsed"),
    )
