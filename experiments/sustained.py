"""How many events a second this machine sustains with a model, and how late decisions are.

    python -m experiments.sustained [--model digits] [--every-events 1] [--seconds 20]
                                    [--picture FILE]

First the processor time of streams is measured at several rates, in packets of a millisecond, with
a decision after every few events. The sustained rate is the rate at which a stream would take one
core.

Then streams come in real time through `KeepUp`, at a tenth to ten times the sustained rate. The
delay of a packet is the time from the moment when it was due to the end of its decisions.
`max_delay_us` limits the age of a packet when `KeepUp` hands it out. Above the sustained rate,
decisions become rarer, and packets are skipped.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt import Processor, load_model, warmup
from async_tnt.cli.options import positive_int
from async_tnt.sources import KeepUp, open_recording, sample_recordings
from async_tnt.views.figure_style import HIGHLIGHTS, axes_at, headline, new_figure
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.memory import resident_mb
from experiments.speed.timing import machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATES = (10_000, 20_000, 50_000, 100_000)
"""Rates, in events a second, at which the share of a core is measured. A first stream at the first
rate is not counted, because it warms up."""

LOADS = (0.1, 0.25, 0.5, 0.75, 1.0, 2.0, 10.0)
"""Rates of the streams in real time, divided by the sustained rate."""

PERCENTILES = (50.0, 99.0, 99.9)
"""Percentiles of the delays in the report."""

PACKET_US = 1_000
"""Time that a packet covers, in microseconds."""

MAX_DELAY_US = 50_000
"""Largest age of a packet when `KeepUp` hands it out, in microseconds. Older ones are skipped."""


def packets(rate: float, seconds: float, started: float | None = None) -> Iterator[np.ndarray]:
    """Packets of a millisecond, whose places are those of a bundled recording, repeated.

    Each packet is in new memory. Packets come in real time from `started` on. If `started` is None,
    they come at once.
    """
    events = open_recording(sample_recordings()[3]).read()
    n = max(1, round(rate * PACKET_US * 1e-6))
    n_before = 0
    for k in range(round(seconds * 1e6 / PACKET_US)):
        packet = events[np.arange(n_before, n_before + n) % len(events)]
        packet["t"] = k * PACKET_US + np.arange(n) * PACKET_US // n
        n_before += n
        if started is not None:
            ahead_s = due_s(started, packet) - time.monotonic()
            if ahead_s > 0:
                time.sleep(ahead_s)
        yield packet


def due_s(started: float, packet: np.ndarray) -> float:
    """The time at which a packet is complete, by the clock that showed `started` at the start."""
    return started + (int(packet["t"][0]) // PACKET_US + 1) * PACKET_US * 1e-6


def share_of_core(processor: Processor, rate: float, seconds: float) -> float:
    """Processor seconds for each second of a stream."""
    processor.reset()
    stream = list(packets(rate, seconds))
    started = time.process_time()
    for packet in stream:
        processor.push(packet)
    return (time.process_time() - started) / seconds


def under_load(processor: Processor, rate: float, seconds: float) -> dict[str, Any]:
    """The report of a stream in real time: delays, and counts of what was decided and skipped."""
    processor.reset()
    delays_us = []
    n_decisions = 0
    before_mb = resident_mb()
    started = time.monotonic()
    reader = KeepUp(
        packets(rate, seconds, started), processor, max_delay_us=MAX_DELAY_US, copy=False
    )
    with reader:
        for packet in reader:
            n_decisions += len(processor.push(packet))
            delays_us.append(1e6 * (time.monotonic() - due_s(started, packet)))
        counts = reader.counters
    return {
        "rate": rate,
        "received": counts.received,
        "decided_on": processor.counts.received,
        "skipped": counts.skipped,
        "decisions": n_decisions,
        "slowest": reader.slowest,
        "delay_ms": {f"{p:g}": float(np.percentile(delays_us, p)) / 1e3 for p in PERCENTILES},
        "worst_ms": max(delays_us) / 1e3,
        "grown_mb": resident_mb() - before_mb,
    }


def measure(
    name: str, every_events: int, seconds: float, loads: tuple[float, ...]
) -> dict[str, Any]:
    """The report: the sustained rate, and a stream in real time at each load."""
    model = load_model(name)
    warmup(model)
    processor = Processor(model, every_events=every_events)
    # this stream warms the processor up
    share_of_core(processor, RATES[0], 1.0)
    shares = [share_of_core(processor, rate, min(seconds, 3.0)) for rate in RATES]
    # A line is fitted to the shares. Its slope is the seconds of an event. Its intercept is the
    # share of a core that is used without events.
    event_s, share_at_rest = map(float, np.polyfit(RATES, shares, 1))
    sustained = (1.0 - share_at_rest) / event_s
    streams = {f"{load:g}": under_load(processor, load * sustained, seconds) for load in loads}
    return {
        "machine": machine(),
        "model": name,
        "every_events": every_events,
        "seconds": seconds,
        "max_delay_us": MAX_DELAY_US,
        "share_of_core": dict(zip(map(str, RATES), shares, strict=True)),
        "event_us": event_s * 1e6,
        "sustained": sustained,
        "streams": streams,
    }


def draw(report: dict[str, Any]) -> Figure:
    """Draw percentiles of the delays against the load."""
    figure = new_figure(3.4, 6.0)
    axes = axes_at(figure, 0.8, 0.8, 4.9, 2.0)
    loads = list(map(float, report["streams"]))
    for (colour, dashes), p in zip(HIGHLIGHTS, PERCENTILES, strict=False):
        delays = [stream["delay_ms"][f"{p:g}"] for stream in report["streams"].values()]
        axes.loglog(loads, delays, marker="o", ms=3, color=colour, ls=dashes, label=f"{p:g} %")
    axes.set_xlabel("load: the rate divided by the sustained one")
    axes.set_ylabel("delay of a packet, ms")
    axes.legend()
    headline(
        figure, f"{report['model']}: {report['sustained']:,.0f} events a second, less and more"
    )
    return figure


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("sustained", __doc__, "a second for each of two loads", draws=True)
    parser.add_argument(
        "--model", default="digits", help="bundled, or a file (default: %(default)s)"
    )
    parser.add_argument(
        "--every-events", type=positive_int, default=1, metavar="N", help="(default: %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=positive_int, default=20, help="of each load (default: %(default)s)"
    )
    args = parser.parse_args(argv)

    def measure_report(quick: bool) -> dict[str, Any]:
        if quick:
            return measure(args.model, args.every_events, 1.0, LOADS[::5])
        return measure(args.model, args.every_events, args.seconds, LOADS)

    return run_script(parser, argv, measure_report, "sustained", draw)


if __name__ == "__main__":
    exit_with(main)
