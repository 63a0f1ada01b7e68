"""Stream a recording through a Processor, and make a record of it for the result file."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from async_tnt.base.messages import short
from async_tnt.base.package import __version__
from async_tnt.evaluation.early import FIELDS as EARLY_FIELDS
from async_tnt.evaluation.early import (
    LEVELS,
    early_fields,
    every_us,
    moments,
)
from async_tnt.evaluation.job import Job, Task, sha256_of
from async_tnt.kernels.volume.records import MAX_TIME_US
from async_tnt.networks.loading import load_model
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.streaming.decision import Decision, in_windows
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.triggers import once_in_its_length
from async_tnt.volume.config import TNTConfig

Record = dict[str, Any]

FIELDS = (
    "recording",
    "class",
    "label",
    "probabilities",
    "window_start_us",
    "window_probabilities",
    *EARLY_FIELDS,
    "decisions",
    "events",
    "late",
    "off_sensor",
    "error",
    "bytes",
    "modified_ns",
    "settings",
)
"""The names of a record's fields. In a record with an `error`, only `recording`, `class` and the
last four have values."""


def evaluate_recording(task: Task) -> Record:
    """Stream one labelled recording, and make a record of its decisions.

    The record has what is decided in each window, early and at the window's end. It also has the
    decided class of the recording: the class with the highest mean probability over all windows. If
    the file cannot be read, the record has an `error` instead.

    Raises
    ------
    ImportError : the file's format needs a library that is not installed.
    ValueError : the model is not the one that the task was made for.
    """
    processor, pixels = processor_of(task.job)
    fields: Record = {
        name: [] for name in ("window_start_us", "window_probabilities", *EARLY_FIELDS)
    }
    n_decisions = 0
    try:
        recording, select = pixels.open(
            task.path,
            name=task.recording,
            strict=True,
            between_us=task.between_us,
            columns=task.job.reading.columns,
            topic=task.job.reading.topic,
            off_sensor="count",
        )
        decisions = _decisions(map(select, recording), processor, pixels)
        # A long recording has many windows, so only what the record needs of a window is kept.
        for start_us, window in in_windows(decisions, processor.config):
            fields["window_start_us"].append(start_us)
            fields["window_probabilities"].append(window[-1].probabilities.tolist())
            for name, value in early_fields(start_us, window, processor.config).items():
                fields[name].append(value)
            n_decisions += len(window)
    except (ValueError, TypeError, OSError, MemoryError) as error:
        return failed_record(task, _error_line(error, task))

    mean = np.mean(fields["window_probabilities"], axis=0)
    assert processor.classes is not None
    fields |= {
        "label": processor.classes[int(mean.argmax())],
        "probabilities": mean.tolist(),
        "decisions": n_decisions,
    }
    counts = {
        "events": processor.counts.received,
        "late": processor.counts.dropped_late,
        "off_sensor": recording.counts.off_sensor,
    }
    return _record(task, fields | counts, None)


def check_record(record: Record, classes: Sequence[str], config: TNTConfig) -> None:
    """Refuse a record that `evaluate_recording` cannot have made with these classes and settings.

    Parameters
    ----------
    record : a record without an error. Its keys are `FIELDS`; its values may be anything.

    Raises
    ------
    ValueError : a field has a wrong value. The error names the field, the rule and the value.
    """
    n_classes = len(classes)
    n_moments = len(moments(config))
    n_levels = len(LEVELS)
    starts_us: Any = record["window_start_us"]
    n_windows = len(starts_us) if isinstance(starts_us, list) else 0
    if n_windows == 0:
        raise ValueError(
            f"`window_start_us` must be a list of one time or more, got {short(starts_us)}"
        )
    for name in ("label", "class"):
        if record[name] not in classes:
            raise ValueError(
                f"`{name}` must be one of the model's classes, got {short(record[name])}"
            )

    for name in ("decisions", "events", "late", "off_sensor"):
        _check_numbers(name, [record[name]], (1,), int, (0, MAX_TIME_US))
    _check_numbers("probabilities", record["probabilities"], (n_classes,), float, (0, 1))
    _check_numbers("window_start_us", starts_us, (n_windows,), int, (0, MAX_TIME_US))

    # field with a row for each window -> the row's length, the type and the limits of its numbers
    tables: dict[str, tuple[int, type, tuple[int, int]]] = {
        "window_probabilities": (n_classes, float, (0, 1)),
        "decided_at": (n_moments, int, (-1, n_classes - 1)),
        "probability_at": (n_moments, float, (-1, 1)),
        "confident": (n_levels, int, (-1, n_classes - 1)),
        "confident_us": (n_levels, int, (-1, MAX_TIME_US)),
    }
    for name, (row_length, number_type, limits) in tables.items():
        _check_numbers(name, record[name], (n_windows, row_length), number_type, limits)


def _check_numbers(
    name: str, values: Any, shape: tuple[int, ...], number_type: type, limits: tuple[int, int]
) -> None:
    """Refuse anything but nested lists of numbers.

    Parameters
    ----------
    name : the field's name, for the error.
    shape : length of the outer list, then of each list in it.
    number_type : int or float; whole numbers pass for float.
    limits : the least and the greatest number that is allowed.
    """
    flat = [values]
    for n in shape:
        if not all(type(inner) is list and len(inner) == n for inner in flat):
            raise ValueError(
                f"`{name}` must hold {' x '.join(map(str, shape))} numbers, got {short(values)}"
            )
        flat = [value for inner in flat for value in inner]
    low, high = limits
    allowed_types = (int, float) if number_type is float else (int,)
    for value in flat:
        if type(value) not in allowed_types or not low <= value <= high:
            raise ValueError(
                f"`{name}` must be numbers of type {number_type.__name__} in [{low}, {high}], got "
                f"{short(value)}"
            )


def failed_record(task: Task, error: str) -> Record:
    """The record of a recording that could not be streamed."""
    return _record(task, {}, error)


def lost_record(task: Task) -> Record:
    """The record of a recording whose worker ended without an answer."""
    return failed_record(
        task,
        f"{task.recording}: its worker ended: killed, out of memory, or crashed by the recording",
    )


def _record(task: Task, fields: Record, error: str | None) -> Record:
    """A record with all of `FIELDS`. Fields that are not given are None."""
    about_file = {"bytes": task.bytes, "modified_ns": task.modified_ns, "settings": task.job.id}
    record = dict.fromkeys(FIELDS) | {"recording": task.recording, "class": task.label}
    return record | fields | {"error": error} | about_file


_cache = threading.local()
"""Its attribute `entry` is what `processor_of` keeps from one recording to the next. Each thread
has an entry of its own, because a Processor has one stream, and a worker of a cluster may have
several threads."""


def processor_of(job: Job) -> tuple[Processor, ModelPixels]:
    """The Processor of a job, and the selector of its pixels.

    A thread uses the same two objects for all recordings of a job. The Processor is reset here. The
    selector is not reset: it goes on counting the events that it leaves out.

    The Processor decides every `early.every_us(config)` microseconds. If that is None, it decides
    at the ends of windows of `window_events`, or once in `last_events` events.

    Raises
    ------
    ValueError : the job was made for another model or another version of this package; or its
        pixels do not fit the model.
    """
    entry: tuple[Job, Processor, ModelPixels] | None = getattr(_cache, "entry", None)
    if entry is None or entry[0] != job:
        entry = (job, *_new_processor(job))
        _cache.entry = entry
    _, processor, pixels = entry
    processor.reset()
    return processor, pixels


def _new_processor(job: Job) -> tuple[Processor, ModelPixels]:
    """A new Processor and a new selector, see `processor_of`."""
    if job.version != __version__:
        raise ValueError(
            f"a worker has async_tnt {__version__}, but this program is {job.version}: install "
            "the same"
        )
    model = load_model(job.model)
    if sha256_of(model) != job.model_sha256:
        raise ValueError(
            f"{job.model}: not the model that the job was made for; it has changed, or a "
            "worker reads another file"
        )
    triggers = once_in_its_length(model.config) | {"every_us": every_us(model.config)}
    processor = Processor(model, **triggers)
    return processor, ModelPixels(job.pixels, model.config.sensor)


def _decisions(
    packets: Iterable[Any], processor: Processor, pixels: ModelPixels
) -> Iterator[Decision]:
    """Yield the decisions about the packets of one recording, as soon as they are made.

    Raises
    ------
    ValueError, TypeError, OSError : the recording is damaged, is of another sensor, or has no
        events. Damage after the part of the file that is read stays unnoticed.
    """
    for packet in packets:
        yield from processor.push(packet)
    yield from processor.finish()
    if not processor.counts.received:
        raise ValueError(pixels.no_events_message)


def _error_line(error: Exception, task: Task) -> str:
    """The error in one line. It names the recording as the results do, not by its path.

    So the line is the same on all machines, wherever the recordings are.
    """
    if isinstance(error, OSError) and error.filename is not None:
        return f"{task.recording}: {error.strerror}"
    text = " ".join(str(error).split()) or type(error).__name__
    text = text.replace(str(task.path), task.recording)
    if task.recording in text:
        return text
    return f"{task.recording}: {text}"
