"""What commands print: decisions as lines for people and for programs, and errors on stderr."""

from __future__ import annotations

import errno
import json
import sys
from pathlib import Path
from typing import Protocol

from async_tnt.decision import Decision


class Line(Protocol):
    """A decision as a line, with the name of its source, its latency, and the state of the queue before it."""

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


def complain(error: BaseException | str) -> None:
    """One line on stderr."""
    if isinstance(error, OSError) and (error.filename is not None or error.errno == errno.ENOSPC):
        error = f"{error.filename or 'stdout'}: {error.strerror}"  # what we write to files has their name
    print(f"async-tnt: {printable(str(error))}", file=sys.stderr, flush=True)


def complain_late(name: str, n_late: int, n_events: int, see: str) -> None:
    """Report events that were dropped because they were too late, if there are any."""
    if n_late:
        complain(f"{name}: {n_late} of {n_events} events were too late and dropped (see {see})")


def printable(text: str) -> str:
    """The text on one line, unprintable characters escaped: a file name may contain a line break.

    Examples
    --------
    >>> print(printable("a\\nb: no events"))
    a\\nb: no events
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def text_line(name: str, decision: Decision, latency_us: float, queue: Queue | None = None) -> str:
    start_ms = decision.window_start_us / 1e3
    window = f"{start_ms:.3f}+{(decision.time_us - decision.window_start_us) / 1e3:.3f}"
    return (
        f"{printable(Path(name).name):<16} {decision.time_us / 1e3:>9.3f} {window:>19}  {decision.label:<8} "
        f"{decision.probability:>5.3f} {decision.events:>7} {latency_us:>7.1f}  {decision.trigger}"
    )


def json_line(name: str, decision: Decision, latency_us: float, queue: Queue | None = None) -> str:
    queued = {}
    if queue is not None:
        queued = {"delay_us": queue.delay_us, "backlog": queue.backlog, "n_skipped": queue.n_skipped}
    return json.dumps({"recording": name, **decision.to_dict(), "latency_us": round(latency_us, 3), **queued})
