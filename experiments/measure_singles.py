"""A decision after every event: the time of each, and the tail of the distribution."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np

from async_tnt import Model, Processor
from experiments.bench_timing import latency

STRETCH = 2000  # single decisions with, then as many without the collector


def bench_singles(model: Model, recordings: list[np.ndarray], *, n_decisions: int) -> dict[str, Any]:
    """Time single decisions, `push_one` of event after event with `every_events=1`, by the wall clock.

    Each way has a Processor of its own, and they alternate in runs of STRETCH: `collector`, with Python's garbage
    collector as users have it; `no_collector`, without; and `machine`, a loop of Python's own additions that takes
    about as long as a decision and knows nothing of us: values far from its median come from the machine.

    Returns
    -------
    dict : way -> median, quartiles, p99, p99.9 (`p999`), max, in microseconds, and `p99_over_median`.
    """
    ways = {"collector": _singles(model, recordings), "no_collector": _singles(model, recordings)}
    typical_us = float(np.median([ways["collector"]() for _ in range(STRETCH)]))
    for _ in range(STRETCH):
        ways["no_collector"]()
    ways["machine"] = _additions(typical_us)
    us: dict[str, list[float]] = {name: [] for name in ways}
    was_enabled = gc.isenabled()
    try:
        for first in range(0, n_decisions, STRETCH):
            for name, decide in ways.items():
                if name == "collector":
                    gc.enable()
                else:
                    gc.disable()
                us[name] += [decide() for _ in range(min(STRETCH, n_decisions - first))]
    finally:
        if was_enabled:
            gc.enable()
        else:
            gc.disable()
    return {name: _tail(np.array(values)) for name, values in us.items()}


def _singles(model: Model, recordings: list[np.ndarray]) -> Callable[[], float]:
    """Each call takes the next event, lap after lap, and returns the microseconds to its decision."""
    processor = Processor(model, every_events=1, start_us=0)
    lap_us = (1 + max(int(events["t"].max()) for events in recordings) // model.config.window_us) * (
        model.config.window_us
    )

    def rows() -> Any:
        for k in count():
            events = recordings[k % len(recordings)].copy()
            events["t"] += k * lap_us
            yield from events.tolist()

    stream = rows()

    def decide() -> float:
        t, x, y, p = next(stream)
        started = time.perf_counter()
        decisions = processor.push_one(t, x, y, p)
        taken = time.perf_counter() - started
        if not decisions:
            raise RuntimeError(f"every event must give a decision, got none for {t, x, y, p}")
        return 1e6 * taken

    return decide


def _additions(us: float) -> Callable[[], float]:
    """A fixed number of additions that takes about this many microseconds."""

    def add(n: int) -> float:
        started = time.perf_counter()
        total = 0
        for k in range(n):
            total += k
        return 1e6 * (time.perf_counter() - started)

    n = 1000
    for _ in range(5):
        n = max(1, round(n * us / float(np.median([add(n) for _ in range(200)]))))
    return lambda: add(n)


def _tail(us: np.ndarray) -> dict[str, float]:
    found = latency(us)
    del found["min"]
    return {**found, "p999": float(np.percentile(us, 99.9)), "p99_over_median": found["p99"] / found["median"]}
