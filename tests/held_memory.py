"""How much memory the package holds."""

import gc
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
