"""A decision as a line: for people, and for programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Protocol

from async_tnt.cli.arguments import one_line
from async_tnt.decision import Decision


class Line(Protocol):
    """A decision as a line: of which source, after how many microseconds, and how the queue before it stands."""

    def __call__(self, name: str, decision: Decision, latency_us: float, queue: Queue | None = None) -> str: ...


class Queue(Protocol):
    """A `BackgroundReader`, or a `PacketQueue`."""

    @property
    def delay_us(self) -> int: ...

    @property
    def backlog(self) -> int: ...

    @property
    def n_skipped(self) -> int: ...


HEADER = f"{'recording':<16} {'time ms':>9} {'window ms':>19}  {'label':<8} {'prob':>5} {'events':>7} {'us':>7}  why"


def text_line(name: str, decision: Decision, latency_us: float, queue: Queue | None = None) -> str:
    start_ms = decision.window_start_us / 1e3
    window = f"{start_ms:.3f}+{(decision.time_us - decision.window_start_us) / 1e3:.3f}"
    return (
        f"{one_line(Path(name).name):<16} {decision.time_us / 1e3:>9.3f} {window:>19}  {decision.label:<8} "
        f"{decision.probability:>5.3f} {decision.events:>7} {latency_us:>7.1f}  {decision.trigger}"
    )


def json_line(name: str, decision: Decision, latency_us: float, queue: Queue | None = None) -> str:
    fresh = {}
    if queue is not None:
        fresh = {"delay_us": queue.delay_us, "backlog": queue.backlog, "n_skipped": queue.n_skipped}
    return json.dumps({"recording": name, **decision.to_dict(), "latency_us": round(latency_us, 3), **fresh})
