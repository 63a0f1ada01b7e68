"""async-tnt evaluate: stream the recordings of a folder, and report how often a model is right."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from async_tnt.base.files import check_writable, user_path
from async_tnt.base.progress import progress
from async_tnt.cli.evaluate_objects import evaluate_objects
from async_tnt.cli.options import MODELS_TEXT, add_reading, model_of, positive_int
from async_tnt.cli.output import complain, complain_late, say
from async_tnt.cli.pixel_options import add_pixels, model_pixels_of, pixels_of
from async_tnt.evaluation.box_conventions import CONVENTIONS
from async_tnt.evaluation.early import early_report
from async_tnt.evaluation.job import Job, Task, job_of, task_of
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.evaluation.records import Record, check_record, evaluate_recording
from async_tnt.evaluation.results import SUFFIXES, Run, collect
from async_tnt.evaluation.scores import score_recordings
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.labelled_recordings import LabelledRecording, find_recordings
from async_tnt.sources.files.source import ReadOptions
from async_tnt.streaming.compile_ahead import must_compile, warmup
from async_tnt.volume.event_forms import check_order

MOST_LETTERS = 200
"""Number of letters of class names that an error shows, at most."""

REMOVED = {"--restart": "delete the file of --out to start over"}

DESCRIPTION = """\
Stream every recording of a data set through a model, and report how often it is right.

DATASET is a folder of <class name>/<recordings>, or of Test/<class name>/<recordings>.
The class names are those of the model. Instead, it may hold recordings of several
classes, each with a table NAME_labels.csv of class, start and end: each part is then
evaluated by itself. Use recordings that the model was not trained on, if possible of
other days and people.

Windows follow each other from the first event of each recording, as on a live stream.
The class of a recording is the one with the highest mean probability over its windows.
Recordings that cannot be read, and empty ones, are skipped and named at the end.

A model that finds objects needs recordings with a table of objects: NAME_objects.csv
(t, class, x, y, or boxes x, y, w, h), Prophesee's NAME_bbox.npy, or sequences of
DSEC-Detection with their object_detections/left/tracks.npy. For each time in the
table, the model sees the window that ends there. An object of the table is found if the
model sees its class within 5 pixels of its point, or within the ellipse that touches
the sides of its box. If the model says sizes, and with the extra `boxes`, the report
also has COCO's mean average precision (mAP): the mean over overlaps of .5 to .95, at .5,
at .75, and by the boxes' areas. Scores are given after 10, 30, 50 and 100 ms of windows
that are longer, and at their ends. --boxes says which boxes count in all of them:

  all    every box and point, at every time of the tables
  gen1   those after the first half second, with sides of at least 10 pixels and a
         diagonal of at least 30; times of the tables without such a box do not count
  1mpx   likewise, with sides of at least 20 pixels and a diagonal of at least 60

  async-tnt evaluate gestures.safetensors held_out
  async-tnt evaluate digits N-MNIST --workers 4 --json | jq .accuracy
  async-tnt evaluate finder.safetensors gen1/test --boxes gen1

Keep the result of each recording in a file:

  async-tnt evaluate digits N-MNIST --workers 4 --out results.jsonl

An evaluation that was interrupted or killed resumes when the same command is given
again. It ends with the same file and the same numbers.

On many machines:

  async-tnt evaluate digits N-MNIST --dask tcp://10.0.0.1:8786 --out results.jsonl

A part of a larger camera that has hot pixels:

  async-tnt evaluate digits recorded --roi 600,300,34,34 --crop --mask mask.npy

Exit code 0, also if recordings were skipped (2 with --strict). Exit code 2 for bad
usage, or if no recording could be read.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("model", metavar="MODEL", help=MODELS_TEXT)
    parser.add_argument(
        "dataset",
        type=user_path,
        metavar="DATASET",
        help="folder with <class name>/<recordings>, or with recordings and tables of objects",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object with all numbers")
    add_pixels(parser)
    add_reading(parser, single=False)
    parser.add_argument(
        "--out",
        type=user_path,
        metavar="FILE",
        help="keep the results in this file, .jsonl, a record for each recording; the same command "
        "resumes after an interruption",
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
        help="stream on the workers of a Dask cluster with its scheduler at this address (extra "
        "`cluster`)",
    )
    parser.add_argument(
        "--boxes",
        choices=tuple(CONVENTIONS),
        default="all",
        help="boxes that count, if the model says sizes of objects: all, or those that the "
        "evaluators of Gen1 or 1Mpx count, see above (default: all)",
    )
    parser.add_argument(
        "--strict", action="store_true", help="exit code 2 if any recording was skipped"
    )


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt evaluate`. Returns the exit code."""
    run = _run_function(args)
    # Checked before any recording is read, because later the error would count as a fault of each
    # recording.
    if args.columns is not None:
        check_order("columns", args.columns)
    model = model_of(args.model)
    if model.outputs:
        raise ValueError(
            f"{args.model} has raw outputs, and evaluate scores classes and objects: "
            "async_tnt.stream yields its outputs for scores of your own"
        )
    if model.places is not None:
        return evaluate_objects(args, model)
    if args.boxes != "all":
        raise ValueError(f"--boxes {args.boxes} is for objects, and {args.model} finds none")

    pixels = model_pixels_of(pixels_of(args), model)
    recordings_of_class = labelled_recordings(args.dataset, model)
    if must_compile():
        warmup(model)  # the workers then load what this process has compiled
    reading = ReadOptions(columns=args.columns, topic=args.topic)
    job = job_of(args.model, model, pixels.pixels, reading)
    tasks = _tasks_of(recordings_of_class, args.dataset, job)
    check = functools.partial(check_record, classes=model.classes, config=model.config)
    records = _stream(args, tasks, run, check)

    good_records = [record for record in records if record["error"] is None]
    errors = [record["error"] for record in records if record["error"] is not None]
    if not good_records:
        raise ValueError(
            f"{args.dataset}: none of {len(tasks)} recordings can be evaluated; {errors[0]}"
        )
    report = report_of(model, good_records, errors)
    if pixels.pixels.about:
        report["pixels"] = pixels.pixels.about
    if args.json:
        say(json.dumps(report))
    else:
        say(*lines_of(report))

    place = f"`late` in {args.out}" if args.out else "`late` in the records of --out"
    complain_late(str(args.dataset), report["late"], report["events"], place)
    if report["off_sensor"]:
        complain(
            f"{args.dataset}: {report['off_sensor']:,} events lie off the sensor and were left out"
        )
    for line in errors:
        complain(f"skipped: {line}")
    return 2 if errors and args.strict else 0


def _run_function(args: argparse.Namespace) -> Run:
    """The function that streams the recordings: in processes here, or on a Dask cluster.

    Raises
    ------
    ValueError, OSError : the options do not agree, or the file of --out cannot be written.
    """
    if args.workers is not None and args.dask is not None:
        raise ValueError("--workers are processes here and --dask is a cluster: give one of them")
    if args.out is not None:
        check_writable(args.out, SUFFIXES)
    if args.dask is None:
        return functools.partial(run_all, workers=args.workers or 1)
    return functools.partial(run_on_dask, address=args.dask)


def _tasks_of(
    recordings_of_class: Mapping[str, Sequence[LabelledRecording]], folder: Path, job: Job
) -> list[Task]:
    """A task for each recording, named by the recording's path relative to `folder`."""
    tasks = []
    for label, recordings in recordings_of_class.items():
        for recording in recordings:
            name = recording.name_as(recording.path.relative_to(folder).as_posix())
            tasks.append(task_of(name, recording.path, job, label, recording.between_us))
    return tasks


def _stream(
    args: argparse.Namespace, tasks: Sequence[Task], run: Run, check: Callable[[Record], object]
) -> list[Record]:
    """Stream the recordings, and show a progress bar.

    Returns the records in order of the recordings' names. With --out, they are also kept in that
    file.

    Raises
    ------
    KeyboardInterrupt : Ctrl-C. The error says how many recordings are done.
    ValueError, OSError : see `collect`.
    """
    try:
        with contextlib.ExitStack() as stack:
            out = args.out
            if out is None:
                folder = stack.enter_context(tempfile.TemporaryDirectory())
                out = Path(folder, "results.jsonl")
            return collect(
                evaluate_recording,
                tasks,
                run,
                out,
                check=check,
                progress=progress,
                report=complain,
            )
    except KeyboardInterrupt as error:
        progress_text = f": {error}" if str(error) else ""
        advice = "the same command resumes" if args.out else "nothing is kept without --out"
        raise KeyboardInterrupt(f"interrupted{progress_text}; {advice}") from None


def labelled_recordings(folder: Path, model: Model) -> dict[str, list[LabelledRecording]]:
    """Name of a class -> the recordings of this class in a folder.

    Raises
    ------
    ValueError : the folder has a class that the model does not know, or has no recordings.
    OSError : the folder does not exist.
    """
    recordings_of_class = find_recordings(folder, "Test")
    unknown_classes = [name for name in recordings_of_class if name not in model.classes]
    if unknown_classes:
        unknown_names = shorten(", ".join(unknown_classes), MOST_LETTERS)
        known_names = shorten(", ".join(model.classes), MOST_LETTERS)
        raise ValueError(
            f"{folder}: the model does not know class {unknown_names}; it knows {known_names}"
        )
    if not any(recordings_of_class.values()):
        raise ValueError(
            f"{folder}: no recordings in its class folders ({', '.join(recordings_of_class)})"
        )
    return recordings_of_class


def report_of(model: Model, records: list[Record], skipped: list[str]) -> dict[str, Any]:
    """The report with all numbers, as `--json` prints it.

    Parameters
    ----------
    records : the records without an error.
    skipped : the error of each recording that cannot be evaluated.
    """
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
    """The report as lines of text."""
    lines = [
        f"accuracy {report['accuracy']:.4f} on {report['recordings']} recordings, "
        f"{report['window_accuracy']:.4f} on {report['windows']} windows",
        "",
        f"{'class':<24} {'accuracy':>8} {'recordings':>11} {'windows right':>15}  confused with",
    ]
    lines += [_class_line(report, k) for k in range(len(report["classes"]))]

    if report["accuracy_against_time"]:
        lines += ["", f"{'ms into the window':<24} {'accuracy':>8} {'decided':>11}"]
    for moment in report["accuracy_against_time"]:
        lines.append(
            f"{moment['time_us'] / 1e3:<24g} {moment['accuracy']:>8.3f} {moment['decided']:>11.3f}"
        )

    if report["confidence"]:
        head = f"{'first decision at':<24} {'accuracy':>8} {'decided':>11} {'all windows':>12}"
        lines += ["", f"{head}  ms: median, 90 %"]
    lines += [_level_line(level) for level in report["confidence"]]

    if report["calibration_error"] is not None:
        lines += ["", f"expected calibration error {report['calibration_error']:.3f}"]
    return lines


def _class_line(report: dict[str, Any], k: int) -> str:
    """A line of text: how often class k is decided right, and which classes are decided instead."""
    classes = report["classes"]
    name = classes[k]
    row = report["confusion"][k]
    accuracy = report["per_class"][name]
    accuracy_text = "-" if accuracy is None else f"{accuracy:.3f}"
    windows = report["window_confusion"][k]
    windows_text = f"{windows[k]:,} of {sum(windows):,}"
    confusions = [(n, j) for j, n in enumerate(row) if n and j != k]
    most_frequent = sorted(confusions, reverse=True)[:3]
    confused_with = ", ".join(f"{classes[j]} ({n})" for n, j in most_frequent)
    columns = f"{accuracy_text:>8} {sum(row):>11} {windows_text:>15}"
    return f"{name:<24} {columns}  {confused_with}".rstrip()


def _level_line(level: dict[str, Any]) -> str:
    """A line of text about a level of confidence.

    Its columns are the fields of `early_report`: `accuracy`, `decided` and `window_accuracy`, then
    `median_ms` and `p90_ms`.
    """
    accuracy_text = "-"
    times_text = ""
    if level["accuracy"] is not None:
        accuracy_text = f"{level['accuracy']:.3f}"
        times_text = f"{level['median_ms']:.1f}, {level['p90_ms']:.1f}"
    shares = f"{accuracy_text:>8} {level['decided']:>11.3f} {level['window_accuracy']:>12.3f}"
    return f"{level['level']:<24} {shares}  {times_text}".rstrip()
