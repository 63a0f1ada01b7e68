"""async-tnt evaluate of a map model: how many of a recording's objects it finds."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.cli.options import size_of
from async_tnt.cli.output import complain, say
from async_tnt.evaluation.object_scores import ObjectScores, score_objects
from async_tnt.evaluation.object_tables import ObjectTable, find_tables, read_table
from async_tnt.events import EVENT_DTYPE
from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from async_tnt.progress import progress
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.sensor import Sensor

SHARES = 0.3, 0.5, 1.0
"""Of a window, after which objects are looked for."""
NOT_FOR_OBJECTS = "picture", "roi", "mask", "out", "workers", "dask", "restart"


def evaluate_objects(args: argparse.Namespace, model: Model) -> int:
    """Score the recordings of `args.dataset` that have tables of objects; print the report."""
    if given := [f"--{name}" for name in NOT_FOR_OBJECTS if getattr(args, name)]:
        raise ValueError(f"{args.model} finds objects: {', '.join(given)} cannot be used with it")
    sensor = None if args.sensor is None else size_of(args.sensor)
    scores: dict[float, ObjectScores] = {}
    skipped: list[str] = []
    unknown: dict[str, int] = {}
    n_moments = 0
    tables = find_tables(args.dataset)
    with progress(len(tables), "recordings") as bar:
        for path, file in tables:
            try:
                table = read_table(file, model.classes)
                found = score_recording(model, path, table, sensor)
            except (ValueError, OSError) as error:
                skipped.append(str(error))
            else:
                n_moments += len(np.unique(table.t))
                scores = {share: one + scores[share] if scores else one for share, one in found.items()}
                unknown = {k: unknown.get(k, 0) + table.unknown.get(k, 0) for k in {*unknown, *table.unknown}}
            bar.update()
    if not scores:
        raise ValueError(f"{args.dataset}: none of {len(tables)} recordings can be evaluated; {skipped[0]}")
    report: dict[str, Any] = {
        **scores[1.0].to_dict(model.classes),
        "f1_against_time_ms": {f"{s * model.config.window_us / 1e3:g}": round(of.f1, 5) for s, of in scores.items()},
        "recordings": len(tables) - len(skipped),
        "moments": n_moments,
        "unknown_classes": unknown,
        "skipped": skipped,
    }
    say(*([json.dumps(report)] if args.json else _lines(report)))
    if unknown:
        of_each = ", ".join(f"{name} ({n})" for name, n in sorted(unknown.items()))
        complain(f"objects of classes that the model does not know do not count: {of_each}")
    for line in skipped:
        complain(f"skipped: {line}")
    return 2 if skipped and args.strict else 0


def score_recording(model: Model, path: Path, table: ObjectTable, sensor: Sensor | None) -> dict[float, ObjectScores]:
    """Of a window that ends at each moment of the table, after each of `SHARES` of it.

    Raises
    ------
    ValueError, OSError : the recording is damaged, or does not state its sensor.
    """
    recording = open_recording(path, sensor=sensor, strict=True)
    if recording.sensor is None:
        raise ValueError(f"{path}: the file does not state its sensor; give it with --sensor WxH")
    model = model.for_sensor(recording.sensor)
    window_us, n_classes = model.config.window_us, len(model.classes)
    processor = Processor(model, start_us=0)
    nothing = np.zeros(n_classes, np.int64)
    scores = dict.fromkeys(SHARES, ObjectScores(nothing, nothing, nothing))
    times_us, rows_of = zip(*table.moments(), strict=True)
    n_events = 0
    for rows, events in zip(rows_of, _windows(recording, times_us, window_us), strict=True):
        processor.reset()
        n_events += len(events)
        begin = 0
        for share in SHARES:
            end = int(np.searchsorted(events["t"], share * window_us))
            processor.push(events[begin:end])
            begin = end
            objects = processor.fire().objects or ()
            found = np.array([(o.x, o.y, o.probability, o.index, o.id) for o in objects], float).reshape(-1, 5)
            scores[share] += score_objects(found, table.label[rows], table.middle[rows], table.reach[rows], n_classes)
    if n_events == 0:
        raise ValueError(
            f"{path}: no event in the {window_us} us before any time in its table, {times_us[0]} to {times_us[-1]}"
        )
    return scores


def _windows(packets: Iterable[np.ndarray], ends_us: Sequence[int], window_us: int) -> Iterator[np.ndarray]:
    """The events of a window before each of these times, sorted, from time 0 on."""
    stream = iter(packets)
    kept: list[np.ndarray] = []
    newest_us = -1
    for end_us in ends_us:
        while newest_us < end_us and (packet := next(stream, None)) is not None:
            kept.append(packet)
            newest_us = max(newest_us, int(packet["t"].max(initial=-1)))
        kept = [packet for packet in kept if packet["t"].max(initial=-1) >= end_us - window_us]
        events = np.concatenate([np.empty(0, EVENT_DTYPE), *kept])
        events = events[(events["t"] >= end_us - window_us) & (events["t"] < end_us)]
        events["t"] -= end_us - window_us
        yield events[np.argsort(events["t"], kind="stable")]


def _lines(report: dict[str, Any]) -> list[str]:
    """The report for people."""
    lines = [
        f"F1 {report['f1']:.4f}: {report['precision']:.4f} of {report['found']} objects found are right, "
        f"{report['recall']:.4f} of {report['objects']} are found, "
        f"at {report['moments']} moments of {report['recordings']} recordings",
        "",
        f"{'class':<24} {'F1':>8} {'objects':>9} {'found':>9} {'right':>9}",
    ]
    for name, row in report["per_class"].items():
        lines.append(f"{name:<24} {row['f1']:>8.3f} {row['objects']:>9} {row['found']:>9} {row['right']:>9}")
    lines += ["", f"{'ms into the window':<24} {'F1':>8}"]
    return lines + [f"{ms:<24} {f1:>8.3f}" for ms, f1 in report["f1_against_time_ms"].items()]
