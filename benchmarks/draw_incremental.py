"""The picture of `benchmarks/incremental.py`: four networks, microseconds per decision against new events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from draw_decisions import NETWORKS, draw_lines, lay_axis

from async_tnt.views.figure_style import LARGE, SMALL, TEXT, axes_at, headline, new_figure, write_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT_OUT = "onnxruntime_run"  # the binding is as fast or faster


def draw_incremental(report: dict[str, Any]) -> Figure:
    """Medians and quartiles in blocks; hollow: medians from call to call."""
    figure = new_figure(4.4)
    looks = {name: look for name, look in NETWORKS.items() if name != LEFT_OUT}
    for k, (name, row) in enumerate(report["networks"].items()):
        axes = axes_at(figure, 0.62 + 2.12 * k, 0.95, 1.72, 2.6)
        draw_lines(axes, row["network"], looks)
        lay_axis(axes)
        axes.set_xlabel("new events", fontsize=SMALL)
        axes.set_title(f"{name}, {' x '.join(map(str, row['volume']))}", loc="left", fontsize=LARGE)
        if k == 0:
            axes.set_ylabel("microseconds per decision")
    headline(figure, "Time per decision, four networks")
    x = 0.62
    for name, (label, colour) in looks.items():
        if name in report["networks"]["thesis"]["network"]["1"]["in_blocks"]["us"]:
            write_at(figure, x, 4.28, label.replace("\n", " "), fontsize=SMALL, color=colour, va="bottom")
            x += 1.75
    write_at(figure, 6.9, 4.28, report["machine"]["cpu"] + ", one thread", fontsize=SMALL, color=TEXT, va="bottom")
    return figure
