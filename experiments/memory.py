"""Does memory grow during a long stream?

The answer is the resident memory after the first million events, and at the end.

    python -m experiments.memory [--events 100000000] [--limit-mb 4]

Windows open and close. Decisions are made at the ends of windows, every 20 ms and on demand.
Packets come as structured arrays, as columns and as single events. The command prints one JSON
object. Its exit code is 1 if memory grew by more than the limit.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np

from async_tnt import Processor, load_model, warmup
from async_tnt.volume.events import structured
from experiments.scripts.options import add_json, exit_with, plain_parser, write_outputs
from experiments.speed.memory import resident_mb
from experiments.speed.moments import made_columns
from experiments.speed.timing import machine

MODEL = "digits"
"""The model that decides."""

FIRST = 1_000_000
"""Number of events after which memory is noted for the first time."""

PACKET = 1300
"""Number of events of a packet."""

PACKETS_A_WINDOW = 13
"""Number of packets of a window."""

SINGLES = 50
"""Number of events that come one by one, at the start of each window."""


def push_window(processor: Processor, window: np.ndarray, start_us: int) -> int:
    """Push one window's events, `start_us` later than recorded; returns the number of decisions."""
    n_decisions = 0
    for k in range(PACKETS_A_WINDOW):
        # a camera's driver hands over new memory each time, too
        packet = window[k * PACKET : (k + 1) * PACKET].copy()
        packet["t"] += start_us
        if k % 3 == 1:
            n_decisions += len(
                processor.push(tuple(packet[name].copy() for name in ("t", "x", "y", "p")))
            )
        else:
            if k == 0:
                for t, x, y, p in packet[:SINGLES].tolist():
                    n_decisions += len(processor.push_one(t, x, y, p))
                packet = packet[SINGLES:]
            n_decisions += len(processor.push(packet))
    processor.fire()
    return n_decisions + 1


def main(argv: list[str] | None = None) -> int:
    """Push the events, print the result, and compare the growth with the limit."""
    parser = plain_parser("memory", __doc__)
    add_json(parser)
    parser.add_argument(
        "--events", type=int, default=100_000_000, metavar="N", help="(default: 100 million)"
    )
    parser.add_argument(
        "--limit-mb", type=float, default=4.0, metavar="MB", help="growth allowed (default: 4)"
    )
    args = parser.parse_args(argv)
    if args.events <= FIRST:
        parser.error(f"--events must be more than the first {FIRST:,}, got {args.events:,}")

    model = load_model(MODEL)
    warmup(model)
    processor = Processor(model, every_us=20_000)
    rng = np.random.default_rng(0)
    n_window_events = PACKET * PACKETS_A_WINDOW
    config = model.config
    window = structured(made_columns(rng, config.sensor, n_window_events, config.window_us))
    window["t"][0] = 0

    first_mb = None
    n_events = 0
    n_decisions = 0
    start_us = 0
    started = time.perf_counter()
    shown_s = started
    while n_events < args.events:
        n_decisions += push_window(processor, window, start_us)
        start_us += model.config.window_us
        n_events += len(window)
        if first_mb is None and n_events >= FIRST:
            first_mb = resident_mb()
        if time.perf_counter() - shown_s > 2:
            shown_s = time.perf_counter()
            progress_line = f"{n_events:,} of {args.events:,} events, {resident_mb():.1f} MB"
            print(progress_line, file=sys.stderr, flush=True)

    last_mb = resident_mb()
    if processor.counts.received != n_events:
        raise RuntimeError(
            f"{n_events:,} events were pushed, {processor.counts.received:,} counted"
        )
    assert first_mb is not None  # more than FIRST events were pushed
    grown_mb = last_mb - first_mb
    result = {
        "machine": machine(),
        "model": MODEL,
        "events": n_events,
        "decisions": n_decisions,
        "seconds": round(time.perf_counter() - started, 1),
        "first_million_mb": round(first_mb, 2),
        "end_mb": round(last_mb, 2),
        "grown_mb": round(grown_mb, 2),
        "limit_mb": args.limit_mb,
    }
    write_outputs(args, result)
    print(json.dumps(result))
    return int(grown_mb > args.limit_mb)


if __name__ == "__main__":
    exit_with(main)
