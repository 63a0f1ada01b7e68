"""async-tnt run udp://...: decisions of a stream that comes while one listens."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from ..decision import Decision
from ..engines.choice import Engine
from ..network import open_udp
from ..processor import Processor
from .files import complain
from .live_view import LiveView

Show = Callable[[str, Decision, float], str]


def run_source(url: str, processor: Processor, engine: Engine, show: Show, live: bool) -> bool:
    """Print decisions until the source ends or Ctrl-C; then what was counted. Returns whether Ctrl-C ended it.

    Parameters
    ----------
    show : from name, decision and microseconds to a line; not used where `live`.
    """
    processor.reset()
    stopped = False
    with open_udp(url, engine.config.sensor) as source:
        complain(f"listening at {url}; Ctrl-C stops")
        watch = LiveView(engine.classes, url) if live else None
        try:
            if watch is None:
                _print_all(source, url, processor, show)
            else:
                with watch:
                    for packet in source:
                        handed_over = time.perf_counter_ns()
                        decisions = processor.push(packet)
                        watch.show(decisions, (time.perf_counter_ns() - handed_over) / 1e3, processor.counts)
        except KeyboardInterrupt:
            stopped = True
        for decision in processor.finish():
            print(show(url, decision, 0.0), flush=True)
        complain(f"{url}: {_counted(source, processor)}")
    return stopped


def _print_all(source: Any, url: str, processor: Processor, show: Show) -> None:
    for packet in source:
        handed_over = time.perf_counter_ns()
        decisions = processor.push(packet)
        latency_us = (time.perf_counter_ns() - handed_over) / 1e3
        for decision in decisions:
            print(show(url, decision, latency_us))
        if decisions:
            sys.stdout.flush()


def _counted(source: Any, processor: Processor) -> str:
    network, counts = source.counts, processor.counts
    lost = "unknown" if network.lost is None else f"{network.lost:,}"
    return (
        f"{network.datagrams:,} datagrams, {network.events:,} events ({network.malformed:,} malformed, "
        f"{network.late:,} out of order, datagrams lost: {lost}); {counts.kept:,} kept, "
        f"{counts.dropped_late:,} too late for their window"
    )
