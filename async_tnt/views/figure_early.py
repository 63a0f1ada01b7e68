"""Panels about early decisions: accuracy against time and against events, and what a level of confidence costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from async_tnt.views.figure_style import GREY, OFF, PALE, note

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from async_tnt.views.figure_confusion import Panel

DASHED = (0, (3, 2))


def early_panels(report: Mapping[str, Any]) -> Sequence[Panel]:
    """Panels for `draw_confusion`, from a report of `evaluation.early.early_report`; none for windows of events."""
    if not report["accuracy_against_time"]:
        return ()
    time = [(row["time_us"] / 1e3, row["accuracy"], row["decided"]) for row in report["accuracy_against_time"]]
    events = [(row["events"], row["accuracy"], row["reached"]) for row in report["accuracy_against_events"]]
    return (
        partial(_draw_course, course=time, other="decided", xlabel="ms into the window"),
        partial(_draw_course, course=events, other="with as many", xlabel="first events of the window", xscale="log"),
        partial(_draw_levels, levels=report["confidence"]),
    )


def _draw_course(axes: Axes, course: Sequence[tuple[float, float, float]], other: str, **settings: Any) -> None:
    """course : (place, share of windows right, another share of windows, named by `other`)."""
    at, right, share = zip(*course, strict=True)
    axes.plot(at, right, color=OFF, marker="o", markersize=3.5, label="right")
    axes.plot(at, share, color=GREY, linestyle=DASHED, label=other)
    _look(axes, ylabel="windows", **settings)


def _draw_levels(axes: Axes, levels: Sequence[Mapping[str, Any]]) -> None:
    reached = [row for row in levels if row["accuracy"] is not None]
    ms = [row["median_ms"] for row in reached]
    axes.plot(ms, [row["accuracy"] for row in reached], color=OFF, marker="o", markersize=3.5, label="right of these")
    axes.plot(ms, [row["decided"] for row in reached], color=GREY, linestyle=DASHED, label="windows that reach it")
    for row, x in zip(reached, ms, strict=True):
        note(axes, f"{row['level']:g}", (x, row["accuracy"]), (2, -11))
    axes.margins(x=0.12)
    _look(axes, xlabel="median ms until a confidence is reached")


def _look(axes: Axes, **settings: Any) -> None:
    axes.set(ylim=(0, 1.05), **settings)
    if axes.get_xscale() == "linear":
        axes.set_xlim(0, None)
    else:
        axes.xaxis.set_major_formatter(lambda count, _: f"{count:,.0f}")
    axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    axes.grid(color=PALE, linewidth=0.5)
    axes.legend(loc="lower right")
