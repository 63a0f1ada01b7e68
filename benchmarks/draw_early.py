"""The picture of `benchmarks/early.py`: accuracy of decisions against their time, and against their cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from async_tnt.views.figure_style import OFF, ON, TEXT, axes_at, headline, new_figure, note

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = {  # group: words, colour, line, marker
    "moment": ("at a fixed time (every_us)", "#000000", "-", "o"),
    "every_events": ("after N events (every_events)", OFF, "-", "o"),
    "activity": ("at a burst of activity (LeakyIntegrator)", "#8a8a8a", "", "x"),
    "confidence": ("confidence, checked at every event", ON, "-", "o"),
    "confidence_every_10_events": ("confidence, checked every 10 events", "#B87A00", (0, (4, 1.5)), "s"),
    "confidence_every_ms": ("confidence, checked every 1 ms", "#009E73", (0, (1.5, 1)), "^"),
}
ACCURACIES = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995)
NAMED_LEVELS = (0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
NAMED_MS = (20, 25, 30, 35, 40, 50)


def draw_early(report: dict[str, Any]) -> Figure:
    """Two panels with one axis of accuracy, spread out near 100 %: against mean milliseconds to the decision, and
    against evaluations of the network up to it."""
    figure = new_figure(5.2)
    left = axes_at(figure, 0.73, 0.78, 4.37, 3.12)
    right = axes_at(figure, 5.82, 0.78, 4.37, 3.12, sharey=left)
    results = report["results"]
    for group, (label, colour, line, marker) in LOOKS.items():
        rows = results[group]
        y = [max(1 - r["accuracy"], 1e-3) for r in rows]  # none wrong: at the edge
        width = 1.8 if group == "confidence" else 1.2
        look: dict[str, Any] = {"color": colour, "ls": line, "marker": marker, "ms": 4.5, "lw": width}
        left.plot([r["mean_ms"] for r in rows], y, label=label, **look)
        evaluations = [r["evaluations_until"] for r in rows]
        if group.startswith("confidence"):
            right.plot(evaluations, y, **look)
        elif group == "moment":
            right.plot(evaluations, y, **{**look, "ls": ""})
    _lay_axes(left, right, report["window_us"] / 1000)
    for r in results["confidence"]:
        if r["settings"]["confidence"] in NAMED_LEVELS:
            words = f"{r['settings']['confidence']:g}".lstrip("0")
            for axes, x in ((left, r["mean_ms"]), (right, r["evaluations_until"])):
                note(axes, words, (x, max(1 - r["accuracy"], 1e-3)), (-5, 4), color=ON, ha="right")
    for r in results["moment"]:
        ms = r["settings"].get("every_us", 0) / 1000
        if ms in NAMED_MS:
            place = r["evaluations_until"], max(1 - r["accuracy"], 1e-3)
            note(right, f"{ms:g} ms", place, (7, -3), color="#000000")
    headline(figure, f"Early decisions of {report['model']} on {report['recordings']:,} real recordings")
    left.set_ylabel("windows decided correctly (%)")
    left.set_xlabel("mean time from the window's start to the decision (ms)")
    right.set_xlabel("mean evaluations of the network up to the decision")
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
