"""How much memory the package holds."""

import gc
import tracemalloc
from pathlib import Path

import async_tnt

OURS = tracemalloc.Filter(True, str(Path(async_tnt.__file__).parent / "*"))


def held():
    """Bytes that the package has allocated and not let go, while tracemalloc traces.

    Threads of other libraries, which tests before have started, allocate as they like.
    """
    gc.collect()
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces([OURS]).traces)
