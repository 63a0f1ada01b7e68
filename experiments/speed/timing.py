"""Fair timing: cases run interleaved, warm, in one process; medians and quartiles are reported."""

from __future__ import annotations

import gc
import importlib.util
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from async_tnt.cli.bench import machine as this_machine

# Work of milliseconds is timed by the processor time it takes, which other processes cannot
# lengthen; on a quiet machine it equals the wall clock. Windows counts it in steps of 16 ms only.
# Latencies, whose tail we report, use the wall clock.
work_clock = time.perf_counter if sys.platform == "win32" else time.process_time


def interleave(cases: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, np.ndarray]:
    """Run every case once a round, A B A B ..., so that other load affects all of them equally.

    Parameters
    ----------
    cases : name -> a function that does the work once and returns what it measured.
    rounds : how many times each is measured, after one round of warming up. Every other round runs
        in reverse, so that none always follows the same neighbour.

    Returns
    -------
    name -> float64, shape (rounds,).
    """
    for case in cases.values():
        case()
    names = list(cases)
    measured: dict[str, list[float]] = {name: [] for name in names}
    with no_collector():
        for k in range(rounds):
            for name in names if k % 2 == 0 else reversed(names):
                measured[name].append(cases[name]())
    return {name: np.array(values) for name, values in measured.items()}


def spread(values: np.ndarray) -> dict[str, float]:
    """Median, quartiles and extremes of repeated measurements."""
    low, q1, median, q3, high = np.percentile(values, [0, 25, 50, 75, 100])
    return {
        "median": float(median),
        "q1": float(q1),
        "q3": float(q3),
        "min": float(low),
        "max": float(high),
        "n": len(values),
    }


def latency(values: np.ndarray) -> dict[str, float]:
    """`spread`, with the 99th percentile, of latencies."""
    return {**spread(values), "p99": float(np.percentile(values, 99))}


@contextmanager
def no_collector() -> Iterator[None]:
    """A block without Python's garbage collector, which runs at random times.

    The collector's state is restored afterwards.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def one_thread(with_torch: bool) -> Iterator[None]:
    """torch on one thread, as ours; the number of threads is restored afterwards."""
    if not with_torch:
        yield
        return
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def is_installed(*packages: str) -> bool:
    """Whether all of them can be imported, without importing any."""
    return all(importlib.util.find_spec(package) is not None for package in packages)


def machine(*packages: str) -> dict[str, Any]:
    """What a figure depends on: processor, load, versions (None where a package is missing)."""
    return this_machine() | {name: _version(name) for name in packages}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
