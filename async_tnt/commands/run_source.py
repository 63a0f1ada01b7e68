"""Decisions of a stream that comes while one listens: from a camera, or over the network."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterable
from typing import Any

from ..engines.choice import Engine
from ..fresh import BackgroundReader
from ..live_sources import open_live
from ..processor import Processor
from .decision_lines import Line
from .files import complain
from .live_view import LiveView, decide_often
from .pixel_options import PixelOptions


def run_source(
    name: str,
    processor: Processor,
    engine: Engine,
    pixels: PixelOptions,
    line: Line,
    *,
    latest: int | None,
    live: bool,
) -> bool:
    """Print or draw decisions until the source ends or Ctrl-C; then what was counted. Returns whether Ctrl-C ended it.

    Parameters
    ----------
    name : of the source, as `open_live` takes it.
    latest : packets that wait at most while decisions are made, the oldest are skipped; None: the source's own
        buffer decides, and nothing is skipped here.
    """
    processor.reset()
    stopped = False
    with contextlib.ExitStack() as stack:
        source = open_live(name, pixels.expected)
        stack.callback(source.close)
        packets: Iterable[Any] = pixels.select(source, pixels.sensor_of(name, source.sensor))
        reader = None
        if latest is not None:
            reader = BackgroundReader(packets, latest=True, max_packets=latest, on_close=source.close)
            packets = stack.enter_context(reader)
        complain(f"listening at {name}; Ctrl-C stops")
        try:
            if live:
                _draw(packets, reader, processor, LiveView(engine.classes, name))
            else:
                _print_all(packets, reader, name, processor, line)
        except KeyboardInterrupt:
            stopped = True
        finally:  # also where a camera was unplugged
            for decision in processor.finish():
                if not live:
                    print(line(name, decision, 0.0), flush=True)
            complain(f"{name}: {_summary(source, reader, processor)}")
    return stopped


def _print_all(
    packets: Iterable[Any], reader: BackgroundReader | None, name: str, processor: Processor, line: Line
) -> None:
    for packet in packets:
        handed_over = time.perf_counter_ns()
        decisions = processor.push(packet)
        latency_us = (time.perf_counter_ns() - handed_over) / 1e3
        for decision in decisions:
            print(line(name, decision, latency_us, reader))
        if decisions:
            sys.stdout.flush()


def _draw(packets: Iterable[Any], reader: BackgroundReader | None, processor: Processor, view: LiveView) -> None:
    decide_often(processor)
    with view:
        for packet in packets:
            handed_over = time.perf_counter_ns()
            decisions = processor.push(packet)
            view.show(decisions, (time.perf_counter_ns() - handed_over) / 1e3, processor.counts, reader)


def _summary(source: Any, reader: BackgroundReader | None, processor: Processor) -> str:
    counts = processor.counts
    parts = [source.summary()]
    if reader is not None:
        queue = reader.counters
        parts.append(f"{queue.skipped:,} skipped to stay fresh, at most {queue.longest_wait_us / 1e3:,.1f} ms waited")
    parts.append(f"{counts.kept:,} kept, {counts.dropped_late:,} too late for their window")
    return "; ".join(part for part in parts if part)
