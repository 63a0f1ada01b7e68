"""How much faster two streams are in two threads of one process than one after the other.

    python -m experiments.threads [--quick] [--json FILE]

Each thread has its own volume or Processor, and its own packets of random events on the sensor of
`digits`, a million a second. Both ways take turns. They are timed by the wall clock, so the machine
must be quiet. Each takes a tenth of a second or more, because the system starts both threads on one
core, and needs tens of milliseconds until each has a core of its own.

A thread that finds Python's lock taken sleeps until it is woken. The time to wake it is measured,
too.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from async_tnt import Processor, TNTVolume, load_model
from async_tnt.volume.events import structured
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.moments import made_columns
from experiments.speed.timing import interleave, machine, spread

MODEL = "digits"
"""The model that decides."""

PACKETS = (100, 1_000, 10_000, 400_000)
"""Numbers of events of a packet that are compared."""

N_EVENTS = 400_000
"""Number of events of a stream."""

PASSES = 50
"""Number of times that a work pushes its stream."""

ROUNDS = 9
"""Number of times that each work is timed."""

Work = Callable[[], object]
"""A function that does the work of one thread."""


def works(model: Any, events: np.ndarray, packet: int, n_passes: int) -> dict[str, Work]:
    """Name -> the work of one stream.

    The works are those of a volume alone, of a Processor with decisions at the ends of windows, and
    of a Processor with a decision every millisecond.
    """
    packets = [events[first : first + packet].copy() for first in range(0, len(events), packet)]
    targets: dict[str, Any] = {
        "volume": TNTVolume(model.config),
        "windows": Processor(model, start_us=0),
        "every_us": Processor(model, start_us=0, every_us=1000),
    }

    def stream(target: Any) -> Work:
        push = target.update if isinstance(target, TNTVolume) else target.push

        def run() -> None:
            for _ in range(n_passes):
                target.reset()
                for events_of_packet in packets:
                    push(events_of_packet)

        return run

    return {name: stream(target) for name, target in targets.items()}


def seconds(pair: tuple[Work, Work], in_threads: bool) -> float:
    """Seconds of both works, in two threads or one after the other."""
    started = time.perf_counter()
    if in_threads:
        threads = [threading.Thread(target=work) for work in pair]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    else:
        for work in pair:
            work()
    return time.perf_counter() - started


def speed_up(pair: tuple[Work, Work], rounds: int) -> dict[str, float]:
    """The time of two works one after the other, divided by their time in two threads."""
    cases = {
        "one after the other": partial(seconds, pair, in_threads=False),
        "in threads": partial(seconds, pair, in_threads=True),
    }
    measured = interleave(cases, rounds)
    return spread(measured["one after the other"] / measured["in threads"])


def wake_us(n: int = 2_000) -> float:
    """The median of the microseconds from the release of a lock until a waiting thread runs on.

    A thread that waits for Python's lock loses this time.
    """
    request = threading.Lock()
    reply = threading.Lock()
    round_seconds = []

    def answer() -> None:
        for _ in range(n):
            request.acquire()
            reply.release()

    request.acquire()
    reply.acquire()
    other = threading.Thread(target=answer)
    other.start()
    for _ in range(n):
        started = time.perf_counter()
        request.release()
        reply.acquire()
        round_seconds.append(time.perf_counter() - started)
    other.join()
    return float(np.median(round_seconds)) / 2 * 1e6  # a round wakes two threads


def measure(quick: bool) -> dict[str, Any]:
    """The whole report."""
    model = load_model(MODEL)
    n = 20_000 if quick else N_EVENTS
    n_passes = 10 if quick else PASSES
    rounds = 2 if quick else ROUNDS
    columns = [
        made_columns(np.random.default_rng(seed), model.config.sensor, n, n) for seed in (0, 1)
    ]
    report: dict[str, Any] = {"model": MODEL, "machine": machine(), "wake_us": wake_us()}
    for packet in PACKETS:
        first_works = works(model, structured(columns[0]), packet, n_passes)
        second_works = works(model, structured(columns[1]), packet, n_passes)
        for case in first_works:
            report.setdefault(case, {})[str(packet)] = speed_up(
                (first_works[case], second_works[case]), rounds
            )
    return report


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("threads", __doc__, "few events")
    return run_script(parser, argv, measure, "threads")


if __name__ == "__main__":
    exit_with(main)
