"""Memory stays where it is however long a stream runs."""

import gc
import tracemalloc
from pathlib import Path

from made import random_events, random_model

import async_tnt
from async_tnt import Processor, TNTConfig

OURS = tracemalloc.Filter(True, str(Path(async_tnt.__file__).parent / "*"))


def held():
    """Bytes that the package has allocated and not let go; threads of other libraries allocate as they like."""
    gc.collect()
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces([OURS]).traces)


def test_a_long_stream_leaves_nothing_behind():
    for landmark in ("running", "window"):
        config = TNTConfig(window_us=5_000, landmark=landmark)
        processor = Processor(random_model(config), every_us=1_000, hop_us=2_500)
        packet = random_events(2_000, duration_us=5_000)
        tracemalloc.start()
        try:
            for k in range(120):
                processor.push(packet)
                packet["t"] += 5_000
                if k == 20:
                    before = held()
            after = held()
        finally:
            tracemalloc.stop()
        assert processor.counts.received == 240_000
        assert before > 0 and after - before < 20_000
