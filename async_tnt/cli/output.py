"""What commands print: decisions as lines for people and for programs, and errors on stderr."""

from __future__ import annotations

import errno
import json
import re
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from async_tnt.base.checks import printable
from async_tnt.streaming.decision import Decision

if TYPE_CHECKING:
    from async_tnt.sources.queues.background_reader import BackgroundReader

Line = Callable[..., str]  # `text_line` or `json_line`
HEADER = f"{'recording':<16} {'time ms':>9} {'window ms':>19}  {'label':<8} {'prob':>5} {'events':>7} {'us':>7}  why"


OPTIONS: set[str] = set()
"""Names of the options of the command that runs."""


def complain(error: BaseException | str) -> None:
    """One line on stderr. The package names `parameters`: options of the command are printed as
    such."""
    if isinstance(error, OSError) and (error.filename is not None or error.errno == errno.ENOSPC):
        # what we write to files has their name
        error = f"{error.filename or 'stdout'}: {error.strerror}"
    if isinstance(error, MemoryError):  # NumPy's says of what, Python's is empty
        error = f"not enough memory. {error}".strip()
    note(f"async-tnt: {with_options(str(error), OPTIONS)}")


def with_options(text: str, names: Collection[str]) -> str:
    """An error of the package, in the words of the program.

    Examples
    --------
    >>> with_options("`every_us` must be at least 1, `t` too", {"every_us"})
    '--every-us must be at least 1, `t` too'
    """
    return re.sub(
        r"`(\w+)`",
        lambda name: f"--{name[1].replace('_', '-')}" if name[1] in names else name[0],
        text,
    )


def complain_late(name: str, n_late: int, n_events: int, see: str) -> None:
    """Report events that were dropped because they were too late, if there are any."""
    if n_late:
        complain(f"{name}: {n_late} of {n_events} events were too late and dropped (see {see})")


def can_print(text: str, stream: TextIO) -> bool:
    """Whether the encoding of this stream has all these characters. Others are printed as
    escapes."""
    try:
        text.encode(getattr(stream, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


def say(*lines: str) -> None:
    """Print lines on stdout, at once. All that a command prints passes through here or `note`:
    names of files and of classes are data, and may contain line breaks and what a terminal
    obeys."""
    print("\n".join(map(printable, lines)), flush=True)


def note(*lines: str) -> None:
    """`say` on stderr."""
    print("\n".join(map(printable, lines)), file=sys.stderr, flush=True)


def text_line(
    name: str, decision: Decision, latency_us: float, queue: BackgroundReader | None = None
) -> str:
    start_ms = decision.window_start_us / 1e3
    window = f"{start_ms:.3f}+{(decision.time_us - decision.window_start_us) / 1e3:.3f}"
    objects = "".join(f"  {o.id}: {o.label} ({o.x:.0f}, {o.y:.0f})" for o in decision.objects or ())
    return (
        f"{Path(name).name:<16} {decision.time_us / 1e3:>9.3f} {window:>19}  "
        f"{decision.label or '-':<8} "
        f"{decision.probability:>5.3f} {decision.events:>7} {latency_us:>7.1f}  "
        f"{decision.trigger}{objects}"
    )


def json_line(
    name: str, decision: Decision, latency_us: float, queue: BackgroundReader | None = None
) -> str:
    queued = {}
    if queue is not None:
        queued = {
            "delay_us": queue.delay_us,
            "backlog": queue.backlog,
            "n_skipped": queue.n_skipped,
        }
    return json.dumps(
        {"recording": name, **decision.to_dict(), "latency_us": round(latency_us, 3), **queued}
    )
