"""async-tnt evaluate of a map model: how many of a recording's objects it finds."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.cli.output import complain, say
from async_tnt.evaluation.object_scores import ObjectScores, score_recording
from async_tnt.evaluation.object_tables import find_tables, read_table
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import open_recording
from async_tnt.streaming.compile_ahead import fill_cache
from async_tnt.volume.sensor import check_sensor

NOT_FOR_OBJECTS = "roi", "crop", "mask", "out", "workers", "dask", "restart"


def evaluate_objects(args: argparse.Namespace, model: Model) -> int:
    """Score the recordings of `args.dataset` that have tables of objects; print the report."""
    if given := [f"--{name}" for name in NOT_FOR_OBJECTS if getattr(args, name)]:
        raise ValueError(f"{args.model} finds objects: {', '.join(given)} cannot be used with it")
    if model.config.window_events is not None:
        raise ValueError(
            f"{args.model}: objects are scored in windows of a duration, not of a number of events"
        )
    scores: dict[float, ObjectScores] = {}
    skipped: list[str] = []
    unknown: Counter[str] = Counter()
    n_moments = n_off = 0
    tables = find_tables(args.dataset)
    fill_cache(model=model)
    with progress(len(tables), "recordings") as bar:
        for path, file in tables:
            try:
                table = read_table(file, model.classes)
                recording = open_recording(
                    path,
                    sensor=args.sensor,
                    strict=True,
                    off_sensor="warn",
                    columns=args.columns,
                    topic=args.topic,
                )
                check_sensor(path, recording.sensor, args.sensor, "--sensor says")
                if recording.sensor is None:
                    raise ValueError(
                        f"{path}: the file does not state its sensor; give it with --sensor WxH"
                    )
                found = score_recording(model.for_sensor(recording.sensor), recording, table)
            except (ValueError, OSError) as error:
                skipped.append(str(error))
            else:
                n_moments += len(np.unique(table.t))
                n_off += int(
                    ((table.middle < 0) | (table.middle >= recording.sensor)).any(axis=1).sum()
                )
                scores = {
                    share: one + scores[share] if scores else one for share, one in found.items()
                }
                unknown.update(table.unknown)
            bar.update()
    if not scores:
        raise ValueError(
            f"{args.dataset}: none of {len(tables)} recordings can be evaluated; {skipped[0]}"
        )
    report: dict[str, Any] = {
        **scores[1.0].to_dict(model.classes),
        "f1_against_time_ms": {
            f"{s * model.config.window_us / 1e3:g}": round(of.f1, 5) for s, of in scores.items()
        },
        "recordings": len(tables) - len(skipped),
        "moments": n_moments,
        "unknown_classes": unknown,
        "off_sensor": n_off,
        "skipped": skipped,
    }
    say(*([json.dumps(report)] if args.json else _lines(report)))
    if unknown:
        of_each = ", ".join(f"{name} ({n})" for name, n in sorted(unknown.items()))
        complain(f"objects of classes that the model does not know do not count: {of_each}")
    if n_off:
        complain(
            f"objects whose middle is off the sensor cannot be found: {n_off}; is the table in its "
            "pixels?"
        )
    for line in skipped:
        complain(f"skipped: {line}")
    return 2 if skipped and args.strict else 0


def _lines(report: dict[str, Any]) -> list[str]:
    """The report for people."""
    lines = [
        f"F1 {report['f1']:.4f}: {report['precision']:.4f} of {report['found']} objects found are "
        "right, "
        f"{report['recall']:.4f} of {report['objects']} are found, "
        f"at {report['moments']} moments of {report['recordings']} recordings",
        "",
        f"{'class':<24} {'F1':>8} {'objects':>9} {'found':>9} {'right':>9}",
    ]
    for name, row in report["per_class"].items():
        lines.append(
            f"{name:<24} {row['f1']:>8.3f} {row['objects']:>9} {row['found']:>9} {row['right']:>9}"
        )
    lines += ["", f"{'ms into the window':<24} {'F1':>8}"]
    return lines + [f"{ms:<24} {f1:>8.3f}" for ms, f1 in report["f1_against_time_ms"].items()]
