"""Labelled recordings streamed through a Processor, as a camera's events would be, one recording after the other."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from async_tnt.archive.job import Task, processor_of
from async_tnt.config import TNTConfig
from async_tnt.decision import Decision
from async_tnt.processor import Processor
from async_tnt.sources.pixel_selector import PixelSelector

N_MOMENTS = 10


@dataclass(frozen=True)
class Outcome:
    """What a model says of one recording with W windows.

    Parameters
    ----------
    probabilities : float64, shape (W, K), of each window at its end.
    early : int64, shape (W, N_MOMENTS): the class decided at each of `moments`; -1 where no event had come by then.
    starts_us : of each window.
    n_decisions, n_events : how many fell, and came, without those that the job's selection of pixels leaves out.
    n_late : events dropped, of those that came: before every open window.
    seconds : streaming took, without reading the file.
    error : why there is nothing of it; "" where there is.
    """

    probabilities: np.ndarray
    early: np.ndarray
    starts_us: list[int] = field(default_factory=list)
    n_decisions: int = 0
    n_events: int = 0
    n_late: int = 0
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


def evaluation_settings(config: TNTConfig) -> dict[str, Any]:
    """Settings of the Processor that `stream_recording` asks at each of `moments`."""
    return {"every_us": max(1, config.window_us // N_MOMENTS)}


def stream_recording(task: Task) -> Outcome:
    """Stream one recording: windows from its first event, and a decision at each of `moments` too.

    Whatever is wrong with the file becomes the outcome's `error`.

    Raises
    ------
    ImportError : its format needs a library that is not installed.
    ValueError : the model is not the one that the task was made for.
    """
    processor, engine, pixels = processor_of(task.job)
    try:
        decisions, n_events, seconds = decisions_of(task, processor, pixels)
    except (ValueError, TypeError, OSError, MemoryError) as error:
        none = np.empty((0, len(engine.classes))), np.empty((0, N_MOMENTS), np.int64)
        return Outcome(*none, error=told(error, task))
    windows = by_window(decisions)
    probabilities = np.array([window[-1].probabilities for window in windows])
    early = np.array([decided_at(window, moments(engine.config.window_us)) for window in windows])
    starts_us = [window[0].window_start_us for window in windows]
    n_late = processor.counts.dropped_late
    return Outcome(probabilities, early, starts_us, len(decisions), n_events, n_late, seconds)


def decisions_of(task: Task, processor: Processor, pixels: PixelSelector) -> tuple[list[Decision], int, float]:
    """All decisions of one recording, its events that the model sees, and the seconds without reading the file.

    Raises
    ------
    ValueError, TypeError, OSError : the recording is damaged, anywhere; of another sensor; or without events.
    """
    before = pixels.counts
    recording, sensor = pixels.open(task.path, name=task.recording, strict=True)
    seen = pixels.filter_of(task.recording, sensor)
    decisions: list[Decision] = []
    seconds = 0.0
    n_events = 0
    for packet in recording:
        started = time.perf_counter()
        try:
            selected = seen(packet)
            decisions += processor.push(selected)
        except (TypeError, ValueError):
            if recording.sensor is None:  # an event off a camera that somebody else names: say who
                pixels.check_silent([packet], task.recording, sensor)
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


def told(error: Exception, task: Task) -> str:
    """One line on why there is nothing of a recording; begins with its name in the results."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{task.recording}: {error.strerror}"
    text = " ".join(str(error).split()) or type(error).__name__
    text = text.replace(str(task.path), task.recording)  # one text, wherever the archive lies
    return text if task.recording in text else f"{task.recording}: {text}"
