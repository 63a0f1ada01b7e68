"""A small view of a running stream in the terminal: label, class probabilities, rates, latency."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.checks import needs_extra, printable
from async_tnt.cli.packets import timed_packets
from async_tnt.decision import Counts, Decision
from async_tnt.processor import Processor

if TYPE_CHECKING:
    from async_tnt.sources.background_reader import BackgroundReader

BAR = 32  # characters of a probability of 1
MOST_CLASSES = 12  # more are not shown: the likeliest ones are
REFRESHES_PER_S = 12


class LiveView:
    """Draws the newest decision in place, several times a second, however many decisions there are.

    Parameters
    ----------
    classes : names, in the order of the network's outputs.
    title : name of the source.
    console : of rich; by default the terminal's stdout.

    Raises
    ------
    ImportError : rich is not installed.
    """

    def __init__(self, classes: Sequence[str], title: str, console: Any = None) -> None:
        with needs_extra("view", "run --live draws with rich"):
            from rich.live import Live
        self._classes, self._title = tuple(map(printable, classes)), printable(title)
        self._decision: Decision | None = None
        self._latencies: list[float] = []
        self._started_s, self._n_decisions = time.perf_counter(), 0
        self._counts = Counts()
        self._queue: BackgroundReader | None = None
        self._live = Live(
            get_renderable=self._draw, console=console, refresh_per_second=REFRESHES_PER_S, redirect_stdout=False
        )

    def __enter__(self) -> LiveView:
        self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._live.__exit__(kind, error, traceback)

    def show(
        self, decisions: Sequence[Decision], latency_us: float, counts: Counts, queue: BackgroundReader | None = None
    ) -> None:
        """Show the results of a packet: its decisions, their latency, the counts so far, and the queue it waited in."""
        self._counts = counts
        self._queue = queue
        self._n_decisions += len(decisions)
        if decisions:
            self._decision = decisions[-1]
            self._latencies = [*self._latencies[-199:], latency_us]

    def _draw(self) -> Any:
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        bars = Table.grid(padding=(0, 1))
        if self._decision is not None:
            for k in _likeliest(self._decision.probabilities):
                p = float(self._decision.probabilities[k])
                style = "bold green" if k == self._decision.index else "dim"
                bars.add_row(Text(self._classes[k], style), Text("█" * round(p * BAR), style), Text(f"{p:.2f}", style))
        return Group(Text(self._title, "bold"), bars, *(Text(line, "dim") for line in self._lines()))

    def _lines(self) -> list[str]:
        """Decision, rates and counts as text."""
        counts = self._counts
        if self._decision is None:
            return [f"no decision yet, {counts.received:,} events"]
        passed_s = max(time.perf_counter() - self._started_s, 1e-3)
        lines = [
            f"{self._classes[self._decision.index]} at {self._decision.time_us / 1e6:.3f} s, {self._decision.trigger}; "
            f"{np.median(self._latencies):.0f} us to a decision",
            f"{counts.received / passed_s:,.0f} events/s, {self._n_decisions / passed_s:,.0f} decisions/s",
            f"{counts.received:,} events, {counts.moved_off:,} moved off the grid, {counts.lost:,} dropped",
        ]
        if (queue := self._queue) is not None:
            lines.append(
                f"{queue.delay_us / 1e3:.1f} ms old, {queue.backlog:,} events waiting, {queue.n_skipped:,} skipped"
            )
        return lines


def draw_stream(
    title: str, classes: Sequence[str], packets: Iterable[Any], processor: Processor, queue: BackgroundReader | None
) -> None:
    """Draw the decisions on these packets, every 20 ms if no trigger is set, until they end."""
    triggers = (processor.every_us, processor.every_events, processor.confidence, processor.activity)
    if triggers == (None, None, None, None):
        processor.every_us = 20_000
    with LiveView(classes, title) as view:
        for decisions, latency_us in timed_packets(packets, processor):
            view.show(decisions, latency_us, processor.counts, queue)
        view.show(processor.finish(), 0.0, processor.counts, queue)


def _likeliest(probabilities: np.ndarray) -> list[int]:
    """The classes to show, in the order of the model."""
    order = np.argsort(-probabilities, kind="stable")[:MOST_CLASSES]
    return sorted(int(k) for k in order)
