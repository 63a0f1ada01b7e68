"""A recording's record: what the result file holds of it, one line of JSON or one row of Parquet.

Every record has `FIELDS` and those of its kind. `seconds`, the only thing that no two runs share, stays in the journal
and is no part of the result.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.archive.job import Task, processor_of
from async_tnt.archive.streamed import Outcome, decisions_of, stream_recording, told

FIELDS = ("recording", "error", "bytes", "modified_ns", "settings")
OF_KIND = {
    "evaluate": (
        "class",
        "label",
        "probabilities",
        "window_start_us",
        "window_probabilities",
        "decided_at",
        "decisions",
        "events",
        "late",
    ),
    "run": ("label", "probability", "probabilities", "windows", "events", "late", "decisions"),
}
TIMED = "seconds"

Record = dict[str, Any]


def fields_of(kind: str) -> frozenset[str]:
    """Names that a record of that kind has in the result file."""
    return frozenset(FIELDS + OF_KIND[kind])


def evaluate_recording(task: Task) -> Record:
    """Stream one labelled recording, its class being the folder it lies in.

    Raises
    ------
    ImportError, ValueError : as `stream_recording`.
    """
    outcome = stream_recording(task)
    if outcome.error:
        return failed(task, outcome.error)
    mean = outcome.probabilities.mean(axis=0)
    _, engine, _ = processor_of(task.job)
    return {
        "recording": task.recording,
        "class": task.path.parent.name,
        "label": engine.classes[int(mean.argmax())],
        "probabilities": mean.tolist(),
        "window_start_us": outcome.starts_us,
        "window_probabilities": outcome.probabilities.tolist(),
        "decided_at": outcome.early.tolist(),
        "decisions": outcome.n_decisions,
        "events": outcome.n_events,
        "late": outcome.n_late,
        **_about_file(task, None, outcome.seconds),
    }


def outcome_of(record: Record) -> Outcome:
    """Back from a record to what the report is counted from; its seconds are 0 where they are not known."""
    if record["error"] is not None:
        return Outcome(np.empty((0, 0)), np.empty((0, 0), np.int64), error=record["error"])
    return Outcome(
        np.array(record["window_probabilities"]),
        np.array(record["decided_at"], np.int64),
        record["window_start_us"],
        record["decisions"],
        record["events"],
        record["late"],
        record.get(TIMED) or 0.0,
    )


def run_recording(task: Task) -> Record:
    """All decisions of one recording, as `async-tnt run --json` prints them, and the class of the mean probability.

    Raises
    ------
    ImportError : its format needs a library that is not installed.
    ValueError : the model is not the one that the task was made for.
    """
    processor, engine, pixels = processor_of(task.job)
    try:
        decisions, n_events, seconds = decisions_of(task, processor, pixels)
    except (ValueError, TypeError, OSError, MemoryError) as error:
        return failed(task, told(error, task))
    closed = [d.probabilities for d in decisions if d.complete or d.trigger == "end"]
    mean = np.mean(closed, axis=0)
    best = int(mean.argmax())
    return {
        "recording": task.recording,
        "label": engine.classes[best],
        "probability": round(float(mean[best]), 6),
        "probabilities": [round(float(p), 6) for p in mean],
        "windows": len(closed),
        "events": n_events,
        "late": processor.counts.dropped_late,
        "decisions": [decision.to_dict() for decision in decisions],
        **_about_file(task, None, seconds),
    }


def failed(task: Task, error: str) -> Record:
    """The record of a recording of which there is nothing but the reason."""
    record = dict.fromkeys(OF_KIND[task.job.kind])
    if task.job.kind == "evaluate":
        record["class"] = task.path.parent.name
    return {"recording": task.recording, **record, **_about_file(task, error, None)}


def lost(task: Task) -> Record:
    """The record of a recording that ended two workers."""
    return failed(
        task, f"{task.recording}: its worker ended, twice: killed, out of memory, or crashed by the recording"
    )


def _about_file(task: Task, error: str | None, seconds: float | None) -> Record:
    return {
        "error": error,
        "bytes": task.bytes,
        "modified_ns": task.modified_ns,
        "settings": task.settings,
        TIMED: seconds,
    }
