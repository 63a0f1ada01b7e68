"""async-tnt evaluate: how well a model classifies the recordings of a folder, streamed."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from async_tnt.base.files import check_writable, user_path
from async_tnt.base.progress import progress
from async_tnt.cli.evaluate_objects import evaluate_objects
from async_tnt.cli.options import MODELS, add_reading, model_of, positive_int
from async_tnt.cli.output import complain, complain_late, say
from async_tnt.cli.pixel_options import add_pixels, model_pixels_of, pixels_of
from async_tnt.evaluation.early import early_report
from async_tnt.evaluation.job import Task, job_of, task_of
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.evaluation.records import Record, check_record, evaluate_recording
from async_tnt.evaluation.results import SUFFIXES, Run, collect
from async_tnt.evaluation.scores import score_recordings
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.labelled_recordings import LabelledRecording, find_recordings
from async_tnt.sources.files.source import ReadOptions
from async_tnt.streaming.compile_ahead import fill_cache

SHOWN = 200  # letters of the classes that an error names

DESCRIPTION = """Stream every recording of a folder of class folders through a model, and count how often it is right.

DATASET holds <class name>/<recordings>, or Test/<class name>/<recordings>; the names are the model's classes. Or it
holds sessions, each with a table NAME_labels.csv of class, start and end, which are evaluated part by part. Use
recordings that the model was not trained on, if possible of other days and people. Windows follow each other from each
recording's first event, as on a live stream. A recording's class is the one with the highest mean probability over its
windows. Recordings that cannot be read, and empty ones, are skipped and named at the end.

Of a model that finds objects, DATASET holds recordings with tables of objects, NAME_objects.csv (t, class, x, y, or
boxes x, y, w, h) or Prophesee's NAME_bbox.npy. For each time in the table it decides at the end of the window before
it, and earlier; an object is found by its class in the ellipse that touches its box's sides, or within 5 pixels of a
point.

  async-tnt evaluate gestures.safetensors held_out
  async-tnt evaluate digits N-MNIST --workers 4 --json | jq .accuracy
  async-tnt evaluate digits N-MNIST --workers 4 --out results.jsonl    keep each recording's result; resumable
  async-tnt evaluate digits N-MNIST --dask tcp://10.0.0.1:8786 --out results.jsonl    on many machines
  async-tnt evaluate digits recorded --roi 600,300,34,34 --crop --mask mask.npy    of a larger camera with hot pixels

With --out, an evaluation that was interrupted or killed resumes when the same command is given again, and ends with
the same file and the same numbers (docs/guide.md).

Exit code 0, also if recordings were skipped (2 with --strict); 2 for bad usage, or if none could be read.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help=MODELS)
    parser.add_argument(
        "dataset", type=user_path, metavar="DATASET", help="folder with <class name>/<recordings>"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object with all numbers")
    add_pixels(parser)
    add_reading(parser, single=False)
    parser.add_argument(
        "--out",
        type=user_path,
        metavar="FILE",
        help="keep the results in this file, .jsonl, a record per recording; after an interruption or a kill the same "
        "command resumes",
    )
    parser.add_argument(
        "--workers",
        type=positive_int,
        metavar="N",
        help="processes that stream recordings (default: 1)",
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="stream on the workers of a Dask cluster with its scheduler at this address (extra `cluster`)",
    )
    parser.add_argument(
        "--restart",
        action="store_true",
        help="with --out: discard the results of an earlier run and start over",
    )
    parser.add_argument(
        "--strict", action="store_true", help="exit code 2 if any recording was skipped"
    )


def main(args: argparse.Namespace) -> int:
    run = _how_to_run(args)
    model = model_of(args.model)
    if model.places is not None:
        return evaluate_objects(args, model)
    pixels = pixels_of(args)
    model_pixels_of(pixels, model)  # refuses pixels that do not fit the model
    found = labelled_recordings(args.dataset, model)
    fill_cache()
    job = job_of(args.model, model, pixels, ReadOptions(columns=args.columns, topic=args.topic))
    tasks = [
        task_of(
            one.name_as(one.path.relative_to(args.dataset).as_posix()),
            one.path,
            job,
            name,
            one.between_us,
        )
        for name, recordings in found.items()
        for one in recordings
    ]
    check = functools.partial(check_record, classes=model.classes, config=model.config)
    records = _stream(args, tasks, run, check)
    good = [record for record in records if record["error"] is None]
    skipped = [record["error"] for record in records if record["error"] is not None]
    if not good:
        raise ValueError(
            f"{args.dataset}: none of {len(tasks)} recordings can be evaluated; {skipped[0]}"
        )
    report = report_of(model, good, skipped)
    if pixels.about:
        report["pixels"] = pixels.about
    say(*([json.dumps(report)] if args.json else lines_of(report)))
    where = f"`late` in {args.out}" if args.out else "`late` in the records of --out"
    complain_late(str(args.dataset), report["late"], report["events"], where)
    if report["off_sensor"]:
        complain(
            f"{args.dataset}: {report['off_sensor']:,} events lie off the sensor and were left out"
        )
    for line in skipped:
        complain(f"skipped: {line}")
    return 2 if skipped and args.strict else 0


def _how_to_run(args: argparse.Namespace) -> Run:
    """Where to stream; checks, before any work, that the options agree and that --out can be
    written.

    Raises
    ------
    ValueError, OSError.
    """
    if args.workers is not None and args.dask is not None:
        raise ValueError("--workers are processes here and --dask is a cluster: give one of them")
    if args.restart and args.out is None:
        raise ValueError("--restart requires --out: it discards the results in that file")
    if args.out is not None:
        check_writable(args.out, SUFFIXES)
    if args.dask is None:
        return functools.partial(run_all, workers=args.workers or 1)
    return functools.partial(run_on_dask, address=args.dask)


def _stream(
    args: argparse.Namespace, tasks: Sequence[Task], run: Run, check: Callable[[Record], object]
) -> list[Record]:
    """All records in order of the recordings' names, with a progress bar; written to the file of
    --out, if given.

    Raises
    ------
    KeyboardInterrupt : with what is done by then. Others : as `collect`.
    """
    try:
        with contextlib.ExitStack() as stack:
            out = args.out or Path(
                stack.enter_context(tempfile.TemporaryDirectory()), "results.jsonl"
            )
            return collect(
                evaluate_recording,
                tasks,
                run,
                out,
                restart=args.restart,
                check=check,
                progress=progress,
                report=complain,
            )
    except KeyboardInterrupt as error:
        n_done = f": {error}" if str(error) else ""
        resumes = f"the same command{' without --restart' * args.restart} resumes"
        kept = resumes if args.out else "nothing is kept without --out"
        raise KeyboardInterrupt(f"interrupted{n_done}; {kept}") from None


def labelled_recordings(folder: Path, model: Model) -> dict[str, list[LabelledRecording]]:
    """The recordings of a folder, by their classes.

    Raises
    ------
    ValueError : a class folder that the model does not know, or no recordings.
    OSError : no such folder.
    """
    found = find_recordings(folder, "Test")
    if unknown := [name for name in found if name not in model.classes]:
        theirs, ours = (shorten(", ".join(names), SHOWN) for names in (unknown, model.classes))
        raise ValueError(f"{folder}: the model does not know class {theirs}; it knows {ours}")
    if not any(found.values()):
        raise ValueError(f"{folder}: no recordings in its class folders ({', '.join(found)})")
    return found


def report_of(model: Model, records: list[Record], skipped: list[str]) -> dict[str, Any]:
    """All numbers, as `--json` prints them."""
    labels = [model.classes.index(record["class"]) for record in records]
    probabilities = [np.array(record["window_probabilities"]) for record in records]
    return {
        **score_recordings(model.classes, labels, probabilities),
        **early_report(records, labels, model.config),
        "decisions": sum(record["decisions"] for record in records),
        "events": sum(record["events"] for record in records),
        "late": sum(record["late"] for record in records),
        "off_sensor": sum(record["off_sensor"] for record in records),
        "skipped": skipped,
    }


def lines_of(report: dict[str, Any]) -> list[str]:
    """The report for people."""
    lines = [
        f"accuracy {report['accuracy']:.4f} on {report['recordings']} recordings, "
        f"{report['window_accuracy']:.4f} on {report['windows']} windows",
        "",
        f"{'class':<24} {'accuracy':>8} {'recordings':>11} {'windows right':>15}  confused with",
    ]
    for k, name in enumerate(report["classes"]):
        row = report["confusion"][k]
        share = "-" if report["per_class"][name] is None else f"{report['per_class'][name]:.3f}"
        others = sorted(((n, j) for j, n in enumerate(row) if n and j != k), reverse=True)[:3]
        confused = ", ".join(f"{report['classes'][j]} ({n})" for n, j in others)
        windows = report["window_confusion"][k]
        right = f"{windows[k]:,} of {sum(windows):,}"
        lines.append(f"{name:<24} {share:>8} {sum(row):>11} {right:>15}  {confused}".rstrip())
    if report["accuracy_against_time"]:
        lines += ["", f"{'ms into the window':<24} {'accuracy':>8} {'decided':>11}"]
    for moment in report["accuracy_against_time"]:
        lines.append(
            f"{moment['time_us'] / 1e3:<24g} {moment['accuracy']:>8.3f} {moment['decided']:>11.3f}"
        )
    if report["confidence"]:
        head = f"{'first decision at':<24} {'accuracy':>8} {'decided':>11} {'all windows':>12}"
        lines += ["", f"{head}  ms: median, 90 %"]
    for level in report["confidence"]:
        right, ms = "-", ""
        if level["accuracy"] is not None:
            right, ms = (
                f"{level['accuracy']:.3f}",
                f"{level['median_ms']:.1f}, {level['p90_ms']:.1f}",
            )
        shares = f"{right:>8} {level['decided']:>11.3f} {level['window_accuracy']:>12.3f}"
        lines.append(f"{level['level']:<24} {shares}  {ms}".rstrip())
    if report["calibration_error"] is not None:
        lines += ["", f"expected calibration error {report['calibration_error']:.3f}"]
    return lines
