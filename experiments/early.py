"""Early decisions: how accurate are they, how soon are they made, and how often was the network evaluated?

    python -m experiments.early [--nmnist FOLDER] [--recordings N] [--json FILE] [--picture FILE]

Streams N-MNIST's test recordings, FOLDER/Test/<digit>/*.bin (default: nmnist/ in $TNT_DATA), through the bundled
model, one window a saccade, with one setting of `Processor` after the other, and counts each window's early decision:
the first that a trigger makes, or with `confidence` the one that closes the window. A window without one counts with
its decision at the end. A measurement: nothing is set by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from async_tnt.package import available_cores
from async_tnt.progress import progress
from async_tnt.views.figure_style import OFF, ON, TEXT, axes_at, headline, new_figure, note
from experiments.measure_early import measure_early, n_settings
from experiments.script_options import add_folder, data_folder, exit_with, report_of, script_parser, write_outputs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUICK = 20  # recordings
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


def words(settings: dict[str, Any]) -> str:
    """`confidence .9, every 1 ms`."""
    parts = []
    if "confidence" in settings:
        parts.append(f"confidence {settings['confidence']:g}".replace("0.", "."))
    if "every_us" in settings:
        parts.append(f"every {settings['every_us'] / 1000:g} ms")
    if "every_events" in settings:
        parts.append(f"every {settings['every_events']} events")
    if "activity" in settings:
        leak_us = settings["activity"]["leak_us"]
        leak = "no leak" if leak_us is None else f"leak {leak_us / 1000:g} ms"
        parts.append(f"activity {settings['activity']['threshold']:g}, {leak}")
    return ", ".join(parts) or "the window's end"


def lines(report: dict[str, Any]) -> Iterator[str]:
    """The report as text."""
    yield (
        f"{report['recordings']:,} recordings, {report['windows_a_recording']} windows each, "
        f"model {report['model']}; first decision by a trigger, or else the window's end"
    )
    yield (
        f"{'':34}{'right %':>8}{'mean ms':>9}{'median':>8}{'events':>8}{'at end %':>10}{'evals':>8}"
        f"{'evals, all':>12}{'emitted':>9}{'< {} events %'.format(report['soon_events']):>15}"
    )
    for group in report["results"].values():
        yield ""
        for r in group:
            soon = f"{100 * r['soon']:.1f}"
            yield (
                f"{words(r['settings']):34}{100 * r['accuracy']:>8.1f}{r['mean_ms']:>9.1f}{r['median_ms']:>8.1f}"
                f"{r['mean_events']:>8.0f}{100 * r['at_end']:>10.1f}{r['evaluations_until']:>8.1f}"
                f"{r['evaluations']:>12.1f}{r['emitted']:>9.1f}{soon:>15}"
            )
    yield ""
    yield "Noise: windows closed early"
    yield f"{'':34}" + "".join(f"{kind:>14}" for kind in report["noise"])
    for rows in zip(*report["noise"].values(), strict=True):
        yield f"{words(rows[0]['settings']):34}" + "".join(f"{100 * r['closed_early']:>12.1f} %" for r in rows)


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


def main(argv: list[str] | None = None) -> int:
    """Run, print, and write JSON and the picture if asked."""
    parser = script_parser("early", __doc__, f"{QUICK} recordings", draws=True)
    add_folder(parser, "--nmnist", "with Test/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    parser.add_argument("--recordings", type=int, metavar="N", help="number of recordings, the same for each digit")
    cores = available_cores()
    parser.add_argument("--workers", type=int, default=cores, metavar="N", help="processes (default: one per core)")
    args = parser.parse_args(argv)
    for name in ("recordings", "workers"):
        if (value := getattr(args, name)) is not None and value < 1:
            parser.error(f"--{name} must be at least 1, got {value}")

    def measure() -> dict[str, Any]:
        nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
        with progress(n_settings(), "settings") as bar:
            n = QUICK if args.quick else args.recordings
            return measure_early(nmnist / "Test", n, workers=args.workers, each=bar.update)

    try:
        report = report_of(args, measure)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print("\n".join(lines(report)))
    write_outputs(args, report, draw_early)
    return 0


if __name__ == "__main__":
    exit_with(main)
