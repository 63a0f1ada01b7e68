"""async-tnt evaluate for a map model: how many of a recording's objects the model finds."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.cli.output import complain, say
from async_tnt.evaluation.box_conventions import CONVENTIONS
from async_tnt.evaluation.box_scores import FoundBoxes
from async_tnt.evaluation.object_scores import (
    ObjectScores,
    by_milliseconds,
    moments_us,
    score_recording,
)
from async_tnt.evaluation.object_tables import ObjectTable, find_tables, read_table
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import open_recording
from async_tnt.volume.sensor import Sensor, check_sensor

NOT_FOR_OBJECTS = "roi", "crop", "mask", "out", "workers", "dask"
"""Names of the options that cannot be used with a model that finds objects."""


@dataclass
class _Totals:
    """The scores of a data set: sums over the recordings that were read so far.

    Attributes
    ----------
    scores : for each of `moments_us`, the scores; empty before the first recording.
    n_moments : number of times in the tables at which objects count.
    n_left_out : number of objects in the tables that do not count, by --boxes.
    n_off_sensor : number of the other objects in the tables whose middle is off the sensor.
    unknown : class that the model does not know -> number of its objects in the tables.
    skipped : for each recording that cannot be read, the error.
    boxes : for each of `moments_us`, the boxes of the tables and those found until then; empty if
        the model says no sizes.
    """

    scores: dict[int, ObjectScores] = field(default_factory=dict)
    n_moments: int = 0
    n_left_out: int = 0
    n_off_sensor: int = 0
    unknown: Counter[str] = field(default_factory=Counter)
    skipped: list[str] = field(default_factory=list)
    boxes: dict[int, FoundBoxes] = field(default_factory=dict)

    def add(self, scores: dict[int, ObjectScores], table: ObjectTable, sensor: Sensor) -> None:
        """Add the scores of one recording, and the objects of its table that count."""
        for moment, recording_scores in scores.items():
            if moment in self.scores:
                self.scores[moment] += recording_scores
            else:
                self.scores[moment] = recording_scores
        self.n_moments += len(np.unique(table.t))
        is_off = ((table.middle < 0) | (table.middle >= sensor)).any(axis=1)
        self.n_off_sensor += int(is_off.sum())
        self.unknown.update(table.unknown)


def evaluate_objects(args: argparse.Namespace, model: Model) -> int:
    """Score the recordings of `args.dataset` that have tables of objects, and print the report.

    Returns the exit code.
    """
    refused_options = [f"--{name}" for name in NOT_FOR_OBJECTS if getattr(args, name)]
    if refused_options:
        raise ValueError(
            f"{args.model} finds objects: {', '.join(refused_options)} cannot be used with it"
        )
    if model.config.window_events is not None or model.config.last_events is not None:
        raise ValueError(
            f"{args.model}: objects are scored in windows of a duration, not of a number of events"
        )
    if args.boxes != "all" and not model.has_sizes:
        raise ValueError(
            f"--boxes {args.boxes} leaves objects out by their sizes, and {args.model} says none"
        )

    tables = find_tables(args.dataset)
    totals = _Totals()
    if model.has_sizes:
        moments = moments_us(model.config.window_us)
        totals.boxes = {moment: FoundBoxes() for moment in moments}
    with progress(len(tables), "recordings") as bar:
        for path, table in tables:
            try:
                _score(path, table, model, args, totals)
            except (ValueError, OSError) as error:
                totals.skipped.append(str(error))
            bar.update()
    if not totals.scores:
        raise ValueError(
            f"{args.dataset}: none of {len(tables)} recordings can be evaluated; "
            f"{totals.skipped[0]}"
        )

    n_recordings = len(tables) - len(totals.skipped)
    report = {**_report_of(totals, model, n_recordings), "boxes": args.boxes}
    if args.json:
        say(json.dumps(report))
    else:
        say(*_lines(report))
    _complain(args.dataset, totals, report)
    return 2 if totals.skipped and args.strict else 0


def _complain(folder: Path, totals: _Totals, report: dict[str, Any]) -> None:
    """Say what does not count, is left out or cannot be read."""
    if totals.unknown:
        counts = ", ".join(f"{name} ({n})" for name, n in sorted(totals.unknown.items()))
        complain(f"objects of classes that the model does not know do not count: {counts}")
    if not report["objects"]:
        complain(f"{folder}: no object of the tables counts, so the scores say nothing")
    if totals.n_off_sensor:
        complain(
            f"objects whose middle is off the sensor cannot be found: {totals.n_off_sensor}; is "
            "the table in its pixels?"
        )
    for line in totals.skipped:
        complain(f"skipped: {line}")


def _score(
    path: Path, table_file: Path, model: Model, args: argparse.Namespace, totals: _Totals
) -> None:
    """Score one recording, and add its scores to `totals`.

    Raises
    ------
    ValueError, OSError : the recording or its table cannot be read, or its sensor is not known.
    """
    table = read_table(table_file, model.classes)
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
        raise ValueError(f"{path}: the file does not state its sensor; give it with --sensor WxH")
    fitting = model.for_sensor(recording.sensor)
    convention = CONVENTIONS[args.boxes]
    counted = convention.of_table(table)
    scores = score_recording(fitting, recording, counted, totals.boxes or None, convention)
    totals.add(scores, counted, recording.sensor)
    totals.n_left_out += len(table.t) - len(counted.t)


def _report_of(totals: _Totals, model: Model, n_recordings: int) -> dict[str, Any]:
    """The report with all numbers, as --json prints it."""
    f1_of = {moment: round(scores.f1, 5) for moment, scores in totals.scores.items()}
    at_end = totals.scores[model.config.window_us]
    return {
        **at_end.to_dict(model.classes),
        "f1_against_time_ms": by_milliseconds(f1_of),
        **_box_scores(totals, model),
        "recordings": n_recordings,
        "moments": totals.n_moments,
        "left_out": totals.n_left_out,
        "unknown_classes": totals.unknown,
        "off_sensor": totals.n_off_sensor,
        "skipped": totals.skipped,
    }


def _box_scores(totals: _Totals, model: Model) -> dict[str, Any]:
    """COCO's scores, for the report: at the windows' ends, and against time.

    If there are none, the report says why.
    """
    if not totals.boxes:
        return _no_coco("the model says no sizes")
    at_end = model.config.window_us
    if not totals.boxes[at_end].n_present:
        return _no_coco("the tables have no boxes that count")
    try:
        scores_of = {moment: boxes.scores(model.classes) for moment, boxes in totals.boxes.items()}
    except ImportError as error:
        return _no_coco(str(error))
    return {"coco": scores_of[at_end], "coco_against_time_ms": by_milliseconds(scores_of)}


def _no_coco(reason: str) -> dict[str, Any]:
    """What the report says if there are no COCO scores."""
    return {"coco": None, "coco_against_time_ms": None, "no_coco": reason}


def _lines(report: dict[str, Any]) -> list[str]:
    """The report as lines of text."""
    lines = [
        f"F1 {report['f1']:.4f}: {report['precision']:.4f} of {report['found']} objects found are "
        f"right, {report['recall']:.4f} of {report['objects']} are found, "
        f"at {report['moments']} moments of {report['recordings']} recordings",
    ]
    if report["boxes"] != "all":
        lines.append(
            f"--boxes {report['boxes']}: {report['left_out']} objects of the tables do not count"
        )
    lines += [
        "",
        f"{'class':<24} {'F1':>8} {'objects':>9} {'found':>9} {'right':>9}",
    ]
    for name, row in report["per_class"].items():
        lines.append(
            f"{name:<24} {row['f1']:>8.3f} {row['objects']:>9} {row['found']:>9} {row['right']:>9}"
        )
    lines += ["", f"{'ms into the window':<24} {'F1':>8}"]
    lines += [f"{ms:<24} {f1:>8.3f}" for ms, f1 in report["f1_against_time_ms"].items()]
    if report["coco"] is None:
        return [*lines, "", f"no scores of boxes: {report['no_coco']}"]
    heads = ("mAP", "mAP .5", "mAP .75", "small", "medium", "large")
    lines += ["", f"{'ms into the window':<24} " + " ".join(f"{head:>8}" for head in heads)]
    for ms, scores in report["coco_against_time_ms"].items():
        cells = ["-" if score is None else f"{score:.3f}" for score in scores.values()]
        lines.append(f"{ms:<24} " + " ".join(f"{cell:>8}" for cell in cells))
    return lines
