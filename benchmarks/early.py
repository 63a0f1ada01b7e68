"""Early decisions: how accurate are they, how soon are they made, and how often was the network evaluated?

    python benchmarks/early.py [FOLDER] [--recordings N] [--json FILE] [--picture FILE]

Streams real recordings, FOLDER/<digit>/*.bin in N-MNIST's format (default: nmnist/Test in $TNT_DATA), through the
bundled model, one window a saccade, with one setting of `Processor` after the other, and counts each window's early
decision: the first that a trigger makes, or with `confidence` the one that closes the window. A window without one
counts with its decision at the end. A measurement: nothing is set by it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from draw_early import draw_early
from measure_early import measure_early, n_settings
from script_options import report_of, script_parser, write_outputs

from async_tnt.process import available_cores
from async_tnt.progress import progress

QUICK = 20  # recordings


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


def default_folder() -> Path:
    """N-MNIST's test part in $TNT_DATA."""
    root = os.environ.get("TNT_DATA")
    if not root:
        raise ValueError("no recordings: give FOLDER, or set TNT_DATA to the folder with nmnist/")
    return Path(root) / "nmnist" / "Test"


def main(argv: list[str] | None = None) -> int:
    """Run, print, and write JSON and the picture if asked."""
    parser = script_parser(__doc__, f"{QUICK} recordings", draws=True)
    parser.add_argument("folder", nargs="?", type=Path, metavar="FOLDER")
    parser.add_argument("--recordings", type=int, metavar="N", help="number of recordings, the same for each digit")
    cores = available_cores()
    parser.add_argument("--workers", type=int, default=cores, metavar="N", help="processes (default: one per core)")
    args = parser.parse_args(argv)
    for name in ("recordings", "workers"):
        if (value := getattr(args, name)) is not None and value < 1:
            parser.error(f"--{name} must be at least 1, got {value}")

    def measure() -> dict[str, Any]:
        with progress(n_settings(), "settings") as bar:
            n = QUICK if args.quick else args.recordings
            return measure_early(args.folder or default_folder(), n, workers=args.workers, each=bar.update)

    try:
        report = report_of(args, measure)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print("\n".join(lines(report)))
    write_outputs(args, report, draw_early)
    return 0


if __name__ == "__main__":
    sys.exit(main())
