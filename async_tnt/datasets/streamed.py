"""Labelled recordings streamed through a Processor, as a camera's events would be, one recording after the other."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..decision import Decision
from ..model import Model, load_model
from ..processor import Processor
from ..recordings import open_recording
from ..warmup import warmup
from .class_folders import name_of

N_MOMENTS = 10


@dataclass(frozen=True)
class Task:
    """One recording to stream: picklable, so that a worker process can take it."""

    index: int
    path: Path
    model: str
    """What `load_model` takes."""


@dataclass(frozen=True)
class Outcome:
    """What a model says of one recording with W windows.

    Parameters
    ----------
    index : the task's.
    probabilities : float64, shape (W, K), of each window at its end.
    early : int64, shape (W, N_MOMENTS): the class decided at each of `moments`; -1 where no event had come by then.
    n_decisions, n_events : how many fell, and came.
    seconds : streaming took, without reading the file.
    error : why there is nothing of it; "" where there is.
    """

    index: int
    probabilities: np.ndarray
    early: np.ndarray
    n_decisions: int = 0
    n_events: int = 0
    seconds: float = 0.0
    error: str = ""


def moments(window_us: int) -> list[int]:
    """Microseconds since a window's start at which it is asked what it shows so far: its tenths, and its end.

    Examples
    --------
    >>> moments(105_000)[:3], moments(105_000)[-1]
    ([10500, 21000, 31500], 105000)
    """
    every_us = max(1, window_us // N_MOMENTS)
    return [*(every_us * k for k in range(1, N_MOMENTS)), window_us]


def stream_recording(task: Task) -> Outcome:
    """Stream one recording: windows from its first event, and a decision at each of `moments` too.

    Whatever is wrong with the file becomes the outcome's `error`.

    Raises
    ------
    ImportError : its format needs a library that is not installed.
    """
    processor, model = _processor(task.model)
    processor.reset()
    none = np.empty((0, len(model.classes))), np.empty((0, N_MOMENTS), np.int64)
    try:
        recording = open_recording(task.path, strict=True)
        if recording.sensor is not None and tuple(recording.sensor) != model.config.sensor:
            raise ValueError(
                f"a sensor of {recording.sensor[0]}x{recording.sensor[1]} pixels, but the model is for "
                f"{model.config.sensor[0]}x{model.config.sensor[1]}"
            )
        decisions: list[Decision] = []
        seconds = 0.0
        n_events = 0
        for packet in recording:
            n_events += len(packet)
            started = time.perf_counter()
            decisions += processor.push(packet)
            seconds += time.perf_counter() - started
        started = time.perf_counter()
        decisions += processor.finish()
        seconds += time.perf_counter() - started
    except (ValueError, TypeError, OSError) as error:
        return Outcome(task.index, *none, error=_told(error, task.path))
    if not decisions:
        return Outcome(task.index, *none, error=f"{name_of(task.path)}: no events")
    windows = by_window(decisions)
    probabilities = np.array([window[-1].probabilities for window in windows])
    early = np.array([decided_at(window, moments(model.config.window_us)) for window in windows])
    return Outcome(task.index, probabilities, early, len(decisions), n_events, seconds)


def by_window(decisions: Sequence[Decision]) -> list[list[Decision]]:
    """Decisions of each window, in order; the last one of each is of the whole window."""
    windows: dict[int, list[Decision]] = {}
    for decision in decisions:
        windows.setdefault(decision.window_start_us, []).append(decision)
    return list(windows.values())


def decided_at(window: Sequence[Decision], after_us: Sequence[int]) -> list[int]:
    """The class decided at each moment: the one of the newest decision whose events had all come by then.

    A moment without a decision of its own saw no new events since the one before, so that one still stands.
    """
    start_us = window[0].window_start_us
    return [next((d.index for d in reversed(window) if d.time_us - start_us < moment), -1) for moment in after_us]


@lru_cache(maxsize=1)
def _processor(name: str) -> tuple[Processor, Model]:
    """One for all recordings of a process; compiled here, so that no recording's time has the compiler in it."""
    model = load_model(name)
    processor = Processor(model, every_us=max(1, model.config.window_us // N_MOMENTS))
    warmup(model)
    processor.fire()
    return processor, model


def _told(error: Exception, path: Path) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    text = " ".join(str(error).split())
    return text if path.name in text else f"{name_of(path)}: {text}"
