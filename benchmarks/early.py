"""Deciding early: how right is a decision, how soon does it fall, and how often was the network asked for it?

    python benchmarks/early.py [FOLDER] [--recordings N] [--json FILE] [--picture FILE]

Streams real recordings, FOLDER/<digit>/*.bin in N-MNIST's format (default: nmnist/Test in $TNT_DATA, or in
../shared/data beside the checkout), through the bundled model, one window a saccade, with one setting of `Processor`
after the other, and counts each window's early decision: the first that a trigger makes, or with `confidence` the one
that closes the window. A window without one counts with its decision at the end. A measurement: nothing is set by it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from draw_early import draw_early
from measure_early import measure_early, n_settings

from async_tnt.archive.executor import available_cores
from async_tnt.cli.options import writable_file
from async_tnt.files import write_text
from async_tnt.progress import progress
from async_tnt.views.figure_style import check_picture

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
        f"{'':34}{'right %':>8}{'mean ms':>9}{'median':>8}{'events':>8}{'at end %':>10}{'asked':>8}"
        f"{'asked, all':>12}{'emitted':>9}{'< {} events %'.format(report['soon_events']):>15}"
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
    yield "Events that show nothing, uniform over pixels, time and polarity: windows closed early"
    for r in report["noise"]:
        when = f", after {r['mean_ms']:.1f} ms" if r["mean_ms"] is not None else ""
        yield f"{words(r['settings']):34}{100 * r['closed_early']:>8.1f} %{when}"


def default_folder() -> Path:
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("TNT_DATA", beside)) / "nmnist" / "Test"


def main(argv: list[str] | None = None) -> int:
    """Run, print, and write JSON and the picture if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=default_folder(), metavar="FOLDER")
    parser.add_argument("--recordings", type=int, metavar="N", help="so many, the same number of each digit")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} recordings: does it all run?")
    parser.add_argument(
        "--workers",
        type=int,
        default=available_cores(),
        metavar="N",
        help="processes; nothing is timed here (default: one for each core)",
    )
    parser.add_argument("--json", type=writable_file, metavar="FILE", help="also write the figures there")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="also draw them: .png, .svg or .pdf")
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="FILE",
        help="take the figures from such a JSON file instead of measuring",
    )
    args = parser.parse_args(argv)
    if args.recordings is not None and args.recordings < 1:
        parser.error(f"--recordings must be at least 1, got {args.recordings}")
    if args.workers < 1:
        parser.error(f"--workers must be at least 1, got {args.workers}")
    try:
        if args.picture:
            check_picture(args.picture)
        if args.source:
            report = json.loads(args.source.read_text(encoding="utf-8"))
        else:
            with progress(n_settings(), "settings") as bar:
                n = QUICK if args.quick else args.recordings
                report = measure_early(args.folder, n, workers=args.workers, each=bar.update)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    print("\n".join(lines(report)))
    if args.json:
        write_text(args.json, json.dumps(report, indent=1) + "\n")
    if args.picture:
        from async_tnt.views.figure_style import save, styled

        with styled():
            save(draw_early(report), args.picture, dpi=100)
    return 0


if __name__ == "__main__":
    sys.exit(main())
