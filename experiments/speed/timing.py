"""Fair timing: cases take turns in one warm process, and medians and quartiles are reported."""

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

# Work of milliseconds is timed by the processor time that it takes. Other processes cannot lengthen
# this time. On a quiet machine it equals the time of the wall clock. Windows counts processor time
# in steps of 16 ms only, so the wall clock is used there. It is also used for latencies, whose tail
# we report.
work_clock = time.perf_counter if sys.platform == "win32" else time.process_time


def interleave(cases: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, np.ndarray]:
    """The measurements of cases that take turns.

    Every round runs every case once, so that other load affects all cases equally.

    Parameters
    ----------
    cases : name -> a function that does the work once and returns what it measured.
    rounds : number of rounds, after one round to warm up. Every other round runs in reverse, so
        that no case always follows the same other case.

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
    """The `spread` of latencies, and their 99th percentile."""
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
    """A block in which torch uses one thread, as our engine does.

    The number of torch's threads is restored afterwards. Without torch, nothing is changed.
    """
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
    """Whether all packages can be imported. None of them is imported."""
    return all(importlib.util.find_spec(package) is not None for package in packages)


def machine(*packages: str) -> dict[str, Any]:
    """What a measured number depends on: processor, load, versions (None for a missing package)."""
    return this_machine() | {name: _version(name) for name in packages}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
