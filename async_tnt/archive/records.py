"""Stream a recording of an archive through a Processor, and make a record of it for the result file.

`seconds`, which no two runs share, is in the record but not in the file.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.archive.early import COLUMNS as EARLY
from async_tnt.archive.early import FiringProcessor, early_fields
from async_tnt.archive.job import Job, Task, sha256_of
from async_tnt.decision import Decision
from async_tnt.engines import Engine, choose_engine
from async_tnt.networks.model import UncheckedModelWarning
from async_tnt.processor import Processor
from async_tnt.sources.pixel_selector import PixelSelector
from async_tnt.version import __version__

Record = dict[str, Any]

_DECISION = {
    "time_us": "int64",
    "window_start_us": "int64",
    "label": "string",
    "probability": "double",
    "probabilities": ["double"],
    "events": "int64",
    "complete": "bool",
    "trigger": "string",
}
_COLUMNS: dict[str, dict[str, Any]] = {
    "evaluate": {
        "class": "string",
        "label": "string",
        "probabilities": ["double"],
        "window_start_us": ["int64"],
        "window_probabilities": [["double"]],
        **EARLY,
        "decisions": "int64",
        "events": "int64",
        "late": "int64",
    },
    "run": {
        "label": "string",
        "probability": "double",
        "probabilities": ["double"],
        "windows": "int64",
        "events": "int64",
        "late": "int64",
        "decisions": [_DECISION],
    },
}
_OF_FILE = {"error": "string", "bytes": "int64", "modified_ns": "int64", "settings": "string"}
COLUMNS = {kind: {"recording": "string", **columns, **_OF_FILE} for kind, columns in _COLUMNS.items()}
"""Field -> type, for each kind of job: Arrow's name of it, [the type of a list's items], or {the fields of a struct}.

With an `error`, only `recording`, `class` and the last four have values.
"""
TIMED = "seconds"


def run_recording(task: Task) -> Record:
    """All decisions of one recording, as `async-tnt run --json` prints them, and the class of the mean probability.

    Whatever is wrong with the file becomes the record's `error`.

    Raises
    ------
    ImportError : its format needs a library that is not installed.
    ValueError : the model is not the one that the task was made for.
    """

    def fields_of(decisions: list[Decision], engine: Engine) -> Record:
        closed = [d.probabilities for d in decisions if d.complete or d.trigger == "end"]
        mean = np.mean(closed, axis=0)
        best = int(mean.argmax())
        return {
            "label": engine.classes[best],
            "probability": round(float(mean[best]), 6),
            "probabilities": [round(float(p), 6) for p in mean],
            "windows": len(closed),
            "decisions": [decision.to_dict() for decision in decisions],
        }

    return _stream(task, fields_of)


def evaluate_recording(task: Task) -> Record:
    """What is decided in each window of one labelled recording, early and at its end.

    The job's Processor must decide as often as `early.every_us` says. It is also fired after the numbers of events that
    `early` lists. Errors are those of `run_recording`.
    """

    def fields_of(decisions: list[Decision], engine: Engine) -> Record:
        windows: list[list[Decision]] = [[]]
        for decision in decisions:
            windows[-1].append(decision)
            if decision.trigger in ("window", "end"):
                windows.append([])
        del windows[-1]  # after the last window
        probabilities = np.array([window[-1].probabilities for window in windows])  # (W, K), of whole windows
        mean = probabilities.mean(axis=0)
        return {
            "label": engine.classes[int(mean.argmax())],
            "probabilities": mean.tolist(),
            "window_start_us": [window[0].window_start_us for window in windows],
            "window_probabilities": probabilities.tolist(),
            **early_fields(windows, engine.config),
            "decisions": len(decisions),
        }

    return _stream(task, fields_of)


def failed(task: Task, error: str) -> Record:
    """The record of a recording that could not be streamed."""
    return _record(task, {}, error, None)


def lost(task: Task) -> Record:
    """The record of a recording that ended two workers."""
    return failed(
        task, f"{task.recording}: its worker ended, twice: killed, out of memory, or crashed by the recording"
    )


def _stream(task: Task, fields_of: Callable[[list[Decision], Engine], Record]) -> Record:
    processor, engine, pixels = processor_of(task.job)
    try:
        stream = FiringProcessor(processor) if task.job.kind == "evaluate" else processor
        decisions, n_events, seconds = decisions_of(task, stream, pixels)
    except (ValueError, TypeError, OSError, MemoryError) as error:
        return failed(task, _error_line(error, task))
    counts = {"events": n_events, "late": processor.counts.dropped_late}
    return _record(task, fields_of(decisions, engine) | counts, None, seconds)


def _record(task: Task, fields: Record, error: str | None, seconds: float | None) -> Record:
    record = dict.fromkeys(COLUMNS[task.job.kind]) | {"recording": task.recording, **fields, "error": error}
    if task.job.kind == "evaluate":
        record["class"] = task.label
    about_file = {"bytes": task.bytes, "modified_ns": task.modified_ns, "settings": task.settings}
    return {**record, **about_file, TIMED: seconds}


_kept = threading.local()  # a Processor has one stream; workers of a cluster may have several threads


def processor_of(job: Job) -> tuple[Processor, Engine, PixelSelector]:
    """The compiled Processor of a job, reset, and its selector of pixels: the same for all recordings of a thread.

    The selector is not reset: its counts go on.

    Raises
    ------
    ValueError : the model or this package are not those that the job was made for, or its pixels do not fit the model.
    """
    kept: tuple[Job, Processor, Engine, PixelSelector] | None = getattr(_kept, "of_job", None)
    if kept is None or kept[0] != job:
        if job.version != __version__:
            raise ValueError(
                f"a worker has async_tnt {__version__}, but this program is {job.version}: install the same"
            )
        with warnings.catch_warnings():  # the program has shown it when it made the job; each worker would repeat it
            warnings.simplefilter("ignore", UncheckedModelWarning)
            engine = choose_engine(job.model, job.engine)
        if sha256_of(engine, job.model) != job.model_sha256:
            raise ValueError(
                f"{job.model}: not the model that the job was made for; it has changed, or a worker reads another file"
            )
        processor = engine.processor(**job.settings)
        processor.fire()  # of the empty window: changes nothing, but an engine's first call takes longer
        kept = _kept.of_job = job, processor, engine, PixelSelector(job.pixels, engine.config.sensor)
    _, processor, engine, pixels = kept
    processor.reset()
    return processor, engine, pixels


def decisions_of(
    task: Task, processor: Processor | FiringProcessor, pixels: PixelSelector
) -> tuple[list[Decision], int, float]:
    """All decisions of one recording, the number of its selected events, and the seconds without reading the file.

    Raises
    ------
    ValueError, TypeError, OSError : the recording is damaged, anywhere, or in a part's case before its end; of another
        sensor; or without events.
    """
    before = pixels.counts
    recording, sensor = pixels.open(task.path, name=task.recording, strict=True, between_us=task.between_us)
    select = pixels.filter_of(task.recording, sensor)
    decisions: list[Decision] = []
    seconds = 0.0
    n_events = 0
    for packet in recording:
        started = time.perf_counter()
        try:
            selected = select(packet)
            decisions += processor.push(selected)
        except (TypeError, ValueError):
            if recording.stated_sensor is None:  # an event outside a sensor that an option or the model gives: name it
                pixels.check_events([packet], task.recording, sensor)
            raise
        n_events += len(selected)
        seconds += time.perf_counter() - started
    started = time.perf_counter()
    decisions += processor.finish()
    seconds += time.perf_counter() - started
    if not decisions:
        if n_events:
            raise ValueError("no event in any window, nothing to decide")
        raise ValueError(pixels.nothing_left(before) or "no events")
    return decisions, n_events, seconds


def _error_line(error: Exception, task: Task) -> str:
    """The error in one line that contains the recording's name in the results."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{task.recording}: {error.strerror}"
    text = " ".join(str(error).split()) or type(error).__name__
    text = text.replace(str(task.path), task.recording)  # the same text wherever the archive lies
    return text if task.recording in text else f"{task.recording}: {text}"
