"""async-tnt check: compare the stream with the batch reference on recordings."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from async_tnt.base.extras import needs_extra
from async_tnt.base.progress import progress
from async_tnt.checking.comparison import PACKET_SIZES, Comparison
from async_tnt.checking.equality import check_recording, n_steps
from async_tnt.cli.options import (
    add_files,
    add_reading,
    model_of,
    paths_of,
    positive_int,
    reading_of,
)
from async_tnt.cli.output import note, say
from async_tnt.sources.files.recording import open_recording
from async_tnt.streaming.compile_ahead import must_compile
from async_tnt.volume.sensor import check_sensor

REMOVED = {"--start-us": "windows begin with the first event; --between-us chooses a part"}

SIZES_TEXT = ", ".join(str(size) for size in PACKET_SIZES[:-1])
"""The packet sizes as text. The last size, which stands for all events at once, is left out."""

DESCRIPTION = f"""\
Compare the stream with the batch reference in torch, on recordings. For every landmark:

  - Packets of {SIZES_TEXT} and all events give the same volume, bit for bit.
  - At prefixes of each window, the volume equals the reference's to 1e-6 of its largest
    cell, and the landmark to 1e-9 pixels.
  - The model's logits equal the reference's to 1e-4 (of the largest logit, if that
    exceeds 1), and the class is the same. So do raw outputs.
  - A decision after every event, refreshed from the one before, has the bits of a pass
    through the whole network.

Of a spiking model, all spikes and membranes are compared with a reference that computes
each neuron at each event, at prefixes and for packets of these sizes.

A model with landmark "regressor" is also checked with that landmark. It comes from
float32 convolutions and may differ by 1e-4 pixels. The volume equals the reference's to
1e-6 about the same landmark.

  async-tnt check                         the ten bundled recordings
  async-tnt check a.npz --prefixes all    at every prefix; takes minutes

Exit code 0 if all of it holds, 1 if anything does not.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_files(parser)
    add_reading(parser)
    parser.add_argument(
        "--prefixes",
        default="8",
        metavar="N|all",
        type=lambda text: None if text == "all" else positive_int(text),
        help="prefixes of each window to compare with the reference (default: 8, evenly spread; "
        "all: minutes)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object with every comparison")


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt check`. Returns the exit code."""
    with needs_extra("reference", "check needs the batch reference, which needs torch"):
        import tnt_reference  # noqa: F401
        import torch
    torch.set_num_threads(1)
    model = model_of(args.model)
    paths = paths_of(args)

    if must_compile():
        # A missing recording is reported before the wait for the compilation.
        for path in paths:
            open_recording(path, sensor=model.config.sensor)
    results: dict[Path, list[Comparison]] = {}
    with progress(len(paths) * n_steps(model), "checking") as bar:
        for path in paths:
            recording = open_recording(path, sensor=model.config.sensor, **reading_of(args))
            check_sensor(
                path,
                recording.sensor,
                model.config.sensor,
                advice="; --model FILE names one for this sensor",
            )
            events = recording.read()
            if len(events) == 0:
                raise ValueError(f"{recording.path}: no events to check")
            results[recording.path] = check_recording(
                events, model, prefixes=args.prefixes, on_progress=bar.update
            )

    is_equal = all(c.holds for comparisons in results.values() for c in comparisons)
    if args.json:
        say(json.dumps(_as_json(results, args.prefixes, is_equal)))
    else:
        _print_table(results, is_equal)
    return 0 if is_equal else 1


def _print_table(results: dict[Path, list[Comparison]], is_equal: bool) -> None:
    """Print a line for each comparison, with its worst difference over all recordings.

    Also print a line on stderr for each comparison that fails on a recording.
    """
    totals: dict[tuple[str, str], Comparison] = {}
    for comparisons in results.values():
        for c in comparisons:
            total = totals.setdefault((c.what, c.config), Comparison(c.what, c.config, c.bound))
            total.include(c)
    say(f"{'what is compared':<46} {'landmark':<19} {'times':>7} {'worst':>9} {'bound':>7}")
    for c in totals.values():
        mark = "ok" if c.holds else "FAILS"
        say(f"{c.what:<46} {c.config:<19} {c.n:>7} {c.worst:>9.2g} {c.bound:>7.0g}  {mark}")
    for path, comparisons in results.items():
        for c in comparisons:
            if not c.holds:
                note(f"{path}: {c.what} ({c.config}): {c.worst:.3g} in {c.n} comparisons")
    say(f"{len(results)} recordings: stream and batch are {'equal' if is_equal else 'NOT equal'}")


def _as_json(
    results: dict[Path, list[Comparison]], prefixes: int | None, is_equal: bool
) -> dict[str, object]:
    """All comparisons, as --json prints them."""
    return {
        "equal": is_equal,
        "prefixes": "all" if prefixes is None else prefixes,
        "packet_sizes": [size or "all" for size in PACKET_SIZES],
        "recordings": {
            str(path): [vars(c) | {"holds": c.holds} for c in comparisons]
            for path, comparisons in results.items()
        },
    }
