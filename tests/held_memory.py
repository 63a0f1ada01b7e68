"""How much memory the package and its process hold."""

import gc
import sys
import tracemalloc
from pathlib import Path

import async_tnt

OURS = tracemalloc.Filter(True, str(Path(async_tnt.__file__).parent / "*"))
"""Keeps what files of the package have allocated."""


def held():
    """Bytes that the package has allocated and not released since tracemalloc started.

    What other libraries allocate does not count: threads that earlier tests have started may do so
    at any time.
    """
    gc.collect()
    snapshot = tracemalloc.take_snapshot().filter_traces([OURS])
    return sum(trace.size for trace in snapshot.traces)


def peak_of_process():
    """The most bytes that this process has held so far; None where the system does not say it."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
