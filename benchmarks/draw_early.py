"""The picture of `benchmarks/early.py`: how right decisions are against when they fall, and against what they took."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from async_tnt.views.figure_style import LARGE, OFF, ON, SMALL, TEXT, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = {  # group: words, colour, line, marker
    "moment": ("at a fixed moment (every_us)", "#000000", "-", "o"),
    "every_events": ("after so many events (every_events)", OFF, "-", "o"),
    "activity": ("at a burst of activity (LeakyIntegrator)", "#8a8a8a", "", "x"),
    "confidence": ("once sure (confidence), looked for at every event", ON, "-", "o"),
    "confidence_every_10_events": ("once sure, looked for every 10 events", "#B87A00", (0, (4, 1.5)), "s"),
    "confidence_every_ms": ("once sure, looked for every 1 ms", "#009E73", (0, (1.5, 1)), "^"),
}
ACCURACIES = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995)
NAMED_LEVELS = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
NAMED_MS = (20, 25, 30, 35, 40, 50)


def draw_early(report: dict[str, Any]) -> Figure:
    """Two panels with one axis of accuracy, spread where it nears 100 %: against mean milliseconds to the decision, and
    against how often the network was asked up to it."""
    figure = new_figure(5.2)
    left = figure.add_axes((0.07, 0.25, 0.42, 0.6))
    right = figure.add_axes((0.56, 0.25, 0.42, 0.6), sharey=left)
    results = report["results"]
    for group, (label, colour, line, marker) in LOOKS.items():
        rows = results[group]
        y = [max(1 - r["accuracy"], 1e-3) for r in rows]  # none wrong: at the edge
        width = 1.8 if group == "confidence" else 1.2
        look: dict[str, Any] = {"color": colour, "ls": line, "marker": marker, "ms": 4.5, "lw": width}
        left.plot([r["mean_ms"] for r in rows], y, label=label, **look)
        asked = [r["evaluations_until"] for r in rows]
        if group.startswith("confidence"):
            right.plot(asked, y, **look)
        elif group == "moment":
            right.plot(asked, y, **{**look, "ls": ""})
    _lay_axes(left, right, report["window_us"] / 1000)
    for r in results["confidence"]:
        if r["settings"]["confidence"] in NAMED_LEVELS:
            words = f"{r['settings']['confidence']:g}".lstrip("0")
            for axes, x in ((left, r["mean_ms"]), (right, r["evaluations_until"])):
                _name(axes, x, r["accuracy"], words, ON, (-5, 4), "right")
    for r in results["moment"]:
        ms = r["settings"].get("every_us", 0) / 1000
        if ms in NAMED_MS:
            _name(right, r["evaluations_until"], r["accuracy"], f"{ms:g} ms", "#000000", (7, -3), "left")
    words = f"Early decisions of {report['model']} on {report['recordings']:,} real recordings"
    figure.text(0.07, 0.94, words, fontsize=LARGE + 2, fontweight="bold", va="center")
    left.set_ylabel("windows decided right (%)")
    left.set_xlabel("mean time from the window's start to the decision (ms)")
    right.set_xlabel("mean evaluations of the network up to it")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.06, 0.0), ncols=2, labelcolor=TEXT)
    return figure


def _lay_axes(left: Any, right: Any, window_ms: float) -> None:
    left.set_yscale("log")
    left.set_ylim(0.6, 0.004)  # wrong ones, upside down: right ones
    left.set_yticks([1 - a for a in ACCURACIES], [f"{100 * a:g}" for a in ACCURACIES])
    left.minorticks_off()
    left.set_xlim(0, window_ms * 1.03)
    right.set_xscale("log")
    right.set_xlim(0.8, 2000)
    right.set_xticks([1, 10, 100, 1000], ["1", "10", "100", "1,000"])
    right.minorticks_off()
    right.tick_params(labelleft=False)
    for axes in (left, right):
        axes.grid(axis="y", color="#e4e4e4", lw=0.7)
        axes.set_axisbelow(True)


def _name(axes: Any, x: float, accuracy: float, words: str, colour: str, offset: tuple[int, int], side: str) -> None:
    axes.annotate(
        words,
        (x, max(1 - accuracy, 1e-3)),
        xytext=offset,
        textcoords="offset points",
        ha=side,
        fontsize=SMALL,
        color=colour,
    )
