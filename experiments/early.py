"""Early decisions: how accurate are they, how soon are they made, and how often was the network evaluated?

    python -m experiments.early [--nmnist FOLDER] [--json FILE] [--picture FILE]

Streams N-MNIST's test recordings, FOLDER/Test/<digit>/*.bin (default: nmnist/ in $TNT_DATA), through the bundled
model, one window a saccade, with one setting of `Processor` after the other, and counts each window's early decision:
the first that a trigger makes, or with `confidence` the one that closes the window. A window without one counts with
its decision at the end. A measurement: nothing is set by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from async_tnt import Decision, Model, Processor, load_model, warmup
from async_tnt.progress import progress
from async_tnt.sources import open_recording
from async_tnt.sources.labelled_recordings import find_recordings
from async_tnt.views.figure_style import ON, TEXT, axes_at, headline, new_figure, note
from experiments.bench_timing import machine
from experiments.script_options import add_folder, data_folder, exit_with, run_script, script_parser

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODEL = "digits"
QUICK = 2  # recordings of each digit
N_WINDOWS = 3  # saccades; a few events follow them
MOMENTS_MS = (10, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80, 90, 100, 105)
LEVELS = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
LOOKS = {  # group: words, colour, line, marker
    "moment": ("at a fixed time (every_us)", "#000000", "-", "o"),
    "confidence": ("confidence, checked at every event", ON, "-", "o"),
    "confidence_every_ms": ("confidence, checked every 1 ms", "#009E73", (0, (1.5, 1)), "^"),
}
ACCURACIES = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995)
NAMED_LEVELS = (0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
NAMED_MS = (20, 25, 30, 35, 40, 50)

Settings = dict[str, Any]


def all_settings(window_us: int) -> dict[str, list[Settings]]:
    """Groups of settings of `Processor`; without any it decides at a window's end only."""
    return {
        "moment": [{"every_us": 1000 * ms} if 1000 * ms < window_us else {} for ms in MOMENTS_MS],
        "confidence": [{"confidence": level} for level in LEVELS],
        "confidence_every_ms": [{"confidence": level, "every_us": 1000} for level in LEVELS],
    }


class Early(NamedTuple):
    """The early decision of one window."""

    right: bool
    ms: float
    """From the window's start to the decision."""
    by_trigger: bool
    """False: at the window's end."""
    evaluations: int
    """Of the network up to it, including its own."""
    emitted: int
    """Decisions of the window."""


def early_decision(decisions: Sequence[Decision], settings: Settings, window_us: int, truth: int) -> Early:
    """Of all decisions on one window, in their order."""
    trigger = "confidence" if "confidence" in settings else "every_us"
    early = next((d for d in decisions if d.trigger == trigger), None)
    chosen = decisions[-1] if early is None else early
    due_us: float = window_us
    if early is not None:
        due_us = early.time_us - early.window_start_us
        if "every_us" in settings:  # due at that moment, on the events before it
            due_us = (due_us // settings["every_us"] + 1) * settings["every_us"]
    evaluations = next(k for k, d in enumerate(decisions) if d is chosen) + 1
    if set(settings) == {"confidence"}:  # after every event, and once more at the end of a window that stayed open
        evaluations = chosen.events + (early is None)
    return Early(chosen.index == truth, due_us / 1000, early is not None, evaluations, len(decisions))


def early_decisions(model: Model, recordings: Sequence[tuple[int, np.ndarray]], settings: Settings) -> list[Early]:
    """The early decisions on all windows of recordings, (class, events)."""
    window_us = model.config.window_us
    processor = Processor(model, start_us=0, **settings)
    found = []
    for truth, events in recordings:
        processor.reset()
        windows: dict[int, list[Decision]] = {}
        for decision in [*processor.push(events), *processor.finish()]:
            windows.setdefault(decision.window_start_us, []).append(decision)
        for start_us, decisions in windows.items():
            if start_us < N_WINDOWS * window_us:
                found.append(early_decision(decisions, settings, window_us, truth))
    return found


def summary(early: Sequence[Early]) -> dict[str, float]:
    """Means over windows; `at_end` is the share of those without an early decision."""
    right, ms, by_trigger, evaluations, emitted = np.array(early, float).T
    return {
        "windows": len(early),
        "accuracy": float(right.mean()),
        "mean_ms": float(ms.mean()),
        "median_ms": float(np.median(ms)),
        "at_end": float(1 - by_trigger.mean()),
        "evaluations_until": float(evaluations.mean()),
        "emitted": float(emitted.mean()),
    }


def measure(nmnist: Path, per_digit: int | None) -> dict[str, Any]:
    """All settings on all test recordings, or on the first ones of each digit, as one JSON object."""
    model = load_model(MODEL)
    warmup(model)
    recordings = [
        (model.classes.index(name), open_recording(one.path).read())
        for name, of_digit in find_recordings(nmnist, "Test").items()
        for one in of_digit[:per_digit]
    ]
    groups = all_settings(model.config.window_us)
    found: dict[str, list[dict[str, Any]]] = {}
    with progress(sum(map(len, groups.values())), "settings") as bar:
        for group, choices in groups.items():
            found[group] = []
            for settings in choices:
                early = early_decisions(model, recordings, settings)
                found[group].append({"settings": settings, **summary(early)})
                bar.update()
    return {
        "machine": machine(),
        "model": MODEL,
        "window_us": model.config.window_us,
        "recordings": len(recordings),
        "windows_a_recording": N_WINDOWS,
        "results": found,
    }


def draw_early(report: dict[str, Any]) -> Figure:
    """Two panels with one axis of accuracy, spread out near 100 %: against mean milliseconds to the decision, and
    against evaluations of the network up to it."""
    figure = new_figure(4.8)
    left = axes_at(figure, 0.73, 0.78, 4.37, 3.12)
    right = axes_at(figure, 5.82, 0.78, 4.37, 3.12, sharey=left)
    results = report["results"]
    for group, (label, colour, line, marker) in LOOKS.items():
        rows = results[group]
        y = [max(1 - r["accuracy"], 1e-3) for r in rows]  # none wrong: at the edge
        width = 1.8 if group == "confidence" else 1.2
        look: dict[str, Any] = {"color": colour, "ls": line, "marker": marker, "ms": 4.5, "lw": width}
        left.plot([r["mean_ms"] for r in rows], y, label=label, **look)
        right.plot([r["evaluations_until"] for r in rows], y, **(look | {"ls": ""} if group == "moment" else look))
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
    figure.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.06, 0.0), ncols=3, labelcolor=TEXT)
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


def main(argv: list[str] | None = None) -> int:
    """Run, print, and write JSON and the picture if asked."""
    parser = script_parser("early", __doc__, f"{QUICK} recordings of each digit", draws=True)
    add_folder(parser, "--nmnist", "with Test/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    args = parser.parse_args(argv)

    def measured(quick: bool) -> dict[str, Any]:
        return measure(data_folder(args.nmnist, "nmnist", "--nmnist"), QUICK if quick else None)

    return run_script(parser, argv, measured, "early", draw_early)


if __name__ == "__main__":
    exit_with(main)
