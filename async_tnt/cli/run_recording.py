"""Decisions of a recording, printed one by one."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from async_tnt.cli.output import Line, complain, complain_late, say
from async_tnt.decision import Decision
from async_tnt.networks.engines import Engine
from async_tnt.processor import Processor
from async_tnt.sources.files.recording import Recording
from async_tnt.sources.pixel_selector import PixelSelector
from async_tnt.windows import FirstWindows


def open_selected(path: Any, pixels: PixelSelector) -> tuple[Recording, Iterator[Any]]:
    """A recording, and its packets without the pixels to leave out.

    Raises
    ------
    ValueError, OSError : unreadable, or recorded with another sensor than the model's.
    """
    recording, sensor = pixels.open(path)
    if recording.stated_sensor is None:
        pixels.check_events(recording, path, sensor)
    return recording, map(pixels.filter_of(path, sensor), recording)


class Seen:
    """Counts the packets that a model sees while they are read.

    Attributes
    ----------
    n_events : of the packets so far.
    n_unsorted : those of them that are older than an earlier one. Events that were left out do not count.
    """

    def __init__(self, packets: Iterable[np.ndarray]) -> None:
        self._packets = packets
        self._newest_us = -1
        self.n_events = 0
        self.n_unsorted = 0

    def __iter__(self) -> Iterator[np.ndarray]:
        for packet in self._packets:
            newest = np.maximum.accumulate(np.concatenate(([self._newest_us], packet["t"])))
            self.n_unsorted += int(np.count_nonzero(packet["t"] < newest[:-1]))
            self._newest_us = int(newest[-1])
            self.n_events += len(packet)
            yield packet


def print_decisions(
    recording: Recording,
    packets: Iterable[np.ndarray],
    processor: Processor,
    engine: Engine,
    pixels: PixelSelector,
    line: Line,
    *,
    summary: bool,
) -> None:
    """A line for each decision and, with `summary`, one for the recording: the best mean probability of its windows.

    Raises
    ------
    ValueError : no window had an event.
    """
    processor.reset()
    closed = []
    seen, before = Seen(packets), pixels.counts
    for decision, latency_us in timed_decisions(seen, processor):
        say(line(str(recording.path), decision, latency_us))
        if decision.complete or decision.trigger == "end":
            closed.append(decision.probabilities)
    if closed and summary:
        mean = np.mean(closed, axis=0)
        best = int(mean.argmax())
        windows = "1 window" if len(closed) == 1 else f"{len(closed)} windows"
        say(f"{recording.path.name}: {engine.classes[best]} (mean probability {mean[best]:.3f} of {windows})")
    late = processor.counts.dropped_late
    complain_late(str(recording.path), late, seen.n_events, "--late, --start-us")
    if seen.n_unsorted and not late:
        complain(
            f"{recording.path}: {seen.n_unsorted} of {seen.n_events} events are older than an earlier one (see --late)"
        )
    if not closed:
        why = pixels.nothing_left(before) or "no event in any window"
        raise ValueError(f"{recording.path}: {why}")


def timed_decisions(packets: Iterable[Any], processor: Processor) -> Iterator[tuple[Decision, float]]:
    """Each decision, and its latency in microseconds, from the call with the event that caused it."""
    clock, first = time.perf_counter_ns, FirstWindows(processor.config)
    for packet in packets:
        for t, x, y, p in zip(*(packet[field].tolist() for field in ("t", "x", "y", "p")), strict=True):
            handed_over = clock()
            decisions = processor.push_one(t, x, y, p)
            if decisions:
                latency_us = (clock() - handed_over) / 1e3
                for decision in first.watch(decisions):
                    yield decision, latency_us
    handed_over = clock()
    decisions = processor.finish()
    latency_us = (clock() - handed_over) / 1e3
    for decision in decisions:
        yield decision, latency_us
